//! A registry: opening it, listing what it holds, finding a version.

use std::collections::BTreeMap;
use std::fmt;
use std::fs;

use serde::{Deserialize, Serialize};

use crate::alias::AliasName;
use crate::digest::Digest;
use crate::error::{Error, Result};
use crate::location::Location;
use crate::log::Remark;
use crate::manifest::{Descriptor, Manifest};
use crate::name::ModelName;
use crate::probe::{PROBE, probe};
use crate::problem::{Fault, Problem};
use crate::reference::{ModelRef, Selector};
use crate::store::{DOCUMENT_LIMIT, LAST_VERSION, MODELS, Store, blob_key, version_key, versions_key};

const MARKER: &str = "registry.json";
const FORMAT: &str = "flowservo-registry";
const FORMAT_VERSION: u32 = 1;

/// Versioned, immutable checkpoints at one place. Several processes may use it at once.
#[derive(Debug, Clone)]
pub struct Registry {
    pub(crate) store: Store,
}

/// A model, the numbers of its versions, and what is said about them.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct Model {
    /// Its name.
    pub name: ModelName,
    /// The numbers of its versions, in rising order.
    pub versions: Vec<u64>,
    /// The numbers of those that are yanked, in rising order.
    pub yanked: Vec<u64>,
    /// The numbers of those that have an alias.
    pub aliases: BTreeMap<AliasName, u64>,
}

/// One published version, verified: its manifest is the one that was published.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[non_exhaustive]
pub struct ModelVersion {
    /// The model.
    pub name: ModelName,
    /// Number of the version, from 1.
    pub version: u64,
    /// Digest of the manifest: names this version in `NAME@sha256:...`.
    pub digest: Digest,
    /// Files, lineage and metrics.
    pub manifest: Manifest,
    /// What was said when it was yanked, if it is: a caller tells it to the user.
    pub yanked: Option<Remark>,
}

impl fmt::Display for ModelVersion {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}@{}", self.name, self.version)
    }
}

/// Content of `registry.json`.
#[derive(Debug, PartialEq, Eq, Serialize, Deserialize)]
struct Marker {
    format: String,
    version: u32,
}

impl Registry {
    /// Opens the registry at `location`.
    pub fn open(location: impl Into<Location>) -> Result<Self> {
        let location = location.into();
        let missing = || Error::NoRegistry { root: location.to_string() };
        if location.folder().is_some_and(|folder| !folder.is_dir()) {
            return Err(missing());
        }
        let registry = Self { store: Store::open(&location)? };
        if registry.check_marker()? { Ok(registry) } else { Err(missing()) }
    }

    /// Opens the registry at `location`, or creates one there if the place is new or empty and the store can hold one, as
    /// [`Registry::probe`] finds out.
    pub fn init(location: impl Into<Location>) -> Result<Self> {
        let location = location.into();
        if let Some(folder) = location.folder() {
            fs::create_dir_all(folder).map_err(Error::io("create the folder", folder))?;
        }
        Self::on(Store::open(&location)?)
    }

    /// Finds out whether the store creates an object only where there is none, by doing it; [`Error::Unfit`] if not.
    pub fn probe(&self) -> Result<()> {
        probe(&self.store)
    }

    /// Opens or creates a registry on `store`.
    pub(crate) fn on(store: Store) -> Result<Self> {
        let registry = Self { store };
        let listing = registry.store.list("")?;
        // Looked for after listing: another process creates the marker before anything else.
        if registry.check_marker()? {
            return Ok(registry);
        }
        // Others may be creating this registry at the same time.
        let of_probe = |object: &String| object.starts_with(PROBE);
        let mut content =
            listing.folders.into_iter().chain(listing.objects).filter(|object| !of_probe(object));
        if let Some(found) = content.next() {
            return Err(Error::Occupied { root: registry.store.root().to_owned(), found });
        }
        registry.probe()?;
        let marker = format!("{{\"format\":\"{FORMAT}\",\"version\":{FORMAT_VERSION}}}\n");
        registry.store.create(MARKER, marker.into_bytes())?;
        registry.check_marker()?;
        Ok(registry)
    }

    /// Whether this is a registry; an error if it is one of another format.
    fn check_marker(&self) -> Result<bool> {
        let Some(bytes) = self.store.read(MARKER)? else { return Ok(false) };
        let refuse = |reason| Error::Format { root: self.store.root().to_owned(), reason };
        let marker: Marker = serde_json::from_slice(&bytes).map_err(|error| refuse(error.to_string()))?;
        if marker == (Marker { format: FORMAT.into(), version: FORMAT_VERSION }) {
            return Ok(true);
        }
        Err(refuse(format!(
            "format is `{}` version {}, this program reads `{FORMAT}` version {FORMAT_VERSION}; use the program that \
             wrote it",
            marker.format, marker.version
        )))
    }

    /// All models, their version numbers, aliases and yanked versions, sorted by name. Reads no manifest: [`Registry::show`] does,
    /// one by one.
    pub fn list(&self) -> Result<Vec<Model>> {
        let mut models = Vec::new();
        for (name, versions) in self.published()? {
            let (yanked, aliases) = (self.yanked_versions(&name)?, self.aliases(&name)?);
            models.push(Model { name, versions, yanked, aliases });
        }
        Ok(models)
    }

    /// The names of all models and the numbers of their versions.
    fn published(&self) -> Result<BTreeMap<ModelName, Vec<u64>>> {
        let mut models = BTreeMap::new();
        for name in self.store.list(MODELS)?.folders.into_iter().filter_map(|name| name.parse().ok()) {
            let versions = self.versions(&name)?;
            if !versions.is_empty() {
                models.insert(name, versions);
            }
        }
        Ok(models)
    }

    /// The numbers of the versions of `name`, in rising order; none if there is no such model.
    pub(crate) fn versions(&self, name: &ModelName) -> Result<Vec<u64>> {
        let objects = self.store.list(&versions_key(name))?.objects;
        let mut versions: Vec<_> = objects.iter().filter_map(|object| version_number(object)).collect();
        versions.sort_unstable();
        Ok(versions)
    }

    /// The version that `reference` names, with its manifest verified; its files are not read.
    pub fn show(&self, reference: &ModelRef) -> Result<ModelVersion> {
        let version = self.load(&reference.name, self.find(reference)?)?;
        let yanked = self.yanked(&version.name, version.version)?;
        Ok(ModelVersion { yanked, ..version })
    }

    /// Number of the version that `reference` names.
    pub(crate) fn find(&self, reference: &ModelRef) -> Result<u64> {
        let name = &reference.name;
        let versions = self.versions(name)?;
        let Some(&newest) = versions.last() else { return Err(self.no_model(name)?) };
        let found = match &reference.selector {
            Selector::Newest => Some(self.newest(name, &versions)?),
            Selector::Alias(alias) => Some(self.aliased(name, alias)?),
            Selector::Version(number) => versions.binary_search(number).is_ok().then_some(*number),
            Selector::Digest(digest) => {
                let keys: Vec<_> = versions.iter().map(|&number| version_key(name, number)).collect();
                let manifests = self.store.read_each(&keys)?;
                let found = manifests.iter().position(|bytes| Digest::of(bytes) == *digest);
                found.map(|index| versions[index])
            }
        };
        let newest = format!("{name}@{newest}");
        found.ok_or_else(|| Error::NoVersion { reference: reference.to_string(), newest })
    }

    /// The highest of `versions`, all those of `name`, that is not yanked.
    fn newest(&self, name: &ModelName, versions: &[u64]) -> Result<u64> {
        for &number in versions.iter().rev() {
            if self.yanked(name, number)?.is_none() {
                return Ok(number);
            }
        }
        let newest = format!("{name}@{}", versions.last().unwrap_or(&0));
        Err(Error::AllYanked { name: name.to_string(), newest })
    }

    pub(crate) fn no_model(&self, name: &ModelName) -> Result<Error> {
        let models = self.published()?;
        let known = models.keys().map(ModelName::as_str).collect::<Vec<_>>().join(", ");
        let known = if known.is_empty() { "none".to_owned() } else { known };
        Ok(Error::NoModel { root: self.store.root().to_owned(), name: name.to_string(), known })
    }

    /// The manifest of a version as it is stored.
    pub(crate) fn manifest_bytes(&self, version: &ModelVersion) -> Result<Vec<u8>> {
        let key = version_key(&version.name, version.version);
        let bytes = self.store.read(&key)?.unwrap_or_default();
        if Digest::of(&bytes) == version.digest {
            return Ok(bytes);
        }
        let fault = Fault::Altered { digest: Digest::of(&bytes) };
        Err(Problem { model: Some(version.to_string()), file: None, object: key, fault }.into())
    }

    /// Version `number` of `name`; [`Error::Damaged`] if its manifest is not the one that was published.
    pub(crate) fn load(&self, name: &ModelName, number: u64) -> Result<ModelVersion> {
        let (model, object) = (format!("{name}@{number}"), version_key(name, number));
        let (bytes, digest) = self.proven(&model, &object)?;
        match Manifest::parse(&bytes, name, number) {
            Ok(manifest) => {
                Ok(ModelVersion { name: name.clone(), version: number, digest, manifest, yanked: None })
            }
            Err(reason) => {
                let fault = Fault::Malformed { reason };
                Err(Problem { model: Some(model), file: None, object, fault }.into())
            }
        }
    }

    /// The numbered object `key`, which is about `subject`, and its digest, proven by its copy among the blobs.
    pub(crate) fn proven(&self, subject: &str, key: &str) -> Result<(Vec<u8>, Digest)> {
        let problem = |object: &str, fault| -> Error {
            Problem { model: Some(subject.to_owned()), file: None, object: object.to_owned(), fault }.into()
        };
        let Some(bytes) = self.store.read(key)? else { return Err(problem(key, Fault::Missing)) };
        if bytes.len() as u64 > DOCUMENT_LIMIT {
            let reason = format!("it has more than {DOCUMENT_LIMIT} bytes");
            return Err(problem(key, Fault::Malformed { reason }));
        }
        let digest = Digest::of(&bytes);
        match self.store.inspect_blob(digest)? {
            None => Err(problem(key, Fault::Altered { digest })),
            Some(found) if found.digest != digest => {
                let fault = Fault::Digest { expected: digest, found: found.digest };
                Err(problem(&blob_key(digest), fault))
            }
            Some(_) => Ok((bytes, digest)),
        }
    }

    /// The content of a small blob that `descriptor` describes, verified. `model` is what it belongs to.
    pub(crate) fn document(&self, model: &str, descriptor: &Descriptor) -> Result<Vec<u8>> {
        let problem = |fault| -> Error {
            let (model, file) = (Some(model.to_owned()), descriptor.path().map(str::to_owned));
            Problem { model, file, object: blob_key(descriptor.digest), fault }.into()
        };
        if descriptor.size > DOCUMENT_LIMIT {
            let reason = format!("it would have {} bytes, more than {DOCUMENT_LIMIT}", descriptor.size);
            return Err(problem(Fault::Malformed { reason }));
        }
        let mut bytes = Vec::new();
        let found = self.store.read_blob(descriptor.digest, &mut |piece| {
            // What is stored may be larger than what is described; it is refused below.
            if bytes.len() as u64 <= descriptor.size {
                bytes.extend_from_slice(piece);
            }
            Ok(())
        })?;
        Fault::of_blob(descriptor.content(), found).map_or(Ok(bytes), |fault| Err(problem(fault)))
    }
}

/// Number in the name of a numbered manifest, `000007.json`.
pub(crate) fn version_number(object: &str) -> Option<u64> {
    folder_number(object.strip_suffix(".json")?)
}

/// Number in the name of a folder that belongs to one version, `000007`.
pub(crate) fn folder_number(folder: &str) -> Option<u64> {
    let number = folder.parse().ok()?;
    ((1..=LAST_VERSION).contains(&number) && folder == format!("{number:06}")).then_some(number)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fixture::Place;

    #[test]
    fn finds_versions_by_number_digest_and_age() {
        for place in Place::all() {
            let registry = place.registry();
            let first = place.publish(&registry, "approach", b"one");
            let second = place.publish(&registry, "approach", b"two");
            place.publish(&registry, "avoid", b"one");
            let show = |text: &str| registry.show(&text.parse().unwrap());
            assert_eq!(show("approach@1").unwrap(), first);
            assert_eq!(show("approach").unwrap(), second);
            assert_eq!(show(&format!("approach@{}", first.digest)).unwrap(), first);
            let listed: Vec<_> = registry
                .list()
                .unwrap()
                .into_iter()
                .map(|model| (model.name.to_string(), model.versions))
                .collect();
            assert_eq!(listed, [("approach".into(), vec![1, 2]), ("avoid".into(), vec![1])]);

            let missing = show("approach@3").unwrap_err().to_string();
            assert!(
                missing.contains("`approach@3`") && missing.contains("newest is approach@2"),
                "{missing}"
            );
            let other = show(&format!("avoid@{}", first.digest)).unwrap_err();
            assert!(matches!(other, Error::NoVersion { .. }));
            let unknown = show("aproach").unwrap_err().to_string();
            assert!(unknown.contains("published are: approach, avoid"), "{unknown}");
        }
    }

    #[test]
    fn opens_registries_only() {
        let place = Place::local();
        let root = place.path("registry");
        assert!(matches!(Registry::open(&root), Err(Error::NoRegistry { .. })));
        Registry::init(&root).unwrap();
        Registry::init(&root).unwrap();
        assert!(Registry::open(&root).unwrap().list().unwrap().is_empty());

        fs::write(root.join(MARKER), r#"{"format":"flowservo-registry","version":2}"#).unwrap();
        let newer = Registry::open(&root).unwrap_err().to_string();
        assert!(newer.contains("registry.json") && newer.contains("version 2"), "{newer}");

        let occupied = place.checkpoint("runs", b"w");
        assert!(matches!(Registry::init(&occupied), Err(Error::Occupied { .. })));
        assert!(!occupied.join(MARKER).exists());
    }

    #[test]
    fn numbers_of_manifests() {
        assert_eq!(version_number("000007.json"), Some(7));
        for stray in [
            "7.json",
            "000000.json",
            "+00007.json",
            "000007.json.bak",
            "x.json",
            "0000007.json",
            "1234567.json",
        ] {
            assert_eq!(version_number(stray), None, "{stray}");
        }
        assert_eq!(folder_number("000003"), Some(3));
        for stray in ["3", "000000", "0000003", "00003x"] {
            assert_eq!(folder_number(stray), None, "{stray}");
        }
    }
}
