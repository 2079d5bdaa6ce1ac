//! Copying versions to another registry.

use serde::Serialize;

use crate::error::{Error, Result};
use crate::events::yank::last_yank;
use crate::model::ModelVersion;
use crate::problem::Problem;
use crate::registry::Registry;
use crate::store::blob_key;

/// What was copied of a version.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[non_exhaustive]
pub struct Copied {
    /// The version in the other registry.
    pub version: ModelVersion,
    /// Whether it was created there. Otherwise it existed before.
    pub is_new: bool,
    /// Number of attachments that were added.
    pub attachments: usize,
    /// Whether it was yanked there, as it is here.
    pub yanked: bool,
}

impl Registry {
    /// Copies `version`, a version of this registry, to the registry `to`, with its attachments and its yank.
    ///
    /// The manifest is copied byte for byte, so its digest stays the same and signatures stay valid. The copy gets the next number
    /// of the model there, since numbers have no gaps. Copying again adds only what is missing, also after an interruption. A
    /// yank, or its reversal, that was recorded in the other registry is left as it is.
    pub fn copy(&self, version: &ModelVersion, to: &Registry) -> Result<Copied> {
        let stored = to.transfer(&self.store, version.manifest.blobs(), &|blob| blob_key(blob.digest));
        stored.map_err(|error| match error {
            Error::Damaged(problem) => Problem { model: Some(version.to_string()), ..*problem }.into(),
            error => error,
        })?;
        let bytes = self.store.document(&version.to_string(), version.digest)?;
        let same = |digest, _: &_| digest == version.digest;
        let copied = to.add_version(&version.name, &version.manifest, &bytes, &same)?;
        let (is_new, mut copied) = (copied.is_new(), copied.value().clone());
        let mut attachments = 0;
        for event in self.attachments(version)? {
            let Some(attached) = &event.attached else { continue };
            let bytes = self.store.document(&format!("{version}/events"), attached.digest)?;
            attachments += usize::from(to.attach_bytes(&copied, attached, &bytes, &event.note)?.is_new());
        }
        let mut yanked = false;
        if let Some(note) = &version.yanked
            && last_yank(&to.events(&copied)?).is_none()
        {
            yanked = to.yank(&copied, note)?.is_some();
            copied = to.with_yank(copied)?;
        }
        Ok(Copied { version: copied, is_new, attachments, yanked })
    }
}

#[cfg(test)]
mod tests {
    use std::fs;

    use super::*;
    use crate::events::attachment::Attachment;
    use crate::fixture::{Place, evaluation, flip, key, safetensors, version_key};
    use crate::model::{Note, Provenance};
    use crate::signature::{PublicKey, SignedFiles};

    /// Publishes two versions with attachments. The first is signed, the second yanked.
    fn source(place: &Place) -> (Registry, [ModelVersion; 2]) {
        let registry = place.registry();
        let first = place.publish(&registry, "approach", b"one");
        let second = place.publish(&registry, "approach", b"two");
        let signature = Attachment::Signature(SignedFiles::of_version(&first).sign(&key(1)).unwrap());
        let note = Note { who: Some("ann".into()), ..Note::default() };
        for attachment in [&signature, &evaluation("error_mm", 0.5)] {
            registry.attach(&first, attachment, &note).unwrap();
        }
        registry.yank(&second, &Note { reason: Some("leaked".into()), ..note }).unwrap();
        let second = registry.show(&"approach@2".parse().unwrap()).unwrap();
        (registry, [first, second])
    }

    #[test]
    fn copies_have_the_same_digest_attachments_and_yank() {
        for (from, to) in Place::all().iter().zip(Place::all().iter().rev()) {
            let (registry, versions) = source(from);
            let other = to.registry();
            for (version, attachments, yanked) in [(&versions[0], 2, false), (&versions[1], 0, true)] {
                let copied = registry.copy(version, &other).unwrap();
                let expected = Copied { version: version.clone(), is_new: true, attachments, yanked };
                assert_eq!(copied, expected);
                let again = registry.copy(version, &other).unwrap();
                let expected = Copied { is_new: false, attachments: 0, yanked: false, ..expected };
                assert_eq!(again, expected);
            }
            let public = PublicKey::from_pem(&key(1).public_pem().unwrap()).unwrap();
            let signed = other.signature_by(&versions[0], &public).unwrap();
            assert_eq!(signed.note.who.as_deref(), Some("ann"));
            assert_eq!(other.values(&versions[0]).unwrap(), [("error_mm".to_owned(), 0.5)].into());
            other.pull(&"approach@1".parse().unwrap(), &to.path("pulled")).unwrap();
            assert_eq!(fs::read(to.path("pulled/weights.bin")).unwrap(), b"one");
            assert_eq!(other.verify(None).unwrap().problems, []);
            // A yank that was taken back there stays taken back.
            other.unyank(&versions[1], &Note::default()).unwrap();
            assert!(!registry.copy(&versions[1], &other).unwrap().yanked);
            assert_eq!(other.show(&"approach@2".parse().unwrap()).unwrap().yanked, None);
        }
    }

    /// The number differs, and so do versions with the same files and another provenance.
    #[test]
    fn a_taken_number_is_replaced_by_the_next() {
        let (from, to) = (Place::local(), Place::local());
        let (registry, [first, second]) = source(&from);
        let other = to.registry();
        let provenance = Provenance { created: Some("2026-11-22T10:00:00Z".into()), ..Provenance::default() };
        other.publish(&first.name, &to.checkpoint("run", b"one"), provenance).unwrap();
        let copied = registry.copy(&first, &other).unwrap();
        assert_eq!((copied.version.version, copied.version.digest, copied.is_new), (2, first.digest, true));
        assert_eq!(registry.copy(&second, &other).unwrap().version.version, 3);
        assert_eq!(other.show(&format!("approach@{}", first.digest).parse().unwrap()).unwrap().version, 2);
        let public = PublicKey::from_pem(&key(1).public_pem().unwrap()).unwrap();
        other.signature_by(&copied.version, &public).unwrap();
        assert_eq!(other.verify(None).unwrap().problems, []);
    }

    /// Whatever an interrupted copy has written, the next one completes.
    #[test]
    fn an_interrupted_copy_is_completed() {
        let (from, to) = (Place::local(), Place::local());
        let (registry, [first, _]) = source(&from);
        let other = to.registry();
        registry.copy(&first, &other).unwrap();
        let mut objects = other.store.walk("").unwrap().objects;
        objects.retain(|object| object.key != "registry.json");
        for object in &objects {
            let is_event = object.key.contains("events");
            // Events are written last, and in order.
            if is_event || object.key == version_key(1) {
                fs::remove_dir_all(to.path("registry/models/approach/events")).unwrap();
            }
            fs::remove_file(to.path("registry").join(&object.key))
                .or_else(|error| if is_event { Ok(()) } else { Err(error) })
                .unwrap();
            if object.key.starts_with("blobs") {
                fs::remove_dir_all(to.path("registry/models")).unwrap();
            }
            registry.copy(&first, &other).unwrap();
            assert_eq!(other.verify(None).unwrap().problems, [], "{}", object.key);
            assert_eq!(other.attachments(&first).unwrap().len(), 2);
        }
    }

    #[test]
    fn simultaneous_copies_create_one_version() {
        for place in Place::all() {
            let from = Place::local();
            let (registry, [first, _]) = source(&from);
            let other = place.registry();
            std::thread::scope(|scope| {
                for _ in 0..8 {
                    scope.spawn(|| registry.copy(&first, &other).unwrap());
                }
            });
            assert_eq!(other.versions(&first.name).unwrap(), [1]);
            assert_eq!(other.attachments(&first).unwrap().len(), 2);
            assert_eq!(other.verify(None).unwrap().problems, []);
        }
    }

    #[test]
    fn damage_is_not_copied() {
        let (from, to) = (Place::local(), Place::local());
        let (registry, [first, _]) = source(&from);
        let other = to.registry();
        for blob in first.manifest.blobs() {
            let path = from.path("registry").join(blob_key(blob.digest));
            let intact = fs::read(&path).unwrap();
            flip(&from.path("registry"), &blob_key(blob.digest));
            assert!(matches!(registry.copy(&first, &other), Err(Error::Damaged(_))));
            fs::remove_file(&path).unwrap();
            assert!(matches!(registry.copy(&first, &other), Err(Error::Damaged(_))));
            fs::write(&path, intact).unwrap();
        }
        assert!(other.list().unwrap().is_empty());
    }

    /// A registry of somebody else may hold anything.
    #[test]
    fn weights_that_programs_read_differently_are_not_copied() {
        let (from, to) = (Place::local(), Place::local());
        let (registry, checkpoint) = (from.registry(), from.checkpoint("run", b"w"));
        fs::write(checkpoint.join("weights.safetensors"), safetensors(b"weights")).unwrap();
        let name = "approach".parse().unwrap();
        let published = registry.publish(&name, &checkpoint, Provenance::default()).unwrap();
        let mut manifest = published.value().manifest.clone();
        let bad = [u64::MAX.to_le_bytes(), *b"{}      "].concat();
        let layer =
            manifest.layers.iter_mut().find(|layer| layer.path() == Some("weights.safetensors")).unwrap();
        (layer.digest, layer.size) = (registry.store.put_blob(bad).unwrap(), 16);
        let bytes = manifest.to_bytes().unwrap();
        let bad = registry.add_version(&name, &manifest, &bytes, &|_, _| false).unwrap();
        let refusal = registry.copy(bad.value(), &to.registry()).unwrap_err().to_string();
        assert!(refusal.contains("weights.safetensors is not a safetensors file"), "{refusal}");
        registry.copy(published.value(), &to.registry()).unwrap();
    }
}
