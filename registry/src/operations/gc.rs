//! Garbage collection: blobs that nothing names, half-written files and probes. Interrupted operations leave them.
//!
//! A blob is garbage if no pointer, manifest or event names its digest, and if it was last written before a grace period. The grace
//! period protects publications in progress: they store their blobs before a manifest names them. A publication that finds a
//! blob already stored, but named by nothing, writes it again. So each blob that it relies on is either named or younger than the
//! publication.
//!
//! Immediately before each deletion, the names and the age of the blob are checked again. A publication could still lose a blob if,
//! within the milliseconds between this check and the deletion, it writes the content of a blob that was unused for the whole
//! grace period. `verify` finds such a loss, and publishing the same checkpoint again repairs it.

use std::collections::BTreeSet;
use std::time::{Duration, SystemTime};

use serde::Serialize;

use crate::digest::Digest;
use crate::error::Result;
use crate::registry::Registry;
use crate::store::folder::is_staged;
use crate::store::probe::is_probe;
use crate::store::sequence::parse_number;
use crate::store::{BLOBS, Listing, MODELS, Object, Store, blob_key, file_name};

/// Default minimum age of garbage to be deleted: 14 days.
pub const GRACE: Duration = Duration::from_hours(14 * 24);

/// An object that nothing needs.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
#[non_exhaustive]
pub struct Garbage {
    /// Its key below the registry's root.
    pub key: String,
    /// Its size in bytes.
    pub size: u64,
    /// Seconds since it was written, by the store's clock.
    pub age_s: u64,
}

impl Registry {
    /// Finds everything that nothing needs and that is older than `grace`, sorted by key. Changes nothing.
    ///
    /// Fails if a pointer, manifest or event is damaged, because the blobs that it names are unknown.
    pub fn garbage(&self, now: SystemTime, grace: Duration) -> Result<Vec<Garbage>> {
        // Blobs before references: what is published in between is not among the blobs yet.
        let blobs = self.store.walk(BLOBS)?.checked()?;
        let mut references = References::default();
        let models = references.update(&self.store)?;
        let top = self.store.list("")?.checked()?;
        let is_unneeded = |key: &str| {
            let is_unnamed = blob_digest(key).is_some_and(|digest| !references.named.contains(&digest));
            is_unnamed || is_probe(key) || is_staged(key)
        };
        let objects = [blobs, models, top].into_iter().flat_map(|listing| listing.objects);
        let unneeded = objects.filter(|object| is_unneeded(&object.key));
        let mut garbage: Vec<_> = unneeded.filter_map(|object| old(object, now, grace)).collect();
        garbage.sort_by(|a, b| a.key.cmp(&b.key));
        Ok(garbage)
    }

    /// Deletes those of `garbage` that are still garbage, checked immediately before each deletion, and returns them.
    ///
    /// If the store refuses one, the previous ones are already deleted.
    pub fn delete_garbage(
        &self,
        garbage: Vec<Garbage>,
        now: SystemTime,
        grace: Duration,
    ) -> Result<Vec<Garbage>> {
        let mut references = References::default();
        let mut deleted = Vec::new();
        for found in garbage {
            references.update(&self.store)?;
            let is_named = blob_digest(&found.key).is_some_and(|digest| references.named.contains(&digest));
            let folder = found.key.rsplit_once('/').map_or("", |(folder, _)| folder);
            let beside = self.store.list(folder)?.checked()?.objects;
            let object = beside.into_iter().find(|object| object.key == found.key);
            if !is_named && object.and_then(|object| old(object, now, grace)).is_some() {
                self.store.delete(&found.key)?;
                deleted.push(found);
            }
        }
        Ok(deleted)
    }
}

/// Every digest that a pointer, manifest or event contains.
#[derive(Debug, Default)]
pub(crate) struct References {
    /// Objects that were read. They never change, so none is read twice.
    read: BTreeSet<String>,
    pub(crate) named: BTreeSet<Digest>,
}

impl References {
    /// Reads the objects that have appeared. Returns all objects of models. Fails if one is damaged.
    pub(crate) fn update(&mut self, store: &Store) -> Result<Listing> {
        let models = store.walk(MODELS)?.checked()?;
        for Object { key, .. } in &models.objects {
            if self.read.contains(key) || is_staged(key) {
                continue;
            }
            let Some(bytes) = store.read(key)? else { continue };
            self.named.extend(digests(&bytes));
            if parse_number(file_name(key)).is_some() {
                self.named.extend(digests(&store.follow("", key)?.0));
            }
            self.read.insert(key.clone());
        }
        Ok(models)
    }
}

/// Returns all digests in `bytes`.
fn digests(bytes: &[u8]) -> Vec<Digest> {
    let text = String::from_utf8_lossy(bytes);
    let starts = text.match_indices("sha256:").map(|(start, _)| start);
    starts.filter_map(|start| text.get(start..start + 71)?.parse().ok()).collect()
}

/// Returns the digest of the blob `key`, `None` if it is not the key of a blob.
fn blob_digest(key: &str) -> Option<Digest> {
    let digest = format!("sha256:{}", file_name(key)).parse().ok()?;
    (blob_key(digest) == key).then_some(digest)
}

fn old(object: Object, now: SystemTime, grace: Duration) -> Option<Garbage> {
    // An object that seems to be written after `now`, because clocks differ, is young.
    let age = now.duration_since(object.modified).ok().filter(|&age| age >= grace)?;
    Some(Garbage { key: object.key, size: object.size, age_s: age.as_secs() })
}

#[cfg(test)]
mod tests {
    use std::fs;

    use super::*;
    use crate::error::Error;
    use crate::events::alias::Precondition;
    use crate::fixture::{Place, bytes, evaluation, flip, model};
    use crate::model::Note;
    use crate::model::Provenance;
    use crate::operations::publish::SMALL;

    const DAY: Duration = Duration::from_hours(24);

    /// A registry with versions, an alias, a yank, an attachment, and two blobs that nothing names.
    fn littered(place: &Place) -> Registry {
        let registry = place.registry();
        let first = place.publish(&registry, "approach", b"one");
        place.publish(&registry, "approach", b"two");
        let none = Note::default();
        registry.set_alias(&"champion".parse().unwrap(), &first, Precondition::Any, &none).unwrap();
        registry.yank(&first, &none).unwrap();
        registry.attach(&first, &evaluation("error_mm", 0.5), &none).unwrap();
        for orphan in [&b"orphan"[..], b"litter"] {
            registry.store.put_blob(orphan.to_vec()).unwrap();
        }
        registry
    }

    /// The time by the clock of the stores, which is the machine's here.
    #[expect(clippy::disallowed_methods, reason = "the stores use the machine's clock")]
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
            let before = registry.store.walk(BLOBS).unwrap().objects.len();
            assert_eq!(registry.garbage(in_days(13), GRACE).unwrap(), [], "still young");
            let garbage = registry.garbage(in_days(15), GRACE).unwrap();
            assert_eq!(keys(&garbage), orphans());
            assert_eq!((garbage[0].size, garbage[0].age_s / 3600), (6, 15 * 24));
            assert_eq!(registry.store.walk(BLOBS).unwrap().objects.len(), before, "looking changes nothing");

            assert_eq!(
                registry.delete_garbage(garbage.clone(), in_days(13), GRACE).unwrap(),
                [],
                "young again"
            );
            assert_eq!(registry.delete_garbage(garbage.clone(), in_days(15), GRACE).unwrap(), garbage);
            assert_eq!(registry.store.walk(BLOBS).unwrap().objects.len(), before - 2);
            assert_eq!(registry.garbage(in_days(15), Duration::ZERO).unwrap(), []);
            assert!(registry.verify(None).unwrap().problems.is_empty());
            assert_eq!(registry.delete_garbage(garbage, in_days(15), GRACE).unwrap(), [], "gone already");
        }
    }

    /// Killed probes leave them, also in a bucket.
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
            let left = registry.store.list("").unwrap().objects;
            let left: Vec<_> = left.iter().map(|object| object.key.as_str()).collect();
            assert_eq!(left, ["probe-", "probe-a", "registry.json"]);
        }
    }

    /// A blob that was listed as garbage is named by a version when it is about to be deleted.
    #[test]
    fn blobs_published_in_the_meantime_stay() {
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

    /// A publication that finds its blob stored long ago must not lose it before its manifest is written.
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
        // A blob that a version names is safe. It is not written again if it is large.
        let version = place.publish(&registry, "large", &bytes(SMALL as usize + 1));
        let blob = place.path("registry").join(blob_key(version.manifest.layers[2].digest));
        grow_old(&blob);
        assert_eq!(place.publish(&registry, "larger", &bytes(SMALL as usize + 1)).version, 1);
        assert!(age(&blob) > DAY);
    }

    /// What a damaged pointer, manifest or event names is unknown.
    #[test]
    fn a_damaged_registry_is_left_alone() {
        for key in [
            "versions/000002",
            "events/000001/000002",
            "versions/000002 manifest",
            "events/000001/000001 event",
        ] {
            let place = Place::local();
            let registry = littered(&place);
            let garbage = registry.garbage(in_days(15), GRACE).unwrap();
            let (pointer, document) =
                key.split_once(' ').map_or((key, false), |(pointer, _)| (pointer, true));
            let pointer = format!("models/approach/{pointer}");
            let digest = registry.store.follow("", &pointer).unwrap().1;
            let key = if document { blob_key(digest) } else { pointer };
            flip(&place.path("registry"), &key);
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
        let leftovers = ["models/approach/versions/000003#1", "registry.json#12"];
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
    fn digests_are_found_anywhere() {
        let (a, b) = (Digest::of(b"a"), Digest::of(b"b"));
        let text = format!("{{\"x\":\"{a}\",sha256:é \u{fffd}{b}sha256:12");
        assert_eq!(digests(text.as_bytes()), [a, b]);
        assert_eq!(blob_digest(&blob_key(a)), Some(a));
        assert_eq!(blob_digest("blobs/sha256/ab/notes.txt"), None);
    }
}
