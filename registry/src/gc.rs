//! Garbage: blobs that nothing names, half-written files and probes, left by what was interrupted, and how they are removed.
//!
//! A blob is garbage if no object below `models/` names its digest, and if the store last wrote it longer ago than a grace period.
//! The grace period covers publications under way: their blobs come first, and nothing names them until the manifest is there.
//! A publication that finds one of its blobs already stored, but named by nothing, writes it again, so that each blob it relies
//! on is either named or younger than the publication.
//!
//! Right before each deletion the objects below `models/` are listed again and the blob's age is looked at again. What remains are
//! the milliseconds between this last look and the deletion: a publication that writes again, in just this moment, the content of
//! a blob that lay there unused for the whole grace period, would lose it. `verify` finds such a loss, and publishing the same
//! checkpoint again mends it.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::Path;
use std::time::{Duration, SystemTime};

use serde::Serialize;

use crate::digest::Digest;
use crate::error::{Error, Result};
use crate::log::entry_number;
use crate::plain::is_staged;
use crate::probe::is_probe;
use crate::problem::{Fault, Problem};
use crate::registry::{Registry, version_number};
use crate::store::{BLOBS, MODELS, Object, Store, blob_key};

/// How old garbage has to be before it is removed, unless the user says otherwise: 14 days.
pub const GRACE: Duration = Duration::from_hours(14 * 24);

/// An object that nothing needs.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
#[non_exhaustive]
pub struct Garbage {
    /// Its key below the registry's root.
    pub key: String,
    /// Its bytes.
    pub size: u64,
    /// Seconds since it was written, by the store's clock.
    pub age_s: u64,
}

impl Registry {
    /// All that nothing needs and that was written longer than `grace` before `now`, sorted by key. Nothing is changed.
    ///
    /// Fails if a manifest or an entry is not as it was written: what it named can no longer be told from garbage.
    pub fn garbage(&self, now: SystemTime, grace: Duration) -> Result<Vec<Garbage>> {
        // Blobs before references: what is published in between is not among the blobs yet.
        let mut objects = self.store.walk(BLOBS)?;
        let mut references = References::of(&self.store)?;
        references.check(&self.store)?;
        objects.retain(|object| blob_digest(&object.key).is_some_and(|digest| !references.names(digest)));
        for key in self.store.list("")?.objects.iter().filter(|key| is_probe(key)) {
            objects.extend(self.store.object(key)?);
        }
        if let Some(folder) = self.store.folder() {
            for part in ["", BLOBS, MODELS] {
                staged(folder, part, &mut objects)?;
            }
        }
        let mut garbage: Vec<_> = objects.into_iter().filter_map(|object| old(object, now, grace)).collect();
        garbage.sort_by(|a, b| a.key.cmp(&b.key));
        Ok(garbage)
    }

    /// Deletes those of `garbage` that are still garbage, looking again right before each deletion, and returns them.
    ///
    /// If the store refuses one, the error tells, and those before it are gone.
    pub fn delete_garbage(
        &self,
        garbage: Vec<Garbage>,
        now: SystemTime,
        grace: Duration,
    ) -> Result<Vec<Garbage>> {
        let mut references = References::default();
        let mut deleted = Vec::new();
        for found in garbage {
            let is_deleted = if let Some(digest) = blob_digest(&found.key) {
                references.update(&self.store)?;
                references.check(&self.store)?;
                !references.names(digest) && self.delete_object(&found.key, now, grace)?
            } else if is_probe(&found.key) {
                self.delete_object(&found.key, now, grace)?
            } else {
                self.delete_staged(&found.key, now, grace)?
            };
            if is_deleted {
                deleted.push(found);
            }
        }
        Ok(deleted)
    }

    /// Deletes an object, if it is still old.
    fn delete_object(&self, key: &str, now: SystemTime, grace: Duration) -> Result<bool> {
        let object = self.store.object(key)?;
        let is_old = object.and_then(|object| old(object, now, grace)).is_some();
        if is_old {
            self.store.remove(key)?;
        }
        Ok(is_old)
    }

    /// Deletes a half-written file, if it is one and still old.
    fn delete_staged(&self, key: &str, now: SystemTime, grace: Duration) -> Result<bool> {
        let Some(path) = self.store.folder().map(|folder| folder.join(key)).filter(|_| is_staged(key)) else {
            return Ok(false);
        };
        self.store.check(key)?;
        let is_old = file(&path, key)?.and_then(|object| old(object, now, grace)).is_some();
        if is_old {
            fs::remove_file(&path).map_err(Error::io("delete", &path))?;
        }
        Ok(is_old)
    }
}

/// Every digest that is written anywhere below `models/`, in whatever kind of object.
#[derive(Debug, Default)]
pub(crate) struct References {
    /// The objects that were read, and the digest of each. They never change: none is read twice.
    read: BTreeMap<String, Digest>,
    /// Keys of those whose copies among the blobs were not looked for yet.
    unproven: Vec<String>,
    named: BTreeSet<Digest>,
}

impl References {
    /// What is named now.
    pub(crate) fn of(store: &Store) -> Result<Self> {
        let mut references = Self::default();
        references.update(store)?;
        Ok(references)
    }

    /// Reads the objects that have appeared.
    fn update(&mut self, store: &Store) -> Result<()> {
        for object in store.walk(MODELS)? {
            if self.read.contains_key(&object.key) {
                continue;
            }
            let Some(bytes) = store.read(&object.key)? else { continue };
            // The object's copy among the blobs is needed as well.
            let digest = Digest::of(&bytes);
            self.named.insert(digest);
            self.named.extend(digests(&bytes));
            if is_numbered(&object.key) {
                self.unproven.push(object.key.clone());
            }
            self.read.insert(object.key, digest);
        }
        Ok(())
    }

    /// Whether some object names this digest, or is the object that has it.
    pub(crate) fn names(&self, digest: Digest) -> bool {
        self.named.contains(&digest)
    }

    /// Fails if a manifest or an entry has no copy among the blobs: it is not the one that was written.
    fn check(&mut self, store: &Store) -> Result<()> {
        for object in self.unproven.drain(..) {
            let digest = self.read[&object];
            if store.object(&blob_key(digest))?.is_none() {
                return Err(
                    Problem { model: None, file: None, object, fault: Fault::Altered { digest } }.into()
                );
            }
        }
        Ok(())
    }
}

/// Whether `key` is that of a manifest or an entry.
fn is_numbered(key: &str) -> bool {
    let kind = key.split('/').nth(2);
    let object = key.rsplit('/').next().unwrap_or(key);
    kind.is_some_and(|kind| matches!(kind, "versions" | "aliases" | "yanks" | "attachments"))
        && (version_number(object).is_some() || entry_number(object).is_some())
}

/// All digests that are written in `bytes`.
fn digests(bytes: &[u8]) -> Vec<Digest> {
    let text = String::from_utf8_lossy(bytes);
    let starts = text.match_indices("sha256:").map(|(start, _)| start);
    starts.filter_map(|start| text.get(start..start + 71)?.parse().ok()).collect()
}

/// The digest that names the blob `key`; none if it is not the key of a blob.
fn blob_digest(key: &str) -> Option<Digest> {
    let digest = format!("sha256:{}", key.rsplit_once('/')?.1).parse().ok()?;
    (blob_key(digest) == key).then_some(digest)
}

fn old(object: Object, now: SystemTime, grace: Duration) -> Option<Garbage> {
    // What was written after `now`, by clocks that differ, is young.
    let age = now.duration_since(object.modified).ok().filter(|&age| age >= grace)?;
    Some(Garbage { key: object.key, size: object.size, age_s: age.as_secs() })
}

/// Finds half-written files: those in the folder `part` of `root` and, unless it is the root itself, in its folders. Links are
/// not followed.
fn staged(root: &Path, part: &str, found: &mut Vec<Object>) -> Result<()> {
    let folder = root.join(part);
    if !folder.is_dir() {
        return Ok(());
    }
    for entry in fs::read_dir(&folder).map_err(Error::io("read the folder", &folder))? {
        let entry = entry.map_err(Error::io("read the folder", &folder))?;
        let kind = entry.file_type().map_err(Error::io("read", &entry.path()))?;
        let Ok(name) = entry.file_name().into_string() else { continue };
        let key = if part.is_empty() { name } else { format!("{part}/{name}") };
        if kind.is_dir() && !part.is_empty() {
            staged(root, &key, found)?;
        } else if kind.is_file() && is_staged(&key) {
            found.extend(file(&entry.path(), &key)?);
        }
    }
    Ok(())
}

/// The file `path`, which is the object `key`; none if it is gone: it was moved to its place meanwhile.
fn file(path: &Path, key: &str) -> Result<Option<Object>> {
    let Ok(metadata) = fs::symlink_metadata(path) else { return Ok(None) };
    let modified = metadata.modified().map_err(Error::io("read", path))?;
    Ok(metadata.is_file().then(|| Object { key: key.to_owned(), size: metadata.len(), modified }))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fixture::{Place, bytes, evaluation, flip, model};
    use crate::log::{Expect, Remark};
    use crate::manifest::Provenance;
    use crate::publish::SMALL;

    const DAY: Duration = Duration::from_hours(24);

    /// A registry with versions, an alias, a yank, an attachment, and two blobs that nothing names.
    fn littered(place: &Place) -> Registry {
        let registry = place.registry();
        let first = place.publish(&registry, "approach", b"one");
        place.publish(&registry, "approach", b"two");
        let none = Remark::default();
        registry.set_alias(&"champion".parse().unwrap(), &first, Expect::Anything, &none).unwrap();
        registry.yank(&first, &none).unwrap();
        registry.attach(&first, &evaluation("error_mm", 0.5), &none).unwrap();
        for orphan in [&b"orphan"[..], b"litter"] {
            registry.store.put_blob(Digest::of(orphan), orphan.to_vec()).unwrap();
        }
        registry
    }

    /// Here stores tell the time of the machine.
    #[expect(clippy::disallowed_methods, reason = "what is written now is as old as the clock says")]
    fn now() -> SystemTime {
        SystemTime::now()
    }

    fn in_days(days: u32) -> SystemTime {
        now() + DAY * days
    }

    fn keys(garbage: &[Garbage]) -> Vec<String> {
        garbage.iter().map(|garbage| garbage.key.clone()).collect()
    }

    fn orphans() -> Vec<String> {
        let mut keys = vec![blob_key(Digest::of(b"orphan")), blob_key(Digest::of(b"litter"))];
        keys.sort();
        keys
    }

    #[test]
    fn only_old_blobs_that_nothing_names_are_deleted() {
        for place in Place::all() {
            let registry = littered(&place);
            let before = registry.store.walk(BLOBS).unwrap().len();
            assert_eq!(registry.garbage(in_days(13), GRACE).unwrap(), [], "still young");
            let garbage = registry.garbage(in_days(15), GRACE).unwrap();
            assert_eq!(keys(&garbage), orphans());
            assert_eq!((garbage[0].size, garbage[0].age_s / 3600), (6, 15 * 24));
            assert_eq!(registry.store.walk(BLOBS).unwrap().len(), before, "looking changes nothing");

            assert_eq!(
                registry.delete_garbage(garbage.clone(), in_days(13), GRACE).unwrap(),
                [],
                "young again"
            );
            assert_eq!(registry.delete_garbage(garbage.clone(), in_days(15), GRACE).unwrap(), garbage);
            assert_eq!(registry.store.walk(BLOBS).unwrap().len(), before - 2);
            assert_eq!(registry.garbage(in_days(15), Duration::ZERO).unwrap(), []);
            assert!(registry.verify(None).unwrap().problems.is_empty());
            assert_eq!(registry.delete_garbage(garbage, in_days(15), GRACE).unwrap(), [], "gone already");
        }
    }

    /// What a probe that was killed leaves, in a bucket as well.
    #[test]
    fn old_probes_are_deleted() {
        for place in Place::all() {
            let registry = littered(&place);
            for key in ["probe-0", "probe-12", "probe-a", "probe-"] {
                registry.store.put(key, b"first".to_vec()).unwrap();
            }
            assert_eq!(registry.garbage(in_days(13), GRACE).unwrap(), [], "one may be under way");
            let garbage = registry.garbage(in_days(15), GRACE).unwrap();
            let mut expected = orphans();
            expected.extend(["probe-0".to_owned(), "probe-12".to_owned()]);
            assert_eq!(keys(&garbage), expected);
            assert_eq!(
                registry.delete_garbage(garbage.clone(), in_days(13), GRACE).unwrap(),
                [],
                "young again"
            );
            assert_eq!(registry.delete_garbage(garbage, in_days(15), GRACE).unwrap().len(), 4);
            assert_eq!(registry.store.list("").unwrap().objects, ["probe-", "probe-a", "registry.json"]);
        }
    }

    /// What was garbage when it was listed is named by a version when it is to be deleted.
    #[test]
    fn what_is_published_meanwhile_stays() {
        for place in Place::all() {
            let registry = littered(&place);
            let garbage = registry.garbage(in_days(15), GRACE).unwrap();
            let checkpoint = place.checkpoint("late", b"orphan");
            registry.publish(&model("late"), &checkpoint, Provenance::default()).unwrap();
            let deleted = registry.delete_garbage(garbage, in_days(15), GRACE).unwrap();
            assert_eq!(keys(&deleted), [blob_key(Digest::of(b"litter"))]);
            assert!(registry.verify(None).unwrap().problems.is_empty());
        }
    }

    /// Between its blobs and its manifest, a publication that found its blob stored long ago must not lose it.
    #[test]
    fn a_blob_that_a_publication_relies_on_is_young() {
        let place = Place::local();
        let registry = littered(&place);
        let orphan = place.path("registry").join(blob_key(Digest::of(b"orphan")));
        let age = |path| fs::metadata(path).unwrap().modified().unwrap().elapsed().unwrap();
        let grow_old = |path| {
            fs::File::options().write(true).open(path).unwrap().set_modified(now() - DAY * 100).unwrap();
        };
        grow_old(&orphan);
        assert_eq!(registry.garbage(now(), GRACE).unwrap().len(), 1);
        let checkpoint = place.checkpoint("late", b"orphan");
        registry.publish(&model("late"), &checkpoint, Provenance::default()).unwrap();
        assert!(age(&orphan) < DAY);
        // What a version names is safe as it is, and not written again if that takes long.
        let version = place.publish(&registry, "large", &bytes(SMALL as usize + 1));
        let blob = place.path("registry").join(blob_key(version.manifest.layers[2].digest));
        grow_old(&blob);
        assert_eq!(place.publish(&registry, "larger", &bytes(SMALL as usize + 1)).version, 1);
        assert!(age(&blob) > DAY);
    }

    /// Damaged, neither a manifest nor an entry names its blobs any more.
    #[test]
    fn a_damaged_registry_is_left_alone() {
        for key in
            ["models/approach/versions/000002.json", "models/approach/attachments/000001/000000001.json"]
        {
            let place = Place::local();
            let registry = littered(&place);
            let garbage = registry.garbage(in_days(15), GRACE).unwrap();
            flip(&place.path("registry"), key);
            assert!(matches!(registry.garbage(in_days(15), GRACE), Err(Error::Damaged(_))));
            assert!(matches!(registry.delete_garbage(garbage, in_days(15), GRACE), Err(Error::Damaged(_))));
            assert!(orphans().iter().all(|key| place.path("registry").join(key).exists()));
        }
    }

    #[test]
    fn half_written_files_are_garbage() {
        let place = Place::local();
        let registry = littered(&place);
        let root = place.path("registry");
        let leftovers = ["models/approach/versions/000003.json#1", "registry.json#12"];
        fs::create_dir_all(root.join("pulled/x")).unwrap();
        for name in leftovers.iter().chain(&["notes#1a", "pulled/x/file#1"]) {
            fs::write(root.join(name), "half").unwrap();
        }
        let garbage = registry.garbage(in_days(15), GRACE).unwrap();
        let mut expected = orphans();
        expected.extend(leftovers.map(str::to_owned));
        assert_eq!(keys(&garbage), expected);
        assert_eq!(registry.delete_garbage(garbage, in_days(15), GRACE).unwrap().len(), 4);
        assert!(leftovers.iter().all(|name| !root.join(name).exists()));
        assert!(root.join("notes#1a").exists() && root.join("pulled/x/file#1").exists());
    }

    #[test]
    fn digests_are_found_wherever_they_stand() {
        let (a, b) = (Digest::of(b"a"), Digest::of(b"b"));
        let text = format!("{{\"x\":\"{a}\",sha256:é \u{fffd}{b}sha256:12");
        assert_eq!(digests(text.as_bytes()), [a, b]);
        assert_eq!(blob_digest(&blob_key(a)), Some(a));
        assert_eq!(blob_digest("blobs/sha256/ab/notes.txt"), None);
    }
}
