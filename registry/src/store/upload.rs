//! Storing the files of a version, whatever their size, in bounded memory.
//!
//! In a folder, a file is hashed while it is copied to a temporary name, and then renamed to its digest. A bucket needs the
//! name first. There the content is hashed, then sent, and hashed again on the way because it may have changed in between.

use std::fs::File;
use std::io::Write;
use std::path::Path;

use bytes::Bytes;
use futures_util::StreamExt;
use futures_util::stream::FuturesUnordered;
use object_store::{MultipartUpload, ObjectStoreExt, UploadPart};

use super::staged::{Staged, create_folder, sync_folder};
use super::{BLOBS, PIECE, Store, blob_key, read_piece};
use crate::digest::{Digest, Fingerprint, hash_in_background};
use crate::error::{Error, Result};

/// Size of a part of a large blob. Object stores want equal parts of at least 5 MiB.
const PART: usize = 8 << 20;

/// Number of parts that are sent in parallel.
const PARALLEL_PARTS: usize = 3;

/// Receives the pieces of a content.
pub(crate) type Sink<'a> = &'a mut dyn FnMut(Bytes) -> Result<()>;

/// The content of a blob to be stored. It can be read several times.
pub(crate) type Source<'a> = &'a dyn Fn(Sink) -> Result<()>;

/// Decides whether an existing blob will stay, so that it need not be written.
pub(crate) type IsKept<'a> = &'a mut dyn FnMut(Fingerprint) -> Result<bool>;

/// Reads the file `path` piece by piece.
pub(crate) fn read_file(path: &Path, sink: Sink) -> Result<()> {
    let mut file = File::open(path).map_err(Error::io("read", path))?;
    loop {
        let piece = read_piece(&mut file, PIECE).map_err(Error::io("read", path))?;
        if piece.is_empty() {
            return Ok(());
        }
        sink(piece)?;
    }
}

impl Store {
    /// Stores a blob, unless it `is_kept`, and returns its fingerprint. Returns `None`, and stores nothing, if the content
    /// changed while it was sent to a bucket.
    pub(crate) fn upload(&self, source: Source, is_kept: IsKept) -> Result<Option<Fingerprint>> {
        if let Some(folder) = self.folder() {
            return self.copy(source, folder, is_kept).map(Some);
        }
        let ((), content) = hash_in_background(|hash| {
            source(&mut |piece| {
                hash(piece);
                Ok(())
            })
        })?;
        let is_stored = is_kept(content)? || self.send(content, source)?;
        Ok(is_stored.then_some(content))
    }

    /// Copies a content into the store in `folder`.
    fn copy(&self, source: Source, folder: &Path, is_kept: IsKept) -> Result<Fingerprint> {
        self.key(BLOBS)?;
        let blobs = folder.join(BLOBS);
        create_folder(&blobs)?;
        // Named like the store's own temporary files, so that no listing shows it and `gc` finds what a crash leaves.
        let (staged, mut file) =
            Staged::create(|number| blobs.join(format!("upload#{number}")), |path| File::create_new(path))?;
        let ((), content) = hash_in_background(|hash| {
            source(&mut |piece| {
                hash(piece.clone());
                file.write_all(&piece).map_err(Error::io("write", &staged.path))
            })?;
            // What was published must survive a power failure.
            file.sync_all().map_err(Error::io("write", &staged.path))
        })?;
        if !is_kept(content)? {
            let key = blob_key(content.digest);
            self.key(&key)?;
            let blob = folder.join(key);
            let parent = blob.parent().unwrap_or(folder);
            create_folder(parent)?;
            staged.rename(&blob)?;
            sync_folder(parent)?;
        }
        Ok(content)
    }

    /// Sends a blob to a bucket. Returns false, and stores nothing, if the source does not hold `content`.
    fn send(&self, content: Fingerprint, source: Source) -> Result<bool> {
        let key = blob_key(content.digest);
        if content.size <= PART as u64 {
            let mut bytes = Vec::new();
            source(&mut |piece| {
                bytes.extend_from_slice(&piece);
                Ok(())
            })?;
            let is_same = Digest::of(&bytes) == content.digest;
            return if is_same { self.put(&key, bytes).map(|()| true) } else { Ok(false) };
        }
        let upload = self.wait(self.objects.put_multipart(&self.key(&key)?));
        let mut upload = upload.map_err(self.error("write", &key))?;
        let sent = self.send_parts(upload.as_mut(), &key, source);
        if matches!(sent, Ok(found) if found == content) {
            self.wait(upload.complete()).map_err(self.error("write", &key))?;
            return Ok(true);
        }
        let aborted = self.wait(upload.abort()).map_err(self.error("abort the upload of", &key));
        // The first error is the one to report.
        sent.and(aborted).map(|()| false)
    }

    /// Sends a content in equal parts and returns its fingerprint.
    fn send_parts(&self, upload: &mut dyn MultipartUpload, key: &str, source: Source) -> Result<Fingerprint> {
        let mut pending = FuturesUnordered::<UploadPart>::new();
        let wait_for_all_but = |pending: &mut FuturesUnordered<UploadPart>, count: usize| -> Result<()> {
            while pending.len() > count
                && let Some(sent) = self.wait(pending.next())
            {
                sent.map_err(self.error("write", key))?;
            }
            Ok(())
        };
        let ((), content) = hash_in_background(|hash| {
            let mut part = Vec::with_capacity(PART);
            source(&mut |mut piece| {
                hash(piece.clone());
                while part.len() + piece.len() >= PART {
                    part.extend_from_slice(&piece.split_to(PART - part.len()));
                    wait_for_all_but(&mut pending, PARALLEL_PARTS - 1)?;
                    let full = std::mem::replace(&mut part, Vec::with_capacity(PART));
                    pending.push(upload.put_part(full.into()));
                }
                part.extend_from_slice(&piece);
                Ok(())
            })?;
            if !part.is_empty() {
                pending.push(upload.put_part(part.into()));
            }
            wait_for_all_but(&mut pending, 0)
        })?;
        Ok(content)
    }
}

#[cfg(test)]
mod tests {
    use std::fs;

    use super::*;
    use crate::fixture::{Place, bytes};

    /// Sizes around the part size, so that one put, two full parts and a short last part all occur.
    #[test]
    fn blobs_of_any_size_read_back() {
        for place in Place::all() {
            let store = place.store();
            for size in [0, 1, PART, PART + 1, 2 * PART] {
                let data = bytes(size);
                let source = place.path("source");
                fs::write(&source, &data).unwrap();
                let content =
                    store.upload(&|sink| read_file(&source, sink), &mut |_| Ok(false)).unwrap().unwrap();
                assert_eq!(content, Fingerprint::of(&data[..]).unwrap());
                let mut back = Vec::new();
                let sink = &mut |piece: Bytes| {
                    back.extend_from_slice(&piece);
                    Ok(())
                };
                assert_eq!(store.read_blob(content.digest, sink).unwrap(), Some(content));
                assert!(back == data, "{size}");
            }
        }
    }

    #[test]
    fn kept_blobs_are_not_written_and_no_temporary_file_stays() {
        for place in Place::all() {
            let store = place.store();
            let source = place.path("source");
            fs::write(&source, "abc").unwrap();
            let upload = |path: &Path, kept| store.upload(&|sink| read_file(path, sink), &mut |_| Ok(kept));
            let content = upload(&source, true).unwrap().unwrap();
            assert_eq!(store.inspect(&blob_key(content.digest)).unwrap(), None);
            assert_eq!(upload(&source, false).unwrap(), Some(content));
            assert_eq!(store.inspect(&blob_key(content.digest)).unwrap(), Some(content));
            assert!(upload(&place.path("missing"), false).is_err());
            if let Some(folder) = store.folder() {
                let beside: Vec<_> = fs::read_dir(folder.join(BLOBS)).unwrap().collect();
                assert_eq!(beside.len(), 1, "{beside:?}");
            }
        }
    }

    #[test]
    fn a_changed_source_is_not_sent() {
        let [_, place] = Place::all();
        let store = place.store();
        for size in [10, PART + 10] {
            let content = Fingerprint::of(&bytes(size)[..]).unwrap();
            let mut changed = bytes(size);
            changed[size - 1] ^= 1;
            for changed in [changed, bytes(size + 1)] {
                fs::write(place.path("source"), changed).unwrap();
                let path = place.path("source");
                assert!(!store.send(content, &|sink| read_file(&path, sink)).unwrap());
                assert_eq!(store.inspect(&blob_key(content.digest)).unwrap(), None);
            }
        }
    }
}
