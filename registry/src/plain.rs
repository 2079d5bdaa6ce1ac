//! What a registry in a folder is made of: plain files and folders.
//!
//! A symbolic link would lead readers and writers to places that are no part of the registry, and who reads a named pipe waits
//! for ever. The store beneath follows links, so every key is looked at before it is used, part by part. Only the root may be
//! a link: that is its owner's choice.
//!
//! What is looked at may be replaced before it is used. Whoever can do that can write the registry's files as well, and what is
//! read is proven by its digest: this is about what lies there, not about a race.

use std::fs::{self, FileType};
use std::io::ErrorKind;
use std::path::Path;

use crate::error::{Error, Result};
use crate::problem::{Fault, Problem};
use crate::store::Listing;

/// What is wrong with the object or folder `key` if it is of this kind.
fn problem(key: &str, kind: FileType) -> Option<Problem> {
    let fault = if kind.is_symlink() {
        Fault::Link
    } else if kind.is_file() || kind.is_dir() {
        return None;
    } else {
        Fault::Special
    };
    Some(Problem { model: None, file: None, object: key.to_owned(), fault })
}

/// Refuses a key below `root` that leads to a link or a special file, or through one.
pub(crate) fn check(root: &Path, key: &str) -> Result<()> {
    let ends = key.match_indices('/').map(|(end, _)| end).chain([key.len()]);
    for part in ends.map(|end| &key[..end]).filter(|part| !part.is_empty()) {
        // Where nothing is to be seen, the store says what that means.
        let Ok(metadata) = fs::symlink_metadata(root.join(part)) else { return Ok(()) };
        if let Some(problem) = problem(part, metadata.file_type()) {
            return Err(problem.into());
        }
    }
    Ok(())
}

/// What lies directly in the folder `key` of `root`, and the links and special files in it, none of which is followed. Files that
/// are being written are not shown.
pub(crate) fn list(root: &Path, key: &str) -> Result<(Listing, Vec<Problem>)> {
    let (mut listing, mut problems) = (Listing::default(), Vec::new());
    let folder = root.join(key);
    let entries = match fs::read_dir(&folder) {
        Ok(entries) => entries,
        Err(error) if error.kind() == ErrorKind::NotFound => return Ok((listing, problems)),
        Err(error) => return Err(Error::io("read the folder", &folder)(error)),
    };
    for entry in entries {
        let entry = entry.map_err(Error::io("read the folder", &folder))?;
        let kind = match entry.file_type() {
            Ok(kind) => kind,
            // A file that was being written has got its name meanwhile.
            Err(error) if error.kind() == ErrorKind::NotFound => continue,
            Err(error) => return Err(Error::io("read", &entry.path())(error)),
        };
        let name = entry.file_name().to_string_lossy().into_owned();
        if let Some(problem) = problem(&join(key, &name), kind) {
            problems.push(problem);
        } else if kind.is_dir() {
            listing.folders.push(name);
        } else if !is_staged(&name) {
            listing.objects.push(name);
        }
    }
    listing.folders.sort();
    listing.objects.sort();
    problems.sort_by(|a, b| a.object.cmp(&b.object));
    Ok((listing, problems))
}

/// The links and special files at any depth below the folder `key` of `root`.
pub(crate) fn find(root: &Path, key: &str) -> Result<Vec<Problem>> {
    let mut found = Vec::new();
    let mut folders = vec![key.to_owned()];
    while let Some(key) = folders.pop() {
        let (listing, problems) = list(root, &key)?;
        folders.extend(listing.folders.iter().rev().map(|folder| join(&key, folder)));
        found.extend(problems);
    }
    Ok(found)
}

fn join(key: &str, name: &str) -> String {
    if key.is_empty() { name.to_owned() } else { format!("{key}/{name}") }
}

/// Whether `name` is that of a file which a local store was writing: `NAME#7`, renamed to `NAME` when it is whole.
pub(crate) fn is_staged(name: &str) -> bool {
    let number = name.rsplit_once('#').map(|(_, number)| number);
    number.is_some_and(|number| !number.is_empty() && number.bytes().all(|c| c.is_ascii_digit()))
}

#[cfg(test)]
#[cfg(unix)]
mod tests {
    use std::os::unix::fs::symlink;
    use std::process::Command;
    use std::time::{Duration, SystemTime};

    use super::*;
    use crate::digest::Digest;
    use crate::fixture::{Place, model};
    use crate::log::{Expect, Remark};
    use crate::manifest::Provenance;
    use crate::registry::{ModelVersion, Registry};
    use crate::store::{blob_key, version_key};

    /// A registry with an alias, a yanked version and a blob that nothing names; its first version.
    fn published(place: &Place) -> (Registry, ModelVersion) {
        let (registry, none) = (place.registry(), Remark::default());
        let first = place.publish(&registry, "approach", b"one");
        let second = place.publish(&registry, "approach", b"two");
        registry.set_alias(&"champion".parse().unwrap(), &first, Expect::Anything, &none).unwrap();
        registry.yank(&second, &none).unwrap();
        registry.store.put_blob(Digest::of(b"orphan"), b"orphan".to_vec()).unwrap();
        (registry, first)
    }

    /// Keys of all files and folders below `root`, and the files' content.
    fn tree(root: &Path) -> Vec<(String, Option<Vec<u8>>)> {
        let mut found = Vec::new();
        let mut folders = vec![String::new()];
        while let Some(folder) = folders.pop() {
            for entry in fs::read_dir(root.join(&folder)).unwrap() {
                let key = join(&folder, entry.unwrap().file_name().to_str().unwrap());
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

    /// Writes what [`tree`] found.
    fn plant(root: &Path, tree: &[(String, Option<Vec<u8>>)]) {
        fs::create_dir(root).unwrap();
        for (key, content) in tree {
            match content {
                Some(content) => fs::write(root.join(key), content).unwrap(),
                None => fs::create_dir(root.join(key)).unwrap(),
            }
        }
    }

    /// Does everything that is done to a registry, and gives the refusals.
    fn use_all(registry: &Registry, place: &Place) -> Vec<String> {
        let none = Remark::default();
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
                .and_then(|version| registry.set_alias(&alias, &version, Expect::Anything, &none))
                .map(drop),
            show("approach@2").and_then(|version| registry.unyank(&version, &none)).map(drop),
            garbage().and_then(|found| registry.delete_garbage(found, later, Duration::ZERO)).map(drop),
        ];
        done.into_iter().filter_map(Result::err).map(|error| error.to_string()).collect()
    }

    /// Each file and folder in turn is elsewhere, and a link in its place: who followed it would notice nothing.
    #[test]
    fn no_link_is_followed() {
        let original = Place::local();
        let (_, first) = published(&original);
        let content = tree(&original.path("registry"));
        for key in content.iter().map(|(key, _)| key) {
            let place = Place::local();
            plant(&place.path("registry"), &content);
            let registry = Registry::open(&place.path("registry")).unwrap();
            let (link, outside) = (place.path("registry").join(key), place.path("outside"));
            fs::create_dir(&outside).unwrap();
            fs::rename(&link, outside.join("target")).unwrap();
            symlink(outside.join("target"), &link).unwrap();
            let before = tree(&outside);
            let told = format!("{key} is a symbolic link");
            if key == "registry.json" {
                let refusal = Registry::open(&place.path("registry")).unwrap_err().to_string();
                assert!(refusal.starts_with(&told), "{refusal}");
                assert!(Registry::init(&place.path("registry")).is_err());
            }
            let problems = registry.verify(None).unwrap().problems;
            assert!(
                problems.iter().any(|problem| problem.object == *key && problem.fault == Fault::Link),
                "{key}: {problems:?}"
            );

            let mut needed = vec![version_key(&first.name, 1), blob_key(first.digest)];
            needed.extend(first.manifest.layers.iter().map(|layer| blob_key(layer.digest)));
            let is_needed =
                needed.iter().any(|object| object == key || object.starts_with(&format!("{key}/")));
            match registry.pull(&"approach@1".parse().unwrap(), &place.path("pulled")) {
                Ok(pulled) => assert!(!is_needed && *pulled.version() == first, "{key}"),
                Err(error) => {
                    assert!(error.to_string().starts_with(&told), "{error}");
                    assert!(!place.path("pulled").exists());
                }
            }
            for refusal in use_all(&registry, &place) {
                assert!(refusal.starts_with(&told), "{key}: {refusal}");
            }
            assert_eq!(tree(&outside), before, "{key}");
            assert!(fs::symlink_metadata(&link).unwrap().is_symlink());
        }
    }

    /// Links to nowhere, to a folder above and beside what belongs there, and pipes, on which a reader would wait.
    #[test]
    fn whatever_is_no_plain_file_is_found() {
        let place = Place::local();
        let (registry, first) = published(&place);
        let root = place.path("registry");
        let pipe =
            |key: &str| assert!(Command::new("mkfifo").arg(root.join(key)).status().unwrap().success());
        symlink("nowhere", root.join("models/approach/versions/000003.json")).unwrap();
        symlink("..", root.join("models/approach/loop")).unwrap();
        symlink("/etc", root.join("notes")).unwrap();
        let weights = blob_key(first.manifest.layers[2].digest);
        fs::remove_file(root.join(&weights)).unwrap();
        pipe(&weights);
        pipe("models/approach/aliases/pipe");
        let verified = registry.verify(None).unwrap();
        let found: Vec<_> =
            verified.problems.iter().map(|problem| (problem.object.as_str(), &problem.fault)).collect();
        for key in ["models/approach/versions/000003.json", "models/approach/loop", "notes"] {
            assert!(found.contains(&(key, &Fault::Link)), "{found:?}");
        }
        for key in [&weights, "models/approach/aliases/pipe"] {
            assert!(found.contains(&(key, &Fault::Special)), "{found:?}");
        }
        assert_eq!(verified.versions, 2, "the others are verified nevertheless");
        let refusal =
            registry.pull(&"approach@1".parse().unwrap(), &place.path("pulled")).unwrap_err().to_string();
        assert!(refusal.starts_with("models/approach/versions/000003.json is a symbolic link"), "{refusal}");
        fs::remove_file(root.join("models/approach/versions/000003.json")).unwrap();
        let refusal =
            registry.pull(&"approach@1".parse().unwrap(), &place.path("pulled")).unwrap_err().to_string();
        assert!(refusal.contains("is neither a file nor a folder: remove it"), "{refusal}");
        assert!(!place.path("pulled").exists());
    }

    /// Where a registry is, is its owner's choice. A blob that has a second name elsewhere is never written through.
    #[test]
    fn the_root_may_be_a_link_and_files_may_have_two_names() {
        let place = Place::local();
        let (registry, first) = published(&place);
        symlink(place.path("registry"), place.path("linked")).unwrap();
        let linked = Registry::open(&place.path("linked")).unwrap();
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
