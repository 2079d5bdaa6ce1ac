//! Delivering a version to a new folder: complete and verified, or not at all.

use std::fs::{self, File};
use std::io::Write;
use std::path::Path;

use bytes::Bytes;

use crate::error::{Error, Result};
use crate::model::{Descriptor, ModelRef, ModelVersion, checkpoint};
use crate::outcome::Outcome;
use crate::problem::Fault;
use crate::registry::{Registry, blob_problem};
use crate::signature::PublicKey;
use crate::store::blob_key;
use crate::store::staged::Staged;

/// Writes the content of a new folder.
type Fill<'a> = &'a dyn Fn(&Path) -> Result<()>;

impl Registry {
    /// Writes the files of the version that `reference` names into the new folder `destination`, whose parents are created.
    ///
    /// The folder appears when all its files are verified. An existing folder is accepted if it holds exactly the same files.
    pub fn pull(&self, reference: &ModelRef, destination: &Path) -> Result<Outcome<ModelVersion>> {
        self.deliver(self.show(reference)?, destination)
    }

    /// Like [`pull`](Self::pull), but writes nothing unless a signature that is attached to the version verifies with `key`.
    pub fn pull_signed(
        &self,
        reference: &ModelRef,
        destination: &Path,
        key: &PublicKey,
    ) -> Result<Outcome<ModelVersion>> {
        let version = self.show(reference)?;
        self.signature_by(&version, key)?;
        self.deliver(version, destination)
    }

    fn deliver(&self, version: ModelVersion, destination: &Path) -> Result<Outcome<ModelVersion>> {
        let is_new = create_folder(destination, &version, &|folder| {
            version.manifest.layers.iter().try_for_each(|layer| {
                self.write_blob(&version, layer, &folder.join(layer.path().unwrap_or_default()))
            })
        })?;
        if is_new {
            return Ok(Outcome::New(version));
        }
        let reason = match holds(destination, &version) {
            Ok(true) => return Ok(Outcome::AlreadyThere(version)),
            Ok(false) => "exists and holds something else".to_owned(),
            Err(error) => format!("exists and holds something else ({error})"),
        };
        Err(refuse(destination, &version, &reason))
    }

    /// Writes one blob of `version` to the new file `path` and verifies it.
    pub(crate) fn write_blob(&self, version: &ModelVersion, blob: &Descriptor, path: &Path) -> Result<()> {
        let mut file = create_new(path)?;
        let mut write = |piece: Bytes| file.write_all(&piece).map_err(Error::io("write", path));
        let found = self.store.fetch(&blob_key(blob.digest), &mut write)?;
        if let Some(fault) = Fault::of_blob(blob.content(), found) {
            return Err(blob_problem(&version.to_string(), blob, fault).into());
        }
        // On disk before the folder is renamed: a power failure must not leave a complete folder with empty files.
        file.sync_all().map_err(Error::io("write", path))
    }
}

/// Returns whether `path` exists. A broken symbolic link counts as existing.
fn exists(path: &Path) -> bool {
    fs::symlink_metadata(path).is_ok()
}

fn refuse(destination: &Path, version: &ModelVersion, reason: &str) -> Error {
    Error::refused(
        &destination.display(),
        format!("{reason}; {version} was not written. Choose a new folder"),
    )
}

/// Creates a new file, and the folders above it.
fn create_new(path: &Path) -> Result<File> {
    let folder = path.parent().unwrap_or(Path::new(""));
    fs::create_dir_all(folder).map_err(Error::io("create the folder", folder))?;
    File::create_new(path).map_err(Error::io("write", path))
}

/// Writes a small new file.
pub(crate) fn write_new(path: &Path, content: &[u8]) -> Result<()> {
    let mut file = create_new(path)?;
    file.write_all(content).and_then(|()| file.sync_all()).map_err(Error::io("write", path))
}

/// Returns whether `folder` holds exactly the files of `version`. Contents are read only if all names match.
fn holds(folder: &Path, version: &ModelVersion) -> Result<bool> {
    if !folder.is_dir() {
        return Ok(false);
    }
    let (store, paths) = checkpoint::open(folder, &[])?;
    let expected = version.manifest.files();
    if !paths.iter().eq(expected.keys()) {
        return Ok(false);
    }
    for (path, digest) in expected {
        if store.inspect(&path)?.is_none_or(|found| found.digest != digest) {
            return Ok(false);
        }
    }
    Ok(true)
}

/// Creates the folder `destination`, which must be free, with what `fill` writes of `version`.
pub(crate) fn export(version: &ModelVersion, destination: &Path, fill: Fill) -> Result<()> {
    let is_new = create_folder(destination, version, fill)?;
    if is_new { Ok(()) } else { Err(refuse(destination, version, "exists")) }
}

/// Creates the folder `destination` with what `fill` writes of `version`: complete, or not at all. Returns false if there is
/// something at `destination`.
fn create_folder(destination: &Path, version: &ModelVersion, fill: Fill) -> Result<bool> {
    if exists(destination) {
        return Ok(false);
    }
    let Some(name) = destination.file_name() else {
        return Err(refuse(destination, version, "is not the name of a new folder"));
    };
    let parent = destination.parent().unwrap_or(Path::new(""));
    fs::create_dir_all(parent).map_err(Error::io("create the folder", parent))?;
    let hidden = |number| parent.join(format!(".{}.{number}.tmp", name.display()));
    let (staged, ()) = Staged::create(hidden, |path| fs::create_dir(path))?;
    fill(&staged.path)?;
    match staged.rename(destination) {
        // Another process was faster.
        Err(_) if exists(destination) => Ok(false),
        renamed => renamed.map(|()| true),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fixture::{Place, bytes, flip};
    use crate::store::blob_key;

    #[test]
    fn delivers_what_was_published() {
        for place in Place::all() {
            let registry = place.registry();
            let weights = bytes(100_000);
            let version = place.publish(&registry, "approach", &weights);
            place.publish(&registry, "approach", b"newer");
            let reference = "approach@1".parse().unwrap();
            let destination = place.path("new/folder/pulled");
            assert_eq!(registry.pull(&reference, &destination).unwrap(), Outcome::New(version.clone()));
            assert!(fs::read(destination.join("weights.bin")).unwrap() == weights);
            assert_eq!(fs::read(destination.join("config.toml")).unwrap(), b"width = 0.25\n");
            assert_eq!(fs::read(destination.join("state/step.json")).unwrap(), b"7");
            assert_eq!(registry.pull(&reference, &destination).unwrap(), Outcome::AlreadyThere(version));
            let beside = fs::read_dir(place.path("new/folder")).unwrap().count();
            assert_eq!(beside, 1, "the staged folder is gone");
        }
    }

    #[test]
    fn refuses_a_destination_with_other_content() {
        let place = Place::local();
        let registry = place.registry();
        place.publish(&registry, "approach", b"weights");
        let reference = "approach".parse().unwrap();
        let spoils: [fn(&Path); 4] = [
            |root| fs::write(root.join("config.toml"), "width = 0.50\n").unwrap(),
            |root| fs::write(root.join("notes.md"), "mine").unwrap(),
            |root| fs::remove_file(root.join("config.toml")).unwrap(),
            |root| fs::create_dir(root.join("empty")).unwrap(),
        ];
        for (index, spoil) in spoils.iter().enumerate() {
            let destination = place.checkpoint(&format!("pulled{index}"), b"weights");
            assert!(matches!(registry.pull(&reference, &destination), Ok(Outcome::AlreadyThere(_))));
            spoil(&destination);
            let message = registry.pull(&reference, &destination).unwrap_err().to_string();
            assert!(
                message.contains("approach@1 was not written") && message.contains("pulled"),
                "{message}"
            );
        }
        let file = place.path("pulled0/notes.md");
        fs::write(&file, "mine").unwrap();
        assert!(matches!(registry.pull(&reference, &file), Err(Error::Refused { .. })));
        assert_eq!(fs::read(&file).unwrap(), b"mine");
    }

    #[cfg(unix)]
    #[test]
    fn links_at_the_destination_are_neither_followed_nor_accepted() {
        use std::os::unix::fs::symlink;

        let place = Place::local();
        let registry = place.registry();
        place.publish(&registry, "approach", b"weights");
        let reference = "approach".parse().unwrap();
        let (nowhere, link) = (place.path("nowhere"), place.path("link"));
        symlink(&nowhere, &link).unwrap();
        let refusal = registry.pull(&reference, &link).unwrap_err().to_string();
        assert!(refusal.contains("link: exists and holds something else"), "{refusal}");
        assert!(!nowhere.exists());

        // The right content, but by a link.
        let (pulled, elsewhere) = (place.path("pulled"), place.path("elsewhere"));
        registry.pull(&reference, &pulled).unwrap();
        fs::rename(pulled.join("weights.bin"), &elsewhere).unwrap();
        symlink(&elsewhere, pulled.join("weights.bin")).unwrap();
        let refusal = registry.pull(&reference, &pulled).unwrap_err().to_string();
        assert!(refusal.contains("weights.bin") && refusal.contains("no links"), "{refusal}");
    }

    #[test]
    fn damage_is_never_delivered() {
        let place = Place::local();
        let registry = place.registry();
        let version = place.publish(&registry, "approach", b"weights");
        let blob = blob_key(version.manifest.layers[2].digest);
        flip(&place.path("registry"), &blob);
        let message =
            registry.pull(&"approach".parse().unwrap(), &place.path("pulled")).unwrap_err().to_string();
        assert!(message.contains("approach@1: weights.bin") && message.contains(&blob), "{message}");
        let left: Vec<_> =
            fs::read_dir(place.path("")).unwrap().map(|entry| entry.unwrap().file_name()).collect();
        assert!(!left.iter().any(|name| name.to_string_lossy().contains("pulled")), "{left:?}");
    }
}
