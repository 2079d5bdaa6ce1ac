//! Delivering a version: into a new folder, whole and verified, or not at all.

use std::collections::BTreeMap;
use std::ffi::OsString;
use std::fs::{self, File};
use std::io::{ErrorKind, Write};
use std::path::{Path, PathBuf};

use serde::Serialize;

use crate::checkpoint;
use crate::error::{Error, Result};
use crate::manifest::Descriptor;
use crate::problem::{Fault, Problem};
use crate::reference::ModelRef;
use crate::registry::{ModelVersion, Registry};
use crate::signature::PublicKey;
use crate::store::blob_key;

/// What pulling did.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[serde(tag = "pulled", content = "version", rename_all = "snake_case")]
pub enum Pulled {
    /// The version was written.
    New(ModelVersion),
    /// The destination held exactly this version before: nothing was written.
    AlreadyThere(ModelVersion),
}

impl Pulled {
    /// The version that the destination holds now.
    pub fn version(&self) -> &ModelVersion {
        match self {
            Self::New(version) | Self::AlreadyThere(version) => version,
        }
    }
}

impl Registry {
    /// Writes the files of the version that `reference` names into the new folder `destination`, whose parents are created.
    ///
    /// The folder appears when all its files are verified. A folder that is there is accepted if it holds exactly the same
    /// files.
    pub fn pull(&self, reference: &ModelRef, destination: &Path) -> Result<Pulled> {
        self.deliver_version(self.show(reference)?, destination)
    }

    /// As [`pull`](Self::pull), but nothing is written unless the owner of `key` signed the version, by a signature that is
    /// attached to it.
    pub fn pull_signed(&self, reference: &ModelRef, destination: &Path, key: &PublicKey) -> Result<Pulled> {
        let version = self.show(reference)?;
        self.signature_by(&version, key)?;
        self.deliver_version(version, destination)
    }

    fn deliver_version(&self, version: ModelVersion, destination: &Path) -> Result<Pulled> {
        if fs::symlink_metadata(destination).is_ok() {
            return accept(version, destination);
        }
        let staged = Staged::beside(destination, &version)?;
        for layer in &version.manifest.layers {
            self.deliver(&version, layer, &staged.folder)?;
        }
        match staged.rename(destination) {
            Ok(()) => Ok(Pulled::New(version)),
            // Another process was faster.
            Err(_) if fs::symlink_metadata(destination).is_ok() => accept(version, destination),
            Err(error) => Err(error),
        }
    }

    /// Writes one file of `version` below `root` and verifies it.
    fn deliver(&self, version: &ModelVersion, layer: &Descriptor, root: &Path) -> Result<()> {
        self.write_blob(version, layer, &root.join(layer.path().unwrap_or_default()))
    }

    /// Writes one blob of `version` to the new file `path` and verifies it.
    pub(crate) fn write_blob(&self, version: &ModelVersion, layer: &Descriptor, path: &Path) -> Result<()> {
        let mut file = create_new(path)?;
        let found = self
            .store
            .read_blob(layer.digest, &mut |piece| file.write_all(piece).map_err(Error::io("write", path)))?;
        if let Some(fault) = Fault::of_blob(layer.content(), found) {
            let (model, file) = (Some(version.to_string()), layer.path().map(str::to_owned));
            return Err(Problem { model, file, object: blob_key(layer.digest), fault }.into());
        }
        // On disk before the folder gets its name: a power cut must not leave a named folder with empty files.
        file.sync_all().map_err(Error::io("write", path))
    }
}

/// A new file, with the folders above it.
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

/// Accepts an existing destination if it holds exactly the files of `version`.
fn accept(version: ModelVersion, destination: &Path) -> Result<Pulled> {
    let reason = match holds(destination, &version.manifest.layers) {
        Ok(true) => return Ok(Pulled::AlreadyThere(version)),
        Ok(false) => "exists and holds something else".to_owned(),
        Err(Error::Checkpoint { path, reason }) => {
            format!("exists and holds something else ({}: {reason})", path.display())
        }
        Err(error) => return Err(error),
    };
    Err(Error::Destination { path: destination.to_owned(), model: version.to_string(), reason })
}

/// Whether `folder` holds exactly these files. Contents are read only if all names are right.
fn holds(folder: &Path, layers: &[Descriptor]) -> Result<bool> {
    if !folder.is_dir() {
        return Ok(false);
    }
    let files = checkpoint::list(folder)?;
    let expected: BTreeMap<_, _> = layers.iter().map(|layer| (layer.path(), layer.content())).collect();
    if !files.iter().map(|(path, _)| Some(path.as_str())).eq(expected.keys().copied()) {
        return Ok(false);
    }
    for ((_, source), content) in files.iter().zip(expected.values()) {
        if checkpoint::fingerprint(source)? != *content {
            return Ok(false);
        }
    }
    Ok(true)
}

/// A folder beside the destination, removed when dropped, unless it was renamed.
pub(crate) struct Staged {
    pub(crate) folder: PathBuf,
    /// Its former name may be another process's by now.
    renamed: bool,
}

impl Staged {
    /// A new folder for what will lie at `destination`.
    pub(crate) fn beside(destination: &Path, version: &ModelVersion) -> Result<Self> {
        let Some(name) = destination.file_name() else {
            let (path, model) = (destination.to_owned(), version.to_string());
            return Err(Error::Destination { path, model, reason: "is not the name of a new folder".into() });
        };
        let parent = destination.parent().unwrap_or(Path::new(""));
        fs::create_dir_all(parent).map_err(Error::io("create the folder", parent))?;
        let mut number = 0_u64;
        loop {
            let mut hidden = OsString::from(".");
            hidden.push(name);
            hidden.push(format!(".{number}.tmp"));
            let folder = parent.join(hidden);
            match fs::create_dir(&folder) {
                Ok(()) => return Ok(Self { folder, renamed: false }),
                Err(error) if error.kind() == ErrorKind::AlreadyExists => number += 1,
                Err(error) => return Err(Error::io("create the folder", &folder)(error)),
            }
        }
    }

    /// Gives the folder its name.
    fn rename(mut self, destination: &Path) -> Result<()> {
        fs::rename(&self.folder, destination).map_err(Error::io("write", destination))?;
        self.renamed = true;
        Ok(())
    }

    /// Gives the folder its name, which must be free.
    pub(crate) fn finish(self, destination: &Path, version: &ModelVersion) -> Result<()> {
        if fs::symlink_metadata(destination).is_ok() {
            let (path, model) = (destination.to_owned(), version.to_string());
            return Err(Error::Destination { path, model, reason: "exists".into() });
        }
        self.rename(destination)
    }
}

impl Drop for Staged {
    fn drop(&mut self) {
        if !self.renamed {
            // What cannot be removed is hidden and named `.tmp`; there is nobody left to tell.
            let _ = fs::remove_dir_all(&self.folder);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fixture::{Place, bytes, flip};

    #[test]
    fn delivers_what_was_published() {
        for place in Place::all() {
            let registry = place.registry();
            let weights = bytes(100_000);
            let version = place.publish(&registry, "approach", &weights);
            place.publish(&registry, "approach", b"newer");
            let reference = "approach@1".parse().unwrap();
            let destination = place.path("new/folder/pulled");
            assert_eq!(registry.pull(&reference, &destination).unwrap(), Pulled::New(version.clone()));
            assert!(fs::read(destination.join("weights.bin")).unwrap() == weights);
            assert_eq!(fs::read(destination.join("config.toml")).unwrap(), b"width = 0.25\n");
            assert_eq!(fs::read(destination.join("state/step.json")).unwrap(), b"7");
            assert_eq!(registry.pull(&reference, &destination).unwrap(), Pulled::AlreadyThere(version));
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
            assert!(matches!(registry.pull(&reference, &destination), Ok(Pulled::AlreadyThere(_))));
            spoil(&destination);
            let message = registry.pull(&reference, &destination).unwrap_err().to_string();
            assert!(
                message.contains("approach@1 was not written") && message.contains("pulled"),
                "{message}"
            );
        }
        let file = place.path("pulled0/notes.md");
        fs::write(&file, "mine").unwrap();
        assert!(matches!(registry.pull(&reference, &file), Err(Error::Destination { .. })));
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
