//! Storing the files of a version, whatever their size, in bounded memory.
//!
//! In a folder, a file is hashed while it is copied to a temporary name, and then renamed to its digest. A bucket needs the
//! name first. There the content is hashed, then sent, and hashed again on the way because it may have changed in between.

use std::fs::File;
use std::io::Write;
use std::path::Path;

use bytes::Bytes;
use futures_util::future::try_join_all;
use object_store::{MultipartUpload, ObjectStoreExt};

use super::staged::{Staged, create_folder, sync_folder};
use super::{BLOBS, Store, blob_key};
use crate::digest::{Digest, Fingerprint};
use crate::error::{Error, Result};
use crate::problem::Fault;

/// Size of a part of a large blob. Object stores want equal parts of at least 5 MiB.
const PART: usize = 8 << 20;

/// Number of parts that are in memory, and sent in parallel.
const PARALLEL_PARTS: usize = 3;

/// Decides whether an existing blob will stay, so that it need not be written.
pub(crate) type IsKept<'a> = &'a mut dyn FnMut(Fingerprint) -> Result<bool>;

impl Store {
    /// Stores the object `key` of the store `from` as a blob, unless it `is_kept`, and returns its fingerprint. Fails, and stores
    /// nothing, if the content changes while it is sent to a bucket.
    pub(crate) fn upload(&self, from: &Self, key: &str, is_kept: IsKept) -> Result<Fingerprint> {
        let missing = || Error::from(Fault::Missing.of("", key));
        if let Some(folder) = self.folder.as_deref() {
            return self.copy(from, key, folder, is_kept)?.ok_or_else(missing);
        }
        let content = from.inspect(key)?.ok_or_else(missing)?;
        if is_kept(content)? || self.send(content, from, key)? {
            return Ok(content);
        }
        let place = format!("{}/{key}", from.root);
        Err(Error::refused(&place, "changed while it was read; try again when it is complete"))
    }

    /// Copies an object into the store in `folder`, while hashing it. Returns `None` if there is no such object.
    fn copy(&self, from: &Self, key: &str, folder: &Path, is_kept: IsKept) -> Result<Option<Fingerprint>> {
        self.key(BLOBS)?;
        let blobs = folder.join(BLOBS);
        create_folder(&blobs)?;
        // Named like the store's own temporary files, so that no listing shows it and `gc` finds what a crash leaves.
        let (staged, mut file) =
            Staged::create(|number| blobs.join(format!("upload#{number}")), |path| File::create_new(path))?;
        let mut write = |piece: Bytes| file.write_all(&piece).map_err(Error::io("write", &staged.path));
        let Some(content) = from.fetch(key, &mut write)? else { return Ok(None) };
        if !is_kept(content)? {
            // What was published must survive a power failure.
            file.sync_all().map_err(Error::io("write", &staged.path))?;
            let key = blob_key(content.digest);
            self.key(&key)?;
            let blob = folder.join(key);
            let parent = blob.parent().unwrap_or(folder);
            create_folder(parent)?;
            staged.rename(&blob)?;
            sync_folder(parent)?;
        }
        Ok(Some(content))
    }

    /// Sends a blob to a bucket. Returns false, and stores nothing, if the object `key` of `from` does not hold `content`.
    fn send(&self, content: Fingerprint, from: &Self, key: &str) -> Result<bool> {
        let blob = blob_key(content.digest);
        if content.size <= PART as u64 {
            let found = from.read_start(key, content.size + 1)?.map(|(bytes, _)| bytes);
            let intact = found.filter(|bytes| Digest::of(bytes) == content.digest);
            return intact.map_or(Ok(false), |bytes| self.put(&blob, bytes).map(|()| true));
        }
        let upload = self.wait(self.objects.put_multipart(&self.key(&blob)?));
        let mut upload = upload.map_err(self.error("write", &blob))?;
        let mut buffer = Vec::new();
        let sent = from.fetch(key, &mut |piece| {
            buffer.extend_from_slice(&piece);
            if buffer.len() < PARALLEL_PARTS * PART {
                return Ok(());
            }
            let rest = buffer.split_off(PARALLEL_PARTS * PART);
            self.send_parts(upload.as_mut(), &blob, std::mem::replace(&mut buffer, rest))
        });
        let sent = sent.and_then(|sent| self.send_parts(upload.as_mut(), &blob, buffer).map(|()| sent));
        if matches!(sent, Ok(found) if found == Some(content)) {
            self.wait(upload.complete()).map_err(self.error("write", &blob))?;
            return Ok(true);
        }
        let aborted = self.wait(upload.abort()).map_err(self.error("abort the upload of", &blob));
        // The first error is the one to report.
        sent.and(aborted).map(|()| false)
    }

    /// Sends these bytes in equal parts, in parallel.
    fn send_parts(&self, upload: &mut dyn MultipartUpload, key: &str, bytes: Vec<u8>) -> Result<()> {
        let bytes = Bytes::from(bytes);
        let starts = (0..bytes.len()).step_by(PART);
        let parts =
            starts.map(|start| upload.put_part(bytes.slice(start..bytes.len().min(start + PART)).into()));
        self.wait(try_join_all(parts)).map_err(self.error("write", key)).map(drop)
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
                fs::write(place.path("source"), &data).unwrap();
                let content = store.upload(&place.outside(), "source", &mut |_| Ok(false)).unwrap();
                assert_eq!(content, Fingerprint::of([&data]));
                let mut back = Vec::new();
                let sink = &mut |piece: Bytes| {
                    back.extend_from_slice(&piece);
                    Ok(())
                };
                assert_eq!(store.fetch(&blob_key(content.digest), sink).unwrap(), Some(content));
                assert!(back == data, "{size}");
            }
        }
    }

    #[test]
    fn kept_blobs_are_not_written_and_no_temporary_file_stays() {
        for place in Place::all() {
            let store = place.store();
            fs::write(place.path("source"), "abc").unwrap();
            let upload = |key, kept| store.upload(&place.outside(), key, &mut |_| Ok(kept));
            let content = upload("source", true).unwrap();
            assert_eq!(store.inspect(&blob_key(content.digest)).unwrap(), None);
            assert_eq!(upload("source", false).unwrap(), content);
            assert_eq!(store.inspect(&blob_key(content.digest)).unwrap(), Some(content));
            assert!(upload("missing", false).is_err());
            if let Some(folder) = store.folder.as_deref() {
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
            let content = Fingerprint::of([bytes(size)]);
            let mut changed = bytes(size);
            changed[size - 1] ^= 1;
            for changed in [changed, bytes(size + 1)] {
                fs::write(place.path("source"), changed).unwrap();
                assert!(!store.send(content, &place.outside(), "source").unwrap());
                assert_eq!(store.inspect(&blob_key(content.digest)).unwrap(), None);
            }
        }
    }
}
