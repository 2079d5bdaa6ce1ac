//! A registry: creating and opening it, and loading the documents of its versions.

use std::fs;

use crate::error::{Error, Result};
use crate::model::{Descriptor, Manifest, ModelName, ModelVersion};
use crate::problem::{Fault, Problem};
use crate::store::folder::is_staged;
use crate::store::location::Location;
use crate::store::probe::{PROBE, probe};
use crate::store::sequence::pointer_key;
use crate::store::{MODELS, Store, blob_key, file_name};

const MARKER: &str = "registry.json";
const FORMAT: &str = "{\"format\":\"flowservo-registry\",\"version\":2}\n";

/// Versioned, immutable checkpoints at one location. Several processes may use a registry at once.
#[derive(Debug, Clone)]
pub struct Registry {
    pub(crate) store: Store,
}

/// Returns the folder of the numbered versions of `name`.
pub(crate) fn versions_key(name: &ModelName) -> String {
    format!("{MODELS}/{name}/versions")
}

impl Registry {
    /// Opens the registry at `location`.
    pub fn open(location: &Location) -> Result<Self> {
        let missing = || Error::NoRegistry(location.to_string());
        if location.folder().is_some_and(|folder| !folder.is_dir()) {
            return Err(missing());
        }
        let registry = Self { store: Store::open(location)? };
        if registry.check_marker()? { Ok(registry) } else { Err(missing()) }
    }

    /// Opens the registry at `location`, or creates one if the location is new or empty and the store passes
    /// [`Registry::probe`].
    pub fn init(location: &Location) -> Result<Self> {
        if let Some(folder) = location.folder() {
            fs::create_dir_all(folder).map_err(Error::io("create the folder", folder))?;
        }
        Self::on(Store::open(location)?)
    }

    /// Tests whether the store creates an object only if there is none. Fails with [`Error::Refused`] otherwise.
    pub fn probe(&self) -> Result<()> {
        probe(&self.store)
    }

    /// Opens or creates a registry on `store`.
    pub(crate) fn on(store: Store) -> Result<Self> {
        let registry = Self { store };
        let listing = registry.store.list("")?.checked()?;
        // Checked after listing: another process creates the marker before anything else.
        if registry.check_marker()? {
            return Ok(registry);
        }
        let objects = listing.objects.into_iter().map(|object| object.key);
        // Others may be creating this registry at the same time.
        let is_foreign = |key: &String| !key.starts_with(PROBE) && !is_staged(key);
        if let Some(found) = listing.folders.into_iter().chain(objects).find(is_foreign) {
            let reason = format!(
                "the folder holds `{found}` but no {MARKER}; choose an empty or new folder for the registry"
            );
            return Err(Error::refused(&registry.store.root, reason));
        }
        registry.probe()?;
        registry.store.create(MARKER, FORMAT.into())?;
        registry.check_marker()?;
        Ok(registry)
    }

    /// Returns whether there is a registry. Fails if it has another format.
    fn check_marker(&self) -> Result<bool> {
        match self.store.read(MARKER)? {
            None => Ok(false),
            Some(bytes) if bytes == FORMAT.as_bytes() => Ok(true),
            Some(bytes) => Err(Error::refused(
                &self.store.root,
                format!(
                    "the format in {MARKER} is `{}`, and this program reads `{}`. Export the models with the program that wrote \
                 them, and import them into a new registry",
                    String::from_utf8_lossy(&bytes[..bytes.len().min(100)]).trim_end().escape_debug(),
                    FORMAT.trim_end()
                ),
            )),
        }
    }

    /// Returns the names of all models.
    pub(crate) fn names(&self) -> Result<Vec<ModelName>> {
        let folders = self.store.list(MODELS)?.checked()?.folders;
        Ok(folders.iter().filter_map(|folder| file_name(folder).parse().ok()).collect())
    }

    /// Returns the version numbers of `name` in ascending order. They are empty if there is no such model.
    pub(crate) fn versions(&self, name: &ModelName) -> Result<Vec<u64>> {
        self.store.numbers(&versions_key(name))
    }

    /// Returns the version numbers of `name`, of which there must be some.
    pub(crate) fn existing_versions(&self, name: &ModelName) -> Result<Vec<u64>> {
        let versions = self.versions(name)?;
        if !versions.is_empty() {
            return Ok(versions);
        }
        let (root, known) = (&self.store.root, listed(self.names()?.iter()));
        Err(Error::NotFound(format!("there is no model `{name}` in the registry `{root}`; it has: {known}")))
    }

    /// Loads version `number` of `name`, without its events. Fails with [`Error::Damaged`] if its manifest is not the one that
    /// was published.
    pub(crate) fn load(&self, name: &ModelName, number: u64) -> Result<ModelVersion> {
        let (model, key) = (format!("{name}@{number}"), pointer_key(&versions_key(name), number));
        let (bytes, digest) = self.store.follow(&model, &key)?;
        let malformed = |reason| Error::from(Fault::Malformed { reason }.of(&model, &blob_key(digest)));
        let manifest = Manifest::parse(&bytes).map_err(malformed)?;
        if manifest.name() != name.as_str() {
            let reason = format!("it names a version of `{}`", manifest.name());
            return Err(Fault::Malformed { reason }.of(&model, &key).into());
        }
        Ok(ModelVersion::new(name, number, digest, manifest))
    }
}

/// Lists names for a message.
pub(crate) fn listed(names: impl Iterator<Item = impl ToString>) -> String {
    let names: Vec<_> = names.map(|name| name.to_string()).collect();
    if names.is_empty() { "none".to_owned() } else { names.join(", ") }
}

/// Attributes a fault to a blob of `model`.
pub(crate) fn blob_problem(model: &str, blob: &Descriptor, fault: Fault) -> Problem {
    Problem { file: blob.path().map(str::to_owned), ..fault.of(model, &blob_key(blob.digest)) }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fixture::Place;

    #[test]
    fn opens_registries_only() {
        let place = Place::local();
        let (root, location) = (place.path("registry"), place.location());
        assert!(matches!(Registry::open(&location), Err(Error::NoRegistry { .. })));
        Registry::init(&location).unwrap();
        Registry::init(&location).unwrap();
        assert!(Registry::open(&location).unwrap().list().unwrap().is_empty());

        for other in [r#"{"format":"flowservo-registry","version":1}"#, "{}", "", "\u{1b}[2J"] {
            fs::write(root.join(MARKER), other).unwrap();
            let refusal = Registry::open(&location).unwrap_err().to_string();
            assert!(refusal.contains("Export the models") && !refusal.contains('\u{1b}'), "{refusal}");
            assert!(refusal.contains(r#"this program reads `{"format":"flowservo-registry","version":2}`"#));
            assert!(Registry::init(&location).is_err());
        }

        let occupied = place.checkpoint("runs", b"w");
        let refusal = Registry::init(&occupied.as_path().into()).unwrap_err().to_string();
        assert!(refusal.contains("empty or new folder"), "{refusal}");
        assert!(!occupied.join(MARKER).exists());
    }
}
