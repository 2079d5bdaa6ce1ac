//! How a file becomes a blob.
//!
//! A folder takes it in one pass: it is copied beside the blobs while it is hashed, and gets the name of its digest when that
//! is known. A bucket wants the name first: there the file is hashed, then sent, and hashed again on the way, since it may
//! have changed in between.

use std::fs::{self, File};
use std::io::{ErrorKind, Write};
use std::path::{Path, PathBuf};

use bytes::Bytes;
use futures_util::StreamExt;
use futures_util::stream::FuturesUnordered;
use object_store::path::Path as Key;
use object_store::{MultipartUpload, ObjectStoreExt, UploadPart};

use crate::checkpoint::fingerprint;
use crate::digest::{Digest, Fingerprint, hash_meanwhile};
use crate::error::{Error, Result};
use crate::plain;
use crate::store::{BLOBS, PIECE, Store, blob_key, read_part};

/// Bytes of a part of a large blob. Object stores want equal parts of at least 5 MiB.
const PART: usize = 8 << 20;

/// How many parts are under way at a time.
const PARTS_UNDER_WAY: usize = 3;

/// Says that a blob is there and will stay: it need not be written.
pub(crate) type IsKept<'a> = &'a mut dyn FnMut(Fingerprint) -> Result<bool>;

impl Store {
    /// Stores what the file `source` holds, unless it `is_kept`, and says what that is.
    pub(crate) fn ingest(&self, source: &Path, is_kept: IsKept) -> Result<Fingerprint> {
        match self.folder() {
            Some(folder) => {
                self.check(BLOBS)?;
                copy(source, folder, is_kept)
            }
            None => self.send(source, is_kept),
        }
    }

    /// Hashes the file and sends it to where its digest says.
    fn send(&self, source: &Path, is_kept: IsKept) -> Result<Fingerprint> {
        let content = fingerprint(source)?;
        if !is_kept(content)? && !self.send_as(content, source)? {
            let reason =
                "the file changed while it was published; publish again when it is complete".to_owned();
            return Err(Error::Checkpoint { path: source.to_owned(), reason });
        }
        Ok(content)
    }

    /// Sends the file `source`, if it still holds `content`; false if it does not, and then nothing is stored.
    fn send_as(&self, content: Fingerprint, source: &Path) -> Result<bool> {
        let mut file = File::open(source).map_err(Error::io("read", source))?;
        if content.size <= PART as u64 {
            let part = read_part(&mut file, PART).map_err(Error::io("read", source))?;
            let matches = Digest::of(&part) == content.digest;
            if matches {
                self.put_blob(content.digest, part)?;
            }
            return Ok(matches);
        }
        let key = blob_key(content.digest);
        let mut upload = self
            .wait(self.objects.put_multipart(&Key::from(key.as_str())))
            .map_err(self.error("write", &key))?;
        let sent = self.send_parts(upload.as_mut(), &key, &mut file, source);
        if matches!(sent, Ok(found) if found == content) {
            self.wait(upload.complete()).map_err(self.error("write", &key))?;
            return Ok(true);
        }
        let aborted = self.wait(upload.abort()).map_err(self.error("abort the upload of", &key));
        // The first error is the one to tell.
        sent.and(aborted).map(|()| false)
    }

    /// Sends all of `file`; what it held.
    fn send_parts(
        &self,
        upload: &mut dyn MultipartUpload,
        key: &str,
        file: &mut File,
        source: &Path,
    ) -> Result<Fingerprint> {
        let mut under_way = FuturesUnordered::<UploadPart>::new();
        let sent = hash_meanwhile(|hash| {
            loop {
                let part = Bytes::from(read_part(file, PART).map_err(Error::io("read", source))?);
                let at_most = if part.is_empty() { 0 } else { PARTS_UNDER_WAY - 1 };
                while under_way.len() > at_most
                    && let Some(sent) = self.wait(under_way.next())
                {
                    sent.map_err(self.error("write", key))?;
                }
                if part.is_empty() {
                    return Ok(());
                }
                hash(part.clone());
                under_way.push(upload.put_part(part.into()));
            }
        });
        sent.map(|((), content)| content)
    }
}

/// Copies the file into the store in `folder`.
fn copy(source: &Path, folder: &Path, is_kept: IsKept) -> Result<Fingerprint> {
    let mut file = File::open(source).map_err(Error::io("read", source))?;
    let mut staged = Staged::new(&folder.join(BLOBS))?;
    let ((), content) = hash_meanwhile(|hash| {
        loop {
            let part = Bytes::from(read_part(&mut file, PIECE).map_err(Error::io("read", source))?);
            if part.is_empty() {
                // What was said to be published must outlive a power cut.
                return staged.file.sync_all().map_err(Error::io("write", &staged.path));
            }
            hash(part.clone());
            staged.file.write_all(&part).map_err(Error::io("write", &staged.path))?;
        }
    })?;
    if !is_kept(content)? {
        let key = blob_key(content.digest);
        plain::check(folder, &key)?;
        let blob = folder.join(key);
        let parent = blob.parent().unwrap_or(folder);
        create_folder(parent)?;
        staged.rename(&blob)?;
        sync_folder(parent)?;
    }
    Ok(content)
}

/// A file under way, removed when dropped, unless it was renamed. Named as the store names its own, so that no listing shows
/// it and `gc` finds what a crash leaves.
struct Staged {
    file: File,
    path: PathBuf,
    /// Its former name may be another process's by now.
    renamed: bool,
}

impl Staged {
    fn new(folder: &Path) -> Result<Self> {
        create_folder(folder)?;
        let mut number = 1_u64;
        loop {
            let path = folder.join(format!("ingest#{number}"));
            match File::create_new(&path) {
                Ok(file) => return Ok(Self { file, path, renamed: false }),
                Err(error) if error.kind() == ErrorKind::AlreadyExists => number += 1,
                Err(error) => return Err(Error::io("write", &path)(error)),
            }
        }
    }

    fn rename(mut self, blob: &Path) -> Result<()> {
        fs::rename(&self.path, blob).map_err(Error::io("write", blob))?;
        self.renamed = true;
        Ok(())
    }
}

impl Drop for Staged {
    fn drop(&mut self) {
        if !self.renamed {
            // What cannot be removed is found by `gc`; there is nobody left to tell.
            let _ = fs::remove_file(&self.path);
        }
    }
}

/// Creates a folder, and those above it, so that they outlive a power cut.
fn create_folder(folder: &Path) -> Result<()> {
    if folder.is_dir() {
        return Ok(());
    }
    let parent = folder.parent().unwrap_or(Path::new(""));
    create_folder(parent)?;
    match fs::create_dir(folder) {
        // Others create it at the same time.
        Err(error) if error.kind() != ErrorKind::AlreadyExists => {
            Err(Error::io("create the folder", folder)(error))
        }
        _ => sync_folder(parent),
    }
}

/// Makes the names in a folder durable; only Unix lets a folder be opened for that.
fn sync_folder(folder: &Path) -> Result<()> {
    if cfg!(unix) {
        File::open(folder).and_then(|folder| folder.sync_all()).map_err(Error::io("write", folder))?;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fixture::{Place, bytes};

    /// Sizes around the part size, so that one put, two full parts and a short last part all occur.
    #[test]
    fn blobs_of_any_size_come_back() {
        for place in Place::all() {
            let store = place.store();
            for size in [0, 1, PART, PART + 1, 2 * PART] {
                let data = bytes(size);
                let source = place.path("source");
                fs::write(&source, &data).unwrap();
                let content = store.ingest(&source, &mut |_| Ok(false)).unwrap();
                assert_eq!(content, Fingerprint::of(&data[..]).unwrap());
                let mut back = Vec::new();
                let sink = &mut |piece: &[u8]| {
                    back.extend_from_slice(piece);
                    Ok(())
                };
                assert_eq!(store.read_blob(content.digest, sink).unwrap(), Some(content));
                assert!(back == data, "{size}");
            }
        }
    }

    #[test]
    fn what_is_kept_is_not_written_and_nothing_stays_beside() {
        for place in Place::all() {
            let store = place.store();
            let source = place.path("source");
            fs::write(&source, "abc").unwrap();
            let content = store.ingest(&source, &mut |_| Ok(true)).unwrap();
            assert_eq!(store.inspect_blob(content.digest).unwrap(), None);
            assert_eq!(store.ingest(&source, &mut |_| Ok(false)).unwrap(), content);
            assert_eq!(store.inspect_blob(content.digest).unwrap(), Some(content));
            assert!(store.ingest(&place.path("missing"), &mut |_| Ok(false)).is_err());
            if let Some(folder) = store.folder() {
                let beside: Vec<_> = fs::read_dir(folder.join(BLOBS)).unwrap().collect();
                assert_eq!(beside.len(), 1, "{beside:?}");
            }
        }
    }

    #[test]
    fn a_source_that_changes_is_not_sent() {
        let [_, place] = Place::all();
        let store = place.store();
        for size in [10, PART + 10] {
            let content = Fingerprint::of(&bytes(size)[..]).unwrap();
            let mut changed = bytes(size);
            changed[size - 1] ^= 1;
            for changed in [changed, bytes(size + 1)] {
                fs::write(place.path("source"), changed).unwrap();
                assert!(!store.send_as(content, &place.path("source")).unwrap());
                assert_eq!(store.inspect_blob(content.digest).unwrap(), None);
            }
        }
    }
}
