//! Hardening of a registry in a folder: it consists of regular files and folders only.
//!
//! A symbolic link would lead readers and writers out of the registry, and reading a named pipe would block forever. The object
//! store follows links, so every key is checked before it is used, part by part. Only the root may be a link, at its owner's
//! discretion.
//!
//! A file can be replaced between the check and its use. Whoever can do that can also write the registry's files, and what is
//! read is verified by its digest. The check is about what the folder contains, not about a race.

use std::fs::{self, FileType};
use std::io::ErrorKind;
use std::path::Path;

use super::{Listing, Object};
use crate::error::{Error, Result};
use crate::problem::{Fault, Problem};

/// Returns the problem with the object or folder `key`, if files of this type are not allowed.
fn problem(key: &str, kind: FileType) -> Option<Problem> {
    (!kind.is_file() && !kind.is_dir()).then(|| Fault::Irregular.of("", key))
}

/// Refuses a key below `root` that leads to or through a symbolic link or a special file.
pub(super) fn check(root: &Path, key: &str) -> Result<()> {
    let ends = key.match_indices('/').map(|(end, _)| end).chain([key.len()]);
    for part in ends.map(|end| &key[..end]).filter(|part| !part.is_empty()) {
        // A missing file is for the store to report.
        let Ok(metadata) = fs::symlink_metadata(root.join(part)) else { return Ok(()) };
        if let Some(problem) = problem(part, metadata.file_type()) {
            return Err(problem.into());
        }
    }
    Ok(())
}

/// Lists the folder `key` of `root`, sorted by key. Links are reported, not followed.
pub(super) fn list(root: &Path, key: &str) -> Result<Listing> {
    let mut listing = Listing::default();
    let folder = root.join(key);
    let entries = match fs::read_dir(&folder) {
        Err(error) if error.kind() == ErrorKind::NotFound => return Ok(listing),
        entries => entries.map_err(Error::io("read the folder", &folder))?,
    };
    for entry in entries {
        let entry = entry.map_err(Error::io("read the folder", &folder))?;
        let metadata = match entry.metadata() {
            // A half-written file was renamed in the meantime.
            Err(error) if error.kind() == ErrorKind::NotFound => continue,
            metadata => metadata.map_err(Error::io("read", &entry.path()))?,
        };
        let name = entry.file_name().to_string_lossy().into_owned();
        let key = if key.is_empty() { name } else { format!("{key}/{name}") };
        if let Some(problem) = problem(&key, metadata.file_type()) {
            listing.problems.push(problem);
        } else if metadata.is_dir() {
            listing.folders.push(key);
        } else {
            let modified = metadata.modified().map_err(Error::io("read", &entry.path()))?;
            listing.objects.push(Object { key, size: metadata.len(), modified });
        }
    }
    listing.folders.sort();
    listing.objects.sort_by(|a, b| a.key.cmp(&b.key));
    listing.problems.sort_by(|a, b| a.object.cmp(&b.object));
    Ok(listing)
}

/// Returns whether a local store is writing this file: `NAME#7` becomes `NAME` when it is complete.
pub(crate) fn is_staged(name: &str) -> bool {
    name.rsplit_once('#').is_some_and(|(_, number)| is_numeral(number))
}

/// Returns whether `text` consists of digits.
pub(super) fn is_numeral(text: &str) -> bool {
    !text.is_empty() && text.bytes().all(|c| c.is_ascii_digit())
}

#[cfg(unix)]
#[cfg(test)]
mod tests {
    use std::os::unix::fs::symlink;
    use std::process::Command;
    use std::time::{Duration, SystemTime};

    use super::*;
    use crate::events::alias::Precondition;
    use crate::fixture::version_key;
    use crate::fixture::{Place, model};
    use crate::model::ModelVersion;
    use crate::model::Note;
    use crate::model::Provenance;
    use crate::registry::Registry;
    use crate::store::blob_key;
    use crate::store::location::Location;

    /// Creates a registry with an alias, a yanked version and a blob that nothing names. Returns its first version.
    fn published(place: &Place) -> (Registry, ModelVersion) {
        let (registry, none) = (place.registry(), Note::default());
        let first = place.publish(&registry, "approach", b"one");
        let second = place.publish(&registry, "approach", b"two");
        registry.set_alias(&"champion".parse().unwrap(), &first, Precondition::Any, &none).unwrap();
        registry.yank(&second, &none).unwrap();
        registry.store.put_blob(b"orphan".to_vec()).unwrap();
        (registry, first)
    }

    /// Lists all files and folders below `root`, with the files' content.
    fn tree(root: &Path) -> Vec<(String, Option<Vec<u8>>)> {
        let mut found = Vec::new();
        let mut folders = vec![String::new()];
        while let Some(folder) = folders.pop() {
            for entry in fs::read_dir(root.join(&folder)).unwrap() {
                let name = entry.unwrap().file_name().into_string().unwrap();
                let key = if folder.is_empty() { name } else { format!("{folder}/{name}") };
                let content = fs::read(root.join(&key)).ok();
                if content.is_none() {
                    folders.push(key.clone());
                }
                found.push((key, content));
            }
        }
        found.sort();
        found
    }

    /// Writes what [`tree`] returned.
    fn plant(root: &Path, tree: &[(String, Option<Vec<u8>>)]) {
        fs::create_dir(root).unwrap();
        for (key, content) in tree {
            match content {
                Some(content) => fs::write(root.join(key), content).unwrap(),
                None => fs::create_dir(root.join(key)).unwrap(),
            }
        }
    }

    /// Runs every operation on a registry and returns the errors.
    fn use_all(registry: &Registry, place: &Place) -> Vec<String> {
        let none = Note::default();
        let alias = "champion".parse().unwrap();
        let show = |reference: &str| registry.show(&reference.parse().unwrap());
        let later = SystemTime::UNIX_EPOCH + Duration::from_hours(24 * 365 * 1000);
        let garbage = || registry.garbage(later, Duration::ZERO);
        let third = place.checkpoint("third", b"three");
        let done = [
            registry.list().map(drop),
            show("approach").map(drop),
            show("approach:champion").map(drop),
            registry.publish(&model("approach"), &third, Provenance::default()).map(drop),
            show("approach@1")
                .and_then(|version| registry.set_alias(&alias, &version, Precondition::Any, &none))
                .map(drop),
            show("approach@2").and_then(|version| registry.unyank(&version, &none)).map(drop),
            garbage().and_then(|found| registry.delete_garbage(found, later, Duration::ZERO)).map(drop),
        ];
        done.into_iter().filter_map(Result::err).map(|error| error.to_string()).collect()
    }

    /// Each file and folder in turn is moved away and replaced by a link: following it would go unnoticed.
    #[test]
    fn no_link_is_followed() {
        let original = Place::local();
        let (_, first) = published(&original);
        let content = tree(&original.path("registry"));
        for key in content.iter().map(|(key, _)| key) {
            let place = Place::local();
            plant(&place.path("registry"), &content);
            let registry = Registry::open(&place.location()).unwrap();
            let (link, outside) = (place.path("registry").join(key), place.path("outside"));
            fs::create_dir(&outside).unwrap();
            fs::rename(&link, outside.join("target")).unwrap();
            symlink(outside.join("target"), &link).unwrap();
            let before = tree(&outside);
            let message = format!("{key} is a symbolic link");
            if key == "registry.json" {
                let refusal = Registry::open(&place.location()).unwrap_err().to_string();
                assert!(refusal.starts_with(&message), "{refusal}");
                assert!(Registry::init(&place.location()).is_err());
            }
            let problems = registry.verify(None).unwrap().problems;
            assert!(
                problems.iter().any(|problem| problem.object == *key && problem.fault == Fault::Irregular),
                "{key}: {problems:?}"
            );

            let mut needed = vec![version_key(1), blob_key(first.digest)];
            needed.extend(first.manifest.layers.iter().map(|layer| blob_key(layer.digest)));
            let is_needed =
                needed.iter().any(|object| object == key || object.starts_with(&format!("{key}/")));
            match registry.pull(&"approach@1".parse().unwrap(), &place.path("pulled")) {
                Ok(pulled) => assert!(!is_needed && *pulled.value() == first, "{key}"),
                Err(error) => {
                    assert!(error.to_string().starts_with(&message), "{error}");
                    assert!(!place.path("pulled").exists());
                }
            }
            for refusal in use_all(&registry, &place) {
                assert!(refusal.starts_with(&message), "{key}: {refusal}");
            }
            assert_eq!(tree(&outside), before, "{key}");
            assert!(fs::symlink_metadata(&link).unwrap().is_symlink());
        }
    }

    /// Links to nowhere and to other folders, and pipes, on which a reader would block.
    #[test]
    fn links_and_special_files_are_found() {
        let place = Place::local();
        let (registry, first) = published(&place);
        let root = place.path("registry");
        let pipe =
            |key: &str| assert!(Command::new("mkfifo").arg(root.join(key)).status().unwrap().success());
        symlink("nowhere", root.join("models/approach/versions/000003")).unwrap();
        symlink("..", root.join("models/approach/loop")).unwrap();
        symlink("/etc", root.join("notes")).unwrap();
        let weights = blob_key(first.manifest.layers[2].digest);
        fs::remove_file(root.join(&weights)).unwrap();
        pipe(&weights);
        pipe("models/approach/events/pipe");
        let verified = registry.verify(None).unwrap();
        let found: Vec<_> =
            verified.problems.iter().map(|problem| (problem.object.as_str(), &problem.fault)).collect();
        for key in ["models/approach/versions/000003", "models/approach/loop", "notes"] {
            assert!(found.contains(&(key, &Fault::Irregular)), "{found:?}");
        }
        for key in [&weights, "models/approach/events/pipe"] {
            assert!(found.contains(&(key, &Fault::Irregular)), "{found:?}");
        }
        assert_eq!(verified.versions, 2, "the others are verified nevertheless");
        let refusal =
            registry.pull(&"approach@1".parse().unwrap(), &place.path("pulled")).unwrap_err().to_string();
        assert!(refusal.starts_with("models/approach/versions/000003 is a symbolic link"), "{refusal}");
        fs::remove_file(root.join("models/approach/versions/000003")).unwrap();
        let refusal =
            registry.pull(&"approach@1".parse().unwrap(), &place.path("pulled")).unwrap_err().to_string();
        assert!(refusal.contains("special file"), "{refusal}");
        assert!(!place.path("pulled").exists());
    }

    /// The root is the owner's choice. A blob with a second hard link is replaced, not written through.
    #[test]
    fn the_root_may_be_a_link_and_files_may_have_two_names() {
        let place = Place::local();
        let (registry, first) = published(&place);
        symlink(place.path("registry"), place.path("linked")).unwrap();
        let linked = Registry::open(&Location::from(place.path("linked").as_path())).unwrap();
        assert_eq!(linked.verify(None).unwrap(), registry.verify(None).unwrap());
        linked.pull(&"approach@1".parse().unwrap(), &place.path("pulled")).unwrap();

        let (blob, other) =
            (place.path("registry").join(blob_key(first.manifest.layers[2].digest)), place.path("other"));
        fs::write(&other, "eno").unwrap();
        fs::remove_file(&blob).unwrap();
        fs::hard_link(&other, &blob).unwrap();
        assert_eq!(linked.verify(None).unwrap().problems.len(), 1);
        let again = place.checkpoint("again", b"one");
        linked.publish(&model("approach"), &again, Provenance::default()).unwrap();
        assert_eq!(linked.verify(None).unwrap().problems, []);
        assert_eq!(fs::read(&other).unwrap(), b"eno");
    }
}
