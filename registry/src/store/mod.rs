//! The create-only store beneath a registry: a folder, or a bucket.
//!
//! The interface is synchronous. A folder works inside the poll, without a runtime. A bucket has a runtime of its own.

use std::future::Future;
use std::io::Read;
use std::panic::resume_unwind;
use std::path::PathBuf;
use std::sync::{Arc, mpsc};
use std::thread;
use std::time::SystemTime;

use bytes::Bytes;
use futures_util::{StreamExt, TryStreamExt, stream};
use object_store::local::LocalFileSystem;
use object_store::path::Path as Key;
use object_store::{GetResultPayload, ObjectMeta, ObjectStore, ObjectStoreExt, PutMode};

use crate::digest::{Digest, Fingerprint};
use crate::error::{Error, Result};
use crate::problem::Problem;

#[cfg(feature = "s3")]
mod bucket;
pub(crate) mod folder;
pub(crate) mod location;
#[cfg(test)]
pub(crate) mod misbehaving;
pub(crate) mod probe;
pub(crate) mod sequence;
pub(crate) mod staged;
pub(crate) mod upload;

use location::Location;

/// Size of the largest manifest or event. OCI registries take no larger manifests either.
pub(crate) const DOCUMENT_LIMIT: u64 = 4 << 20;

/// Folder of all blobs.
pub(crate) const BLOBS: &str = "blobs";

/// Folder of all models.
pub(crate) const MODELS: &str = "models";

/// Number of small objects that are requested in parallel.
const PARALLEL_REQUESTS: usize = 16;

/// Bytes that are read from a file at a time.
const PIECE: usize = 1 << 20;

/// Retries when the store reports a conflict but the object cannot be read.
const CREATE_ATTEMPTS: u32 = 8;

/// Returns the key of a blob.
pub(crate) fn blob_key(digest: Digest) -> String {
    let hex = digest.hex();
    format!("{BLOBS}/sha256/{}/{hex}", &hex[..2])
}

/// Returns the last part of a key.
pub(crate) fn file_name(key: &str) -> &str {
    key.rsplit_once('/').map_or(key, |(_, name)| name)
}

/// What the store knows about an object without reading it.
#[derive(Debug, Clone)]
pub(crate) struct Object {
    pub(crate) key: String,
    pub(crate) size: u64,
    /// Time of the last write, by the store's clock.
    pub(crate) modified: SystemTime,
}

impl From<ObjectMeta> for Object {
    fn from(meta: ObjectMeta) -> Self {
        Self { key: meta.location.into(), size: meta.size, modified: meta.last_modified.into() }
    }
}

/// Content of a folder of the store, sorted by key.
#[derive(Debug, Default)]
pub(crate) struct Listing {
    /// Keys of the folders in it. A bucket has no empty ones.
    pub(crate) folders: Vec<String>,
    /// Objects and, in a local store, half-written files.
    pub(crate) objects: Vec<Object>,
    /// Symbolic links and special files in a local store.
    pub(crate) problems: Vec<Problem>,
}

impl Listing {
    /// Fails if there are symbolic links or special files.
    pub(crate) fn checked(self) -> Result<Self> {
        match self.problems.first() {
            Some(first) => Err(first.clone().into()),
            None => Ok(self),
        }
    }
}

/// Receives the content of an object in pieces.
pub(crate) type Sink<'a> = &'a mut dyn FnMut(Bytes) -> Result<()>;

/// A store in which each object is written once.
#[derive(Debug, Clone)]
pub(crate) struct Store {
    objects: Arc<dyn ObjectStore>,
    /// Location, for messages.
    pub(crate) root: String,
    /// The local folder, if the store is one.
    pub(crate) folder: Option<PathBuf>,
    /// Drives requests over the network.
    #[cfg(feature = "s3")]
    runtime: Option<Arc<tokio::runtime::Runtime>>,
}

impl Store {
    pub(crate) fn new(objects: Arc<dyn ObjectStore>, root: String) -> Self {
        Self {
            objects,
            root,
            folder: None,
            #[cfg(feature = "s3")]
            runtime: None,
        }
    }

    /// Opens the store at `location`. A folder must exist.
    pub(crate) fn open(location: &Location) -> Result<Self> {
        let root = location.to_string();
        match location {
            Location::Folder(folder) => {
                let opened = LocalFileSystem::new_with_prefix(folder);
                let opened = opened.map_err(|source| error("open the folder", root.clone(), source))?;
                // What was published must survive a power failure.
                let objects = Arc::new(opened.with_fsync(true));
                Ok(Self { folder: Some(folder.clone()), ..Self::new(objects, root) })
            }
            #[cfg(feature = "s3")]
            Location::Bucket(place) => {
                let objects = bucket::open(place, &root)?;
                let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build();
                let runtime = runtime.map_err(Error::io("start a runtime for", root.as_ref()))?;
                Ok(Self { runtime: Some(Arc::new(runtime)), ..Self::new(objects, root) })
            }
        }
    }

    /// Blocks until `work` is done.
    #[cfg_attr(not(feature = "s3"), expect(clippy::unused_self))]
    fn wait<F: Future>(&self, work: F) -> F::Output {
        #[cfg(feature = "s3")]
        if let Some(runtime) = &self.runtime {
            return runtime.block_on(work);
        }
        pollster::block_on(work)
    }

    /// Converts a key for the object store, and refuses one that leads out of a local store. Every access by key goes
    /// through here.
    fn key(&self, key: &str) -> Result<Key> {
        if let Some(root) = &self.folder {
            folder::check(root, key)?;
        }
        Ok(Key::from(key))
    }

    /// Writes a small object under a key that must be free. Returns false, and changes nothing, if another object has the key.
    ///
    /// An object with exactly these bytes counts as written: when a response is lost, the request is retried, and the store
    /// then reports the object that the first request created.
    pub(crate) fn create(&self, key: &str, bytes: Vec<u8>) -> Result<bool> {
        let bytes = Bytes::from(bytes);
        for _ in 0..CREATE_ATTEMPTS {
            if self.try_create(key, bytes.clone())? {
                return Ok(true);
            }
            // Of two simultaneous requests, S3 may let neither win (status 409). Then there is no object yet.
            if let Some(found) = self.read(key)? {
                return Ok(found == bytes);
            }
        }
        Ok(false)
    }

    /// Requests once that a small object be created. Returns false if the store reports that the key is taken.
    pub(crate) fn try_create(&self, key: &str, bytes: Bytes) -> Result<bool> {
        match self.wait(self.objects.put_opts(&self.key(key)?, bytes.into(), PutMode::Create.into())) {
            Ok(_) => Ok(true),
            Err(object_store::Error::AlreadyExists { .. }) => Ok(false),
            Err(source) => Err(self.error("create", key)(source)),
        }
    }

    /// Writes a small object, and overwrites an existing one.
    pub(crate) fn put(&self, key: &str, bytes: Vec<u8>) -> Result<()> {
        let put = self.wait(self.objects.put(&self.key(key)?, bytes.into()));
        put.map_err(self.error("write", key)).map(drop)
    }

    /// Stores a small blob. Overwriting an existing one is harmless, and repairs a damaged one.
    pub(crate) fn put_blob(&self, bytes: Vec<u8>) -> Result<Digest> {
        let digest = Digest::of(&bytes);
        self.put(&blob_key(digest), bytes)?;
        Ok(digest)
    }

    /// Deletes an object or a half-written file.
    pub(crate) fn delete(&self, key: &str) -> Result<()> {
        let object = self.key(key)?;
        match &self.folder {
            // The object store refuses the names of half-written files.
            Some(root) => {
                let path = root.join(key);
                std::fs::remove_file(&path).map_err(Error::io("delete", &path))
            }
            None => self.wait(self.objects.delete(&object)).map_err(self.error("delete", key)),
        }
    }

    /// Reads a small object. Returns at most `DOCUMENT_LIMIT` + 1 bytes, so that the caller can detect an oversized one.
    pub(crate) fn read(&self, key: &str) -> Result<Option<Vec<u8>>> {
        Ok(self.read_start(key, DOCUMENT_LIMIT + 1)?.map(|(bytes, _)| bytes))
    }

    /// Reads the first bytes of an object, at most `limit`. Returns them and the size of the object.
    pub(crate) fn read_start(&self, key: &str, limit: u64) -> Result<Option<(Vec<u8>, u64)>> {
        let mut bytes = Vec::new();
        let size = self.scan(key, limit, &mut |piece| {
            bytes.extend_from_slice(&piece);
            Ok(())
        })?;
        Ok(size.map(|size| (bytes, size)))
    }

    /// Reads small objects, several in parallel because a bucket is far away. Missing and oversized objects are empty.
    pub(crate) fn read_each(&self, keys: &[String]) -> Result<Vec<Bytes>> {
        let keys = keys.iter().map(|key| self.key(key)).collect::<Result<Vec<_>>>()?;
        let read = async |key: &Key| match self.objects.get(key).await {
            Ok(found) if found.meta.size <= DOCUMENT_LIMIT => {
                found.bytes().await.map_err(self.error("read", key.as_ref()))
            }
            Ok(_) | Err(object_store::Error::NotFound { .. }) => Ok(Bytes::new()),
            Err(source) => Err(self.error("read", key.as_ref())(source)),
        };
        self.wait(stream::iter(&keys).map(read).buffered(PARALLEL_REQUESTS).try_collect())
    }

    /// Passes at most `limit` bytes of an object to `sink`, piece by piece. Returns its size, `None` if there is no such object.
    fn scan(&self, key: &str, limit: u64, sink: Sink) -> Result<Option<u64>> {
        let found = match self.wait(self.objects.get(&self.key(key)?)) {
            Ok(found) => found,
            Err(object_store::Error::NotFound { .. }) => return Ok(None),
            Err(source) => return Err(self.error("read", key)(source)),
        };
        let size = found.meta.size;
        let mut left = limit;
        match found.payload {
            GetResultPayload::File(mut file, path) => {
                // One byte more, so that a small file ends with the first read.
                let length = usize::try_from(size).unwrap_or(PIECE).min(PIECE) + 1;
                while left > 0 {
                    let mut piece = Vec::with_capacity(length);
                    let read = file.by_ref().take(left.min(length as u64)).read_to_end(&mut piece);
                    if read.map_err(Error::io("read", &path))? == 0 {
                        break;
                    }
                    left -= piece.len() as u64;
                    sink(piece.into())?;
                }
            }
            GetResultPayload::Stream(mut pieces) => {
                while let Some(piece) = self.wait(pieces.next()).filter(|_| left > 0) {
                    let mut piece = piece.map_err(self.error("read", key))?;
                    piece.truncate(usize::try_from(left).unwrap_or(usize::MAX));
                    left -= piece.len() as u64;
                    sink(piece)?;
                }
            }
        }
        Ok(Some(size))
    }

    /// Passes an object to `sink` and returns its fingerprint, `None` if there is no such object. Another thread computes it
    /// meanwhile: hashing takes about as long as reading or writing.
    pub(crate) fn fetch(&self, key: &str, sink: Sink) -> Result<Option<Fingerprint>> {
        thread::scope(|scope| {
            let (sender, pieces) = mpsc::sync_channel::<Bytes>(1);
            let hashing = scope.spawn(move || Fingerprint::of(pieces));
            let found = self.scan(key, u64::MAX, &mut |piece| {
                // Sending fails only if hashing panicked, which is propagated below.
                drop(sender.send(piece.clone()));
                sink(piece)
            });
            drop(sender);
            let content = hashing.join().unwrap_or_else(|panic| resume_unwind(panic));
            Ok(found?.map(|_| content))
        })
    }

    /// Returns the fingerprint of an object.
    pub(crate) fn inspect(&self, key: &str) -> Result<Option<Fingerprint>> {
        self.fetch(key, &mut |_| Ok(()))
    }

    /// Lists the folder `prefix`, or the root if it is empty. A missing folder is empty.
    pub(crate) fn list(&self, prefix: &str) -> Result<Listing> {
        let key = self.key(prefix)?;
        if let Some(root) = &self.folder {
            return folder::list(root, prefix);
        }
        let found = self.wait(self.objects.list_with_delimiter(Some(&key)));
        let found = found.map_err(self.error("list", prefix))?;
        let folders = found.common_prefixes.into_iter().map(String::from).collect();
        let objects = found.objects.into_iter().map(Object::from).collect();
        Ok(Listing { folders, objects, ..Listing::default() })
    }

    /// Lists everything at any depth below the folder `prefix`.
    pub(crate) fn walk(&self, prefix: &str) -> Result<Listing> {
        let key = self.key(prefix)?;
        if self.folder.is_none() {
            let found = self.wait(self.objects.list(Some(&key)).map_ok(Object::from).try_collect());
            let objects = found.map_err(self.error("list", prefix))?;
            return Ok(Listing { objects, ..Listing::default() });
        }
        let mut listing = self.list(prefix)?;
        let mut next = 0;
        while let Some(folder) = listing.folders.get(next) {
            let found = self.list(folder)?;
            listing.folders.extend(found.folders);
            listing.objects.extend(found.objects);
            listing.problems.extend(found.problems);
            next += 1;
        }
        Ok(listing)
    }

    fn error(&self, action: &'static str, key: &str) -> impl FnOnce(object_store::Error) -> Error {
        let place = format!("{}/{key}", self.root);
        move |source| error(action, place, source)
    }
}

#[cfg(feature = "s3")]
use bucket::error;

#[cfg(not(feature = "s3"))]
fn error(action: &'static str, place: String, source: object_store::Error) -> Error {
    Error::Failed { action, place, source: source.into() }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fixture::{Place, bytes, misbehaving};
    use crate::store::misbehaving::Misbehavior;

    #[test]
    fn created_once() {
        for place in Place::all() {
            let store = place.store();
            assert!(store.create("a/b.json", b"first".to_vec()).unwrap());
            assert!(!store.create("a/b.json", b"second".to_vec()).unwrap());
            assert_eq!(store.read("a/b.json").unwrap().unwrap(), b"first");
            assert_eq!(store.read("a/c.json").unwrap(), None);
            assert_eq!(store.list("").unwrap().folders, ["a"]);
            assert_eq!(store.list("a").unwrap().objects[0].key, "a/b.json");
        }
    }

    #[test]
    fn several_objects_are_read_in_order() {
        for place in Place::all() {
            let store = place.store();
            let keys: Vec<_> = (0..3 * PARALLEL_REQUESTS).map(|number| format!("{number}.json")).collect();
            for (number, key) in keys.iter().enumerate().filter(|(number, _)| number % 3 > 0) {
                // Every third is missing, another third too large.
                store
                    .put(key, bytes(if number % 3 == 1 { number } else { DOCUMENT_LIMIT as usize + 1 }))
                    .unwrap();
            }
            for (number, found) in store.read_each(&keys).unwrap().iter().enumerate() {
                assert_eq!(found.len(), if number % 3 == 1 { number } else { 0 });
            }
        }
    }

    /// A lost response, or a request that nobody wins, must not look like another writer's object: that would leave a gap.
    #[test]
    fn own_writes_are_recognized() {
        let store = misbehaving(Misbehavior::LosesAnswers);
        assert!(store.create("a.json", b"mine".to_vec()).unwrap());
        assert!(!store.create("a.json", b"other".to_vec()).unwrap());
        let store = misbehaving(Misbehavior::DeniesEveryOther);
        for key in ["a.json", "b.json", "c.json"] {
            assert!(store.create(key, b"mine".to_vec()).unwrap());
            assert!(!store.create(key, b"other".to_vec()).unwrap());
            assert_eq!(store.read(key).unwrap().unwrap(), b"mine");
        }
    }

    #[test]
    fn oversized_documents_can_be_detected() {
        for place in Place::all() {
            let store = place.store();
            let data = bytes(DOCUMENT_LIMIT as usize + 7);
            store.put("large.json", data.clone()).unwrap();
            assert!(store.read("large.json").unwrap().unwrap() == data[..=DOCUMENT_LIMIT as usize]);
        }
    }
}
