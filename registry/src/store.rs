//! The create-only store beneath a registry.
//!
//! Driven synchronously: a folder does its work inside the poll, with no runtime around it; a bucket has a runtime of its own.

use std::future::Future;
use std::io::{self, Read};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::SystemTime;

use bytes::Bytes;
use futures_util::{StreamExt, TryStreamExt, stream};
use object_store::local::LocalFileSystem;
use object_store::path::Path as Key;
use object_store::{GetResultPayload, ObjectMeta, ObjectStore, ObjectStoreExt, PutMode};

use crate::digest::{Digest, Fingerprint, Hasher, hash_meanwhile};
use crate::error::{Error, Result};
use crate::location::Location;
use crate::name::ModelName;
use crate::plain;
use crate::problem::Problem;

/// Largest manifest; OCI registries take no larger ones either.
pub(crate) const DOCUMENT_LIMIT: u64 = 4 << 20;

/// The highest number of a version: numbers have six digits, so that names sort as numbers do.
pub(crate) const LAST_VERSION: u64 = 999_999;

/// Folder of all blobs.
pub(crate) const BLOBS: &str = "blobs";

/// How many small objects are asked for at a time.
const REQUESTS_UNDER_WAY: usize = 16;

/// Bytes that are read from a file at a time.
pub(crate) const PIECE: usize = 1 << 20;

/// How often an object is asked for that is said to be there and is not.
const CREATE_ATTEMPTS: u32 = 8;

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
#[derive(Debug, Default)]
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
    pub(crate) objects: Arc<dyn ObjectStore>,
    /// Where the store is, for messages.
    root: String,
    /// Its folder, if it is one.
    folder: Option<PathBuf>,
    /// What a store on the network needs to get on.
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

    /// The store at `location`; a folder has to exist.
    pub(crate) fn open(location: &Location) -> Result<Self> {
        let root = location.to_string();
        match location {
            Location::Folder(folder) => {
                let opened = LocalFileSystem::new_with_prefix(folder);
                let objects = opened.map_err(|source| Error::Store {
                    action: "open the folder",
                    place: root.clone(),
                    source,
                })?;
                // What was said to be published must outlive a power cut.
                Ok(Self::new(Arc::new(objects.with_fsync(true)), root).in_folder(folder))
            }
            #[cfg(feature = "s3")]
            Location::Bucket { bucket, prefix } => {
                let objects = crate::bucket::open(bucket, prefix, &root)?;
                let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build();
                let runtime = runtime.map_err(Error::io("start a runtime for", Path::new(&root)))?;
                Ok(Self { runtime: Some(Arc::new(runtime)), ..Self::new(objects, root) })
            }
        }
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

    /// Waits for what the store does.
    #[cfg_attr(not(feature = "s3"), expect(clippy::unused_self))]
    pub(crate) fn wait<F: Future>(&self, work: F) -> F::Output {
        #[cfg(feature = "s3")]
        if let Some(runtime) = &self.runtime {
            return runtime.block_on(work);
        }
        pollster::block_on(work)
    }

    /// Writes a small object under a key that is free; false if it is taken by something else, and then nothing is changed.
    ///
    /// If exactly these bytes are there, they count as written: where an answer is lost, the store is asked again, and then
    /// says of what it wrote itself that it is there.
    pub(crate) fn create(&self, key: &str, bytes: Vec<u8>) -> Result<bool> {
        let bytes = Bytes::from(bytes);
        for _ in 0..CREATE_ATTEMPTS {
            if self.try_create(key, bytes.clone())? {
                return Ok(true);
            }
            // Nothing is there if two asked at the same moment and the server let neither have it (S3's answer 409).
            if let Some(found) = self.read(key)? {
                return Ok(found == bytes);
            }
        }
        Ok(false)
    }

    /// Asks once for a small object to be written if there is none; false if the store says that there is one.
    pub(crate) fn try_create(&self, key: &str, bytes: Bytes) -> Result<bool> {
        self.check(key)?;
        match self.wait(self.objects.put_opts(&Key::from(key), bytes.into(), PutMode::Create.into())) {
            Ok(_) => Ok(true),
            Err(object_store::Error::AlreadyExists { .. }) => Ok(false),
            Err(source) => Err(self.error("create", key)(source)),
        }
    }

    /// Writes a small object whatever was there.
    pub(crate) fn put(&self, key: &str, bytes: Vec<u8>) -> Result<()> {
        self.check(key)?;
        let put = self.wait(self.objects.put(&Key::from(key), bytes.into()));
        put.map_err(self.error("write", key)).map(drop)
    }

    /// Removes an object.
    pub(crate) fn remove(&self, key: &str) -> Result<()> {
        self.check(key)?;
        self.wait(self.objects.delete(&Key::from(key))).map_err(self.error("remove", key))
    }

    /// A small object; `None` if there is none. Of a larger one than [`DOCUMENT_LIMIT`], one byte more than the limit.
    pub(crate) fn read(&self, key: &str) -> Result<Option<Vec<u8>>> {
        let mut bytes = Vec::new();
        let found = self.scan(key, DOCUMENT_LIMIT + 1, &mut |piece| {
            bytes.extend_from_slice(&piece);
            Ok(())
        })?;
        Ok(found.then_some(bytes))
    }

    /// Small objects in the order of their keys; empty where there is none, or one larger than [`DOCUMENT_LIMIT`]. Several
    /// are asked for at a time: a bucket is far away.
    pub(crate) fn read_each(&self, keys: &[String]) -> Result<Vec<Bytes>> {
        keys.iter().try_for_each(|key| self.check(key))?;
        let read = async |key: &String| match self.objects.get(&Key::from(key.as_str())).await {
            Ok(found) if found.meta.size <= DOCUMENT_LIMIT => {
                found.bytes().await.map_err(self.error("read", key))
            }
            Ok(_) | Err(object_store::Error::NotFound { .. }) => Ok(Bytes::new()),
            Err(source) => Err(self.error("read", key)(source)),
        };
        self.wait(stream::iter(keys).map(read).buffered(REQUESTS_UNDER_WAY).try_collect())
    }

    /// Gives at most `limit` bytes of an object to `sink`, piece by piece; false if there is no such object.
    fn scan(&self, key: &str, limit: u64, sink: &mut dyn FnMut(Bytes) -> Result<()>) -> Result<bool> {
        self.check(key)?;
        let found = match self.wait(self.objects.get(&Key::from(key))) {
            Ok(found) => found,
            Err(object_store::Error::NotFound { .. }) => return Ok(false),
            Err(source) => return Err(self.error("read", key)(source)),
        };
        match found.payload {
            GetResultPayload::File(file, path) => {
                let mut file = file.take(limit);
                // A byte more, so that the end is seen at once.
                let size = usize::try_from(found.meta.size).unwrap_or(PIECE).min(PIECE) + 1;
                loop {
                    let piece = read_part(&mut file, size).map_err(Error::io("read", &path))?;
                    if piece.is_empty() {
                        return Ok(true);
                    }
                    sink(piece.into())?;
                }
            }
            GetResultPayload::Stream(mut pieces) => {
                let mut left = limit;
                while let Some(piece) = self.wait(pieces.next()).filter(|_| left > 0) {
                    let mut piece = piece.map_err(self.error("read", key))?;
                    piece.truncate(usize::try_from(left).unwrap_or(usize::MAX));
                    left -= piece.len() as u64;
                    sink(piece)?;
                }
                Ok(true)
            }
        }
    }

    /// Gives the blob `digest` to `sink` and says what was really stored under that name; `None` if nothing was. The
    /// caller compares: a blob may be damaged.
    pub(crate) fn read_blob(
        &self,
        digest: Digest,
        sink: &mut dyn FnMut(&[u8]) -> Result<()>,
    ) -> Result<Option<Fingerprint>> {
        let (found, content) = hash_meanwhile(|hash| {
            self.scan(&blob_key(digest), u64::MAX, &mut |piece| {
                hash(piece.clone());
                sink(&piece)
            })
        })?;
        Ok(found.then_some(content))
    }

    /// What is really stored under the name `digest`.
    pub(crate) fn inspect_blob(&self, digest: Digest) -> Result<Option<Fingerprint>> {
        let mut hasher = Hasher::default();
        let found = self.scan(&blob_key(digest), u64::MAX, &mut |piece| {
            hasher.update(&piece);
            Ok(())
        })?;
        Ok(found.then(|| hasher.finish()))
    }

    /// Stores a blob that fits into memory.
    ///
    /// A blob's name is its content's, so writing over one of the same name is harmless, and mends a damaged one.
    pub(crate) fn put_blob(&self, digest: Digest, bytes: Vec<u8>) -> Result<()> {
        self.put(&blob_key(digest), bytes)
    }

    /// Refuses a key that leads out of the store; see [`crate::plain`].
    pub(crate) fn check(&self, key: &str) -> Result<()> {
        self.folder.as_ref().map_or(Ok(()), |root| plain::check(root, key))
    }

    /// What lies directly in the folder `prefix`, the root if it is empty; nothing if there is no such folder. Refused if a
    /// link or a special file is among it.
    pub(crate) fn list(&self, prefix: &str) -> Result<Listing> {
        let (listing, problems) = self.list_with_problems(prefix)?;
        problems.into_iter().next().map_or(Ok(listing), |first| Err(first.into()))
    }

    /// The same, with the links and special files beside it.
    pub(crate) fn list_with_problems(&self, prefix: &str) -> Result<(Listing, Vec<Problem>)> {
        if let Some(root) = &self.folder {
            plain::check(root, prefix)?;
            return plain::list(root, prefix);
        }
        let location = Key::from(prefix);
        let result = self
            .wait(self.objects.list_with_delimiter(Some(&location)))
            .map_err(self.error("list", prefix))?;
        let last = |key: &Key| key.filename().unwrap_or_default().to_owned();
        let mut listing = Listing {
            folders: result.common_prefixes.iter().map(last).collect(),
            objects: result.objects.iter().map(|meta| last(&meta.location)).collect(),
        };
        listing.folders.sort();
        listing.objects.sort();
        Ok((listing, Vec::new()))
    }

    /// The links and special files at any depth below the folder `prefix`.
    pub(crate) fn not_plain(&self, prefix: &str) -> Result<Vec<Problem>> {
        self.folder.as_ref().map_or(Ok(Vec::new()), |root| plain::find(root, prefix))
    }

    /// All objects below the folder `prefix`. Refused if a link or a special file is among them.
    pub(crate) fn walk(&self, prefix: &str) -> Result<Vec<Object>> {
        self.check(prefix)?;
        if let Some(first) = self.not_plain(prefix)?.into_iter().next() {
            return Err(first.into());
        }
        let mut found = Vec::new();
        let mut folders = vec![Key::from(prefix)];
        while let Some(folder) = folders.pop() {
            let result = self
                .wait(self.objects.list_with_delimiter(Some(&folder)))
                .map_err(self.error("list", folder.as_ref()))?;
            folders.extend(result.common_prefixes);
            found.extend(result.objects.into_iter().map(Object::from));
        }
        Ok(found)
    }

    /// What the store knows about the object `key`; none if there is none.
    pub(crate) fn object(&self, key: &str) -> Result<Option<Object>> {
        self.check(key)?;
        match self.wait(self.objects.head(&Key::from(key))) {
            Ok(meta) => Ok(Some(meta.into())),
            Err(object_store::Error::NotFound { .. }) => Ok(None),
            Err(source) => Err(self.error("read", key)(source)),
        }
    }

    pub(crate) fn error(&self, action: &'static str, key: &str) -> impl FnOnce(object_store::Error) -> Error {
        let place = format!("{}/{key}", self.root);
        #[cfg(feature = "s3")]
        return move |source| crate::bucket::error(action, place, source);
        #[cfg(not(feature = "s3"))]
        move |source| Error::Store { action, place, source }
    }

    /// The same store with other objects, for tests.
    #[cfg(all(test, feature = "s3"))]
    pub(crate) fn with_objects(self, objects: Arc<dyn ObjectStore>) -> Self {
        Self { objects, ..self }
    }
}

/// The next bytes of `reader`, fewer than `size` only at its end.
pub(crate) fn read_part(reader: &mut impl Read, size: usize) -> io::Result<Vec<u8>> {
    let mut part = Vec::with_capacity(size);
    reader.take(size as u64).read_to_end(&mut part)?;
    Ok(part)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fixture::{Place, bytes, quirky};
    use crate::quirk::Quirk;

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

    #[test]
    fn many_are_read_in_their_order() {
        for place in Place::all() {
            let store = place.store();
            let keys: Vec<_> = (0..3 * REQUESTS_UNDER_WAY).map(|number| format!("{number}.json")).collect();
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

    /// An answer that is lost, or a request that nobody wins, must not look like another's version: that would leave a gap.
    #[test]
    fn what_is_written_is_known_as_ones_own() {
        let store = quirky(Quirk::LosesAnswers);
        assert!(store.create("a.json", b"mine".to_vec()).unwrap());
        assert!(!store.create("a.json", b"other".to_vec()).unwrap());
        let store = quirky(Quirk::DeniesEveryOther);
        for key in ["a.json", "b.json", "c.json"] {
            assert!(store.create(key, b"mine".to_vec()).unwrap());
            assert!(!store.create(key, b"other".to_vec()).unwrap());
            assert_eq!(store.read(key).unwrap().unwrap(), b"mine");
        }
    }

    #[test]
    fn of_a_large_document_a_byte_too_many_is_read() {
        for place in Place::all() {
            let store = place.store();
            let data = bytes(DOCUMENT_LIMIT as usize + 7);
            store.put("large.json", data.clone()).unwrap();
            assert!(store.read("large.json").unwrap().unwrap() == data[..=DOCUMENT_LIMIT as usize]);
        }
    }
}
