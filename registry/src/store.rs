//! The create-only store beneath a registry: the only file that knows `object_store`.
//!
//! Driven synchronously: a local folder does its work inside the poll, with no runtime around it.

use std::fs::File;
use std::io::{self, Read};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::SystemTime;

use object_store::path::Path as Key;
use object_store::{MultipartUpload, ObjectMeta, ObjectStore, ObjectStoreExt, PutMode};
use pollster::block_on;

use crate::digest::{Digest, Fingerprint, Hasher};
use crate::error::{Error, Result};
use crate::name::ModelName;

/// Largest manifest; OCI registries take no larger ones either.
pub(crate) const DOCUMENT_LIMIT: u64 = 4 << 20;

/// The highest number of a version: numbers have six digits, so that names sort as numbers do.
pub(crate) const LAST_VERSION: u64 = 999_999;

/// Bytes in memory at a time. Object stores want equal parts of at least 5 MiB.
const PART: usize = 8 << 20;

/// Folder of all blobs.
pub(crate) const BLOBS: &str = "blobs";

/// Folder of all models.
pub(crate) const MODELS: &str = "models";

/// Key of the blob with this digest.
pub(crate) fn blob_key(digest: Digest) -> String {
    let hex = digest.hex();
    format!("{BLOBS}/sha256/{}/{hex}", &hex[..2])
}

/// Folder of the numbered manifests of `name`.
pub(crate) fn versions_key(name: &ModelName) -> String {
    format!("{MODELS}/{name}/versions")
}

/// Key of the manifest of version `number` of `name`.
pub(crate) fn version_key(name: &ModelName, number: u64) -> String {
    format!("{}/{number:06}.json", versions_key(name))
}

/// What lies directly in one folder of the store: last parts of the keys, sorted.
#[derive(Debug)]
pub(crate) struct Listing {
    pub(crate) folders: Vec<String>,
    pub(crate) objects: Vec<String>,
}

/// What the store knows about an object without reading it.
#[derive(Debug)]
pub(crate) struct Object {
    pub(crate) key: String,
    pub(crate) size: u64,
    /// When it was written, by the store's clock.
    pub(crate) modified: SystemTime,
}

impl From<ObjectMeta> for Object {
    fn from(meta: ObjectMeta) -> Self {
        Self { key: meta.location.into(), size: meta.size, modified: meta.last_modified.into() }
    }
}

/// A store in which each object is written once.
#[derive(Debug, Clone)]
pub(crate) struct Store {
    objects: Arc<dyn ObjectStore>,
    /// Where the store is, for messages.
    root: String,
    /// Its folder, if it is one.
    folder: Option<PathBuf>,
}

impl Store {
    pub(crate) fn new(objects: Arc<dyn ObjectStore>, root: String) -> Self {
        Self { objects, root, folder: None }
    }

    /// Says that the store is the local folder `folder`.
    pub(crate) fn in_folder(self, folder: &Path) -> Self {
        Self { folder: Some(folder.to_owned()), ..self }
    }

    /// The local folder that the store is, if it is one.
    pub(crate) fn folder(&self) -> Option<&Path> {
        self.folder.as_deref()
    }

    /// Where the store is, for messages.
    pub(crate) fn root(&self) -> &str {
        &self.root
    }

    /// Writes a small object under a key that is free; false if it is taken, and then nothing is changed.
    pub(crate) fn create(&self, key: &str, bytes: Vec<u8>) -> Result<bool> {
        match block_on(self.objects.put_opts(&Key::from(key), bytes.into(), PutMode::Create.into())) {
            Ok(_) => Ok(true),
            Err(object_store::Error::AlreadyExists { .. }) => Ok(false),
            Err(source) => Err(self.error("create (the store must support create-if-absent)", key)(source)),
        }
    }

    /// A small object; `None` if there is none. Of a larger one than [`DOCUMENT_LIMIT`], one byte more than the limit.
    pub(crate) fn read(&self, key: &str) -> Result<Option<Vec<u8>>> {
        let mut bytes = Vec::new();
        let found = self.scan(key, DOCUMENT_LIMIT + 1, &mut |piece| {
            bytes.extend_from_slice(piece);
            Ok(())
        })?;
        Ok(found.then_some(bytes))
    }

    /// Gives at most `limit` bytes of an object to `sink`, piece by piece; false if there is no such object.
    fn scan(&self, key: &str, limit: u64, sink: &mut dyn FnMut(&[u8]) -> Result<()>) -> Result<bool> {
        let location = Key::from(key);
        let size = match block_on(self.objects.head(&location)) {
            Ok(meta) => meta.size.min(limit),
            Err(object_store::Error::NotFound { .. }) => return Ok(false),
            Err(source) => return Err(self.error("read", key)(source)),
        };
        let mut start = 0;
        while start < size {
            let end = size.min(start + PART as u64);
            let piece =
                block_on(self.objects.get_range(&location, start..end)).map_err(self.error("read", key))?;
            sink(&piece)?;
            start = end;
        }
        Ok(true)
    }

    /// Gives the blob `digest` to `sink` and says what was really stored under that name; `None` if nothing was. The
    /// caller compares: a blob may be damaged.
    pub(crate) fn read_blob(
        &self,
        digest: Digest,
        sink: &mut dyn FnMut(&[u8]) -> Result<()>,
    ) -> Result<Option<Fingerprint>> {
        let mut hasher = Hasher::default();
        let found = self.scan(&blob_key(digest), u64::MAX, &mut |piece| {
            hasher.update(piece);
            sink(piece)
        })?;
        Ok(found.then(|| hasher.finish()))
    }

    /// What is really stored under the name `digest`.
    pub(crate) fn inspect_blob(&self, digest: Digest) -> Result<Option<Fingerprint>> {
        self.read_blob(digest, &mut |_| Ok(()))
    }

    /// Stores a blob that fits into memory.
    ///
    /// A blob's name is its content's, so writing over one of the same name is harmless, and mends a damaged one.
    pub(crate) fn put_blob(&self, digest: Digest, bytes: Vec<u8>) -> Result<()> {
        let key = blob_key(digest);
        let put = block_on(self.objects.put(&Key::from(key.as_str()), bytes.into()));
        put.map_err(self.error("write", &key)).map(drop)
    }

    /// Stores the file `source`, if it holds `content`; false if it does not, and then nothing is stored.
    pub(crate) fn put_file(&self, content: Fingerprint, source: &Path) -> Result<bool> {
        let mut file = File::open(source).map_err(Error::io("read", source))?;
        if content.size <= PART as u64 {
            let part = read_part(&mut file).map_err(Error::io("read", source))?;
            let matches = Digest::of(&part) == content.digest;
            if matches {
                self.put_blob(content.digest, part)?;
            }
            return Ok(matches);
        }
        let key = blob_key(content.digest);
        let mut upload = block_on(self.objects.put_multipart(&Key::from(key.as_str())))
            .map_err(self.error("write", &key))?;
        let sent = self.send_parts(upload.as_mut(), &key, &mut file, source);
        if matches!(sent, Ok(found) if found == content) {
            block_on(upload.complete()).map_err(self.error("write", &key))?;
            return Ok(true);
        }
        let aborted = block_on(upload.abort()).map_err(self.error("abort the upload of", &key));
        // The first error is the one to tell.
        sent.and(aborted).map(|()| false)
    }

    fn send_parts(
        &self,
        upload: &mut dyn MultipartUpload,
        key: &str,
        file: &mut File,
        source: &Path,
    ) -> Result<Fingerprint> {
        let mut hasher = Hasher::default();
        loop {
            let part = read_part(file).map_err(Error::io("read", source))?;
            if part.is_empty() {
                return Ok(hasher.finish());
            }
            hasher.update(&part);
            block_on(upload.put_part(part.into())).map_err(self.error("write", key))?;
        }
    }

    /// What lies directly in the folder `prefix`, the root if it is empty; nothing if there is no such folder.
    pub(crate) fn list(&self, prefix: &str) -> Result<Listing> {
        let location = Key::from(prefix);
        let result = block_on(self.objects.list_with_delimiter(Some(&location)))
            .map_err(self.error("list", prefix))?;
        let last = |key: &Key| key.filename().unwrap_or_default().to_owned();
        let mut listing = Listing {
            folders: result.common_prefixes.iter().map(last).collect(),
            objects: result.objects.iter().map(|meta| last(&meta.location)).collect(),
        };
        listing.folders.sort();
        listing.objects.sort();
        Ok(listing)
    }

    /// All objects below the folder `prefix`.
    pub(crate) fn walk(&self, prefix: &str) -> Result<Vec<Object>> {
        let mut found = Vec::new();
        let mut folders = vec![Key::from(prefix)];
        while let Some(folder) = folders.pop() {
            let result = block_on(self.objects.list_with_delimiter(Some(&folder)))
                .map_err(self.error("list", folder.as_ref()))?;
            folders.extend(result.common_prefixes);
            found.extend(result.objects.into_iter().map(Object::from));
        }
        Ok(found)
    }

    /// What the store knows about the object `key`; none if there is none.
    pub(crate) fn object(&self, key: &str) -> Result<Option<Object>> {
        match block_on(self.objects.head(&Key::from(key))) {
            Ok(meta) => Ok(Some(meta.into())),
            Err(object_store::Error::NotFound { .. }) => Ok(None),
            Err(source) => Err(self.error("read", key)(source)),
        }
    }

    /// Removes an object.
    pub(crate) fn remove(&self, key: &str) -> Result<()> {
        block_on(self.objects.delete(&Key::from(key))).map_err(self.error("remove", key))
    }

    fn error(&self, action: &'static str, key: &str) -> impl FnOnce(object_store::Error) -> Error {
        let place = format!("{}/{key}", self.root);
        move |source| Error::Store { action, place, source }
    }
}

/// The next bytes of `file`, fewer than a part only at its end.
fn read_part(file: &mut File) -> io::Result<Vec<u8>> {
    let mut part = Vec::new();
    file.take(PART as u64).read_to_end(&mut part)?;
    Ok(part)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fixture::{Place, bytes};

    fn put(place: &Place, store: &Store, content: Fingerprint, bytes: &[u8]) -> bool {
        let source = place.path("source");
        std::fs::write(&source, bytes).unwrap();
        store.put_file(content, &source).unwrap()
    }

    #[test]
    fn created_once() {
        for place in Place::all() {
            let store = place.store();
            assert!(store.create("a/b.json", b"first".to_vec()).unwrap());
            assert!(!store.create("a/b.json", b"second".to_vec()).unwrap());
            assert_eq!(store.read("a/b.json").unwrap().unwrap(), b"first");
            assert_eq!(store.read("a/c.json").unwrap(), None);
            assert_eq!(store.list("").unwrap().folders, ["a"]);
            assert_eq!(store.list("a").unwrap().objects, ["b.json"]);
        }
    }

    /// Sizes around the part size, so that one put, two full parts and a short last part all occur.
    #[test]
    fn blobs_of_any_size_come_back() {
        for place in Place::all() {
            let store = place.store();
            for size in [0, 1, PART, PART + 1, 2 * PART] {
                let data = bytes(size);
                let content = Fingerprint::of(&data[..]).unwrap();
                assert!(put(&place, &store, content, &data));
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
    fn a_source_that_changes_is_not_stored() {
        for place in Place::all() {
            let store = place.store();
            for size in [10, PART + 10] {
                let content = Fingerprint::of(&bytes(size)[..]).unwrap();
                let mut changed = bytes(size);
                changed[size - 1] ^= 1;
                assert!(!put(&place, &store, content, &changed));
                assert!(!put(&place, &store, content, &bytes(size + 1)));
                assert_eq!(store.inspect_blob(content.digest).unwrap(), None);
            }
        }
    }
}
