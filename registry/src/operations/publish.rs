//! Publishing: blobs first, the numbered pointer last.

use std::path::Path;

use crate::digest::{Digest, Fingerprint};
use crate::error::{Error, Result};
use crate::events::attachment::check_finite;
use crate::model::{
    Descriptor, Manifest, ModelName, ModelVersion, Provenance, checkpoint, model_config, safetensors,
};
use crate::operations::gc::References;
use crate::outcome::Outcome;
use crate::problem::{Fault, Problem};
use crate::registry::{Registry, versions_key};
use crate::store::{Store, blob_key};

/// Size of the largest blob that is written without checking whether it exists.
pub(crate) const SMALL: u64 = 1 << 20;

/// Number of manifests in memory at a time.
const BATCH: usize = 64;

/// Decides whether a version with this digest and manifest is the one to be published.
type IsSame<'a> = &'a dyn Fn(Digest, &Manifest) -> bool;

impl Registry {
    /// Publishes the files in the folder `checkpoint` as the next version of `name`. If a version has the same files, no version
    /// is created, and its provenance stays as it was first published.
    ///
    /// Several processes may publish at once: each gets its own number. An interrupted publication creates no version. A blob
    /// that has been damaged since it was stored is repaired.
    pub fn publish(
        &self,
        name: &ModelName,
        checkpoint: &Path,
        provenance: Provenance,
    ) -> Result<Outcome<ModelVersion>> {
        check_finite(&provenance.metrics)?;
        let (from, paths) = checkpoint::open(checkpoint, &[])?;
        for path in &paths {
            check_weights(&from, path, path)?;
        }
        let mut references = References::default();
        let mut layers = Vec::new();
        let mut expected = provenance.expected.clone();
        for path in paths {
            let content = self.keep(&from, &path, &mut references)?;
            if let Some(digest) = expected.remove(&path).filter(|&digest| digest != content.digest) {
                let reason = format!("damaged: it has digest {}, expected {digest}", content.digest);
                return Err(Error::refused(&checkpoint.join(path).display(), reason));
            }
            layers.push(Descriptor::file(&path, content));
        }
        if let Some((path, _)) = expected.pop_first() {
            return Err(Error::refused(&checkpoint.join(path).display(), "missing"));
        }
        let config = model_config(name, &layers);
        self.store.put_blob(config.clone())?;
        let manifest = Manifest::new(name, &config, layers, provenance);
        self.add_version(name, &manifest, &manifest.to_bytes()?, &|_, found| found.has_files_of(&manifest))
    }

    /// Creates a version under the first free number, unless it is the same as an existing one. `bytes` are those of the manifest.
    pub(crate) fn add_version(
        &self,
        name: &ModelName,
        manifest: &Manifest,
        bytes: &[u8],
        is_same: IsSame,
    ) -> Result<Outcome<ModelVersion>> {
        let folder = versions_key(name);
        let digest = self.store.put_document(name, bytes)?;
        let mut taken = 0;
        loop {
            let numbers = self.versions(name)?;
            let newer = &numbers[numbers.partition_point(|&number| number < taken)..];
            if let Some(version) = self.same(name, newer, is_same)? {
                return Ok(Outcome::AlreadyThere(self.with_yank(version)?));
            }
            let number = numbers.last().copied().unwrap_or(0).max(taken) + 1;
            if self.store.point(&folder, number, digest)? {
                return Ok(Outcome::New(ModelVersion::new(name, number, digest, manifest.clone())));
            }
            // Another process took the number. It may have published the same.
            taken = number;
        }
    }

    /// Finds the first of these versions that is the same.
    fn same(&self, name: &ModelName, numbers: &[u64], is_same: IsSame) -> Result<Option<ModelVersion>> {
        for numbers in numbers.chunks(BATCH) {
            let pointers = self.store.pointers(&versions_key(name), numbers)?;
            let keys: Vec<_> = pointers.iter().map(|&(_, digest)| blob_key(digest)).collect();
            for ((number, digest), bytes) in pointers.into_iter().zip(self.store.read_each(&keys)?) {
                // A damaged version does not prevent the next one.
                let intact = Some(bytes).filter(|bytes| Digest::of(bytes) == digest);
                let manifest = intact.and_then(|bytes| Manifest::parse(&bytes).ok());
                if let Some(manifest) = manifest.filter(|found| is_same(digest, found)) {
                    return Ok(Some(ModelVersion::new(name, number, digest, manifest)));
                }
            }
        }
        Ok(None)
    }

    /// Copies `blobs` from the store `from`, where `locate` gives their keys, and verifies them.
    pub(crate) fn transfer<'a>(
        &self,
        from: &Store,
        blobs: impl Iterator<Item = &'a Descriptor> + Clone,
        locate: &dyn Fn(&Descriptor) -> String,
    ) -> Result<()> {
        for blob in blobs.clone() {
            check_weights(from, &locate(blob), blob.path().unwrap_or_default())?;
        }
        let mut references = References::default();
        for blob in blobs {
            let key = locate(blob);
            let stored = self.keep(from, &key, &mut references)?;
            if let Some(fault) = Fault::of_blob(blob.content(), Some(stored)) {
                let file = blob.path().map(str::to_owned);
                return Err(Problem { file, ..fault.of("", &key) }.into());
            }
        }
        Ok(())
    }

    /// Stores the object `key` of the store `from` as a blob. An existing blob need not be written if it is intact, and named, so
    /// that it cannot be deleted as garbage before the new manifest names it. Writing a small blob is faster than checking that.
    /// `references` are read when a large blob exists already.
    fn keep(&self, from: &Store, key: &str, references: &mut References) -> Result<Fingerprint> {
        self.store.upload(from, key, &mut |content| {
            if content.size <= SMALL || self.store.inspect(&blob_key(content.digest))? != Some(content) {
                return Ok(false);
            }
            match references.update(&self.store) {
                // What a damaged object named is unknown.
                Err(Error::Damaged(_)) => Ok(false),
                updated => updated.map(|_| references.named.contains(&content.digest)),
            }
        })
    }
}

/// Refuses the file `path` of a checkpoint, which lies in the store `from` under `key`, if it is a malformed safetensors file.
fn check_weights(from: &Store, key: &str, path: &str) -> Result<()> {
    let start = |limit| Ok(from.read_start(key, limit)?.unwrap_or_default());
    let refuse = |reason| Error::refused(&format!("{}/{key}", from.root), format!("{path} {reason}"));
    safetensors::check(path, &start)?.map_err(refuse)
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeMap;
    use std::fs;

    use super::*;
    use crate::error::Error;
    use crate::fixture::{Place, bytes, flip, misbehaving, model};
    use crate::model::Lineage;
    use crate::store::DOCUMENT_LIMIT;
    use crate::store::misbehaving::Misbehavior;
    use crate::store::sequence::{LAST_NUMBER, pointer_key};

    fn publish(registry: &Registry, checkpoint: &Path) -> Outcome<ModelVersion> {
        registry.publish(&model("approach"), checkpoint, Provenance::default()).unwrap()
    }

    /// Lists all files below `root` with the digests of their content.
    fn snapshot(root: &Path) -> Vec<(String, Digest)> {
        fn walk(folder: &Path, found: &mut Vec<(String, Digest)>) {
            for entry in fs::read_dir(folder).unwrap() {
                let path = entry.unwrap().path();
                if path.is_dir() {
                    walk(&path, found);
                } else {
                    found.push((path.display().to_string(), Digest::of(&fs::read(&path).unwrap())));
                }
            }
        }
        let mut found = Vec::new();
        walk(root, &mut found);
        found.sort();
        found
    }

    #[test]
    fn provenance_reads_back_exactly() {
        for place in Place::all() {
            let registry = place.registry();
            let provenance = Provenance {
                lineage: Lineage {
                    datasets: BTreeMap::from([("b_2a".into(), Digest::of(b"dataset"))]),
                    config: Some(Digest::of(b"config")),
                    parent: Some(Digest::of(b"parent")),
                    code_revision: Some("4f1c2d".into()),
                    seed: Some(u64::MAX),
                    device: Some("cpu".into()),
                    software: BTreeMap::from([("burn".into(), "0.22.1".into())]),
                },
                metrics: BTreeMap::from([("position_error_mm".into(), 0.1 + 0.2), ("x".into(), 1e-300)]),
                interface: BTreeMap::from([("input".into(), serde_json::json!(["image", 1.0 / 3.0]))]),
                created: Some("2026-11-22T10:00:00Z".into()),
                expected: BTreeMap::new(),
            };
            let checkpoint = place.checkpoint("checkpoint", b"weights");
            let published = registry.publish(&model("approach"), &checkpoint, provenance.clone()).unwrap();
            assert!(matches!(published, Outcome::New(_)));
            let shown = registry.show(&"approach@1".parse().unwrap()).unwrap();
            assert_eq!(&shown, published.value());
            assert_eq!(shown.manifest.lineage, provenance.lineage);
            assert_eq!(shown.manifest.metrics, provenance.metrics);
            assert_eq!(shown.manifest.interface, provenance.interface);
            assert_eq!(shown.manifest.created(), provenance.created.as_deref());
        }
    }

    #[test]
    fn the_same_files_are_published_once() {
        let place = Place::local();
        let registry = place.registry();
        let first = place.checkpoint("first", b"one");
        let second = place.checkpoint("second", b"two");
        let version = publish(&registry, &first).value().clone();
        publish(&registry, &second);
        let before = snapshot(&place.path("registry"));
        assert_eq!(publish(&registry, &first), Outcome::AlreadyThere(version));
        assert_eq!(snapshot(&place.path("registry")), before);
        // Under another name it is another model.
        let other = registry.publish(&model("avoid"), &first, Provenance::default()).unwrap();
        assert_eq!(other.value().to_string(), "avoid@1");
    }

    /// The layout that later programs and other tools rely on.
    #[test]
    fn layout() {
        let place = Place::local();
        let version = place.publish(&place.registry(), "approach", b"abc");
        let root = place.path("registry");
        let keys: Vec<_> = snapshot(&root).into_iter().map(|(path, _)| path).collect();
        let has = |key: &str| keys.contains(&root.join(key).display().to_string());
        assert!(has("registry.json") && has("models/approach/versions/000001"));
        assert!(has("blobs/sha256/ba/ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad"));
        assert!(has(&blob_key(version.digest)) && has(&blob_key(version.manifest.config.digest)));
        assert_eq!(keys.len(), 7, "and two more files: {keys:?}");
    }

    #[test]
    fn publishing_again_repairs_a_damaged_blob() {
        let place = Place::local();
        let registry = place.registry();
        let checkpoint = place.checkpoint("checkpoint", b"weights");
        let version = publish(&registry, &checkpoint).value().clone();
        flip(&place.path("registry"), &blob_key(version.manifest.layers[2].digest));
        assert_eq!(registry.verify(None).unwrap().problems.len(), 1);
        assert_eq!(publish(&registry, &checkpoint), Outcome::AlreadyThere(version));
        assert!(registry.verify(None).unwrap().problems.is_empty());
    }

    /// Each thread publishes its own checkpoints, and a shared one.
    #[test]
    fn concurrent_publishers_lose_nothing() {
        for place in Place::all() {
            let registry = place.registry();
            let shared = place.checkpoint("shared", &bytes(1000));
            std::thread::scope(|scope| {
                for thread in 0..8 {
                    let (registry, place, shared) = (&registry, &place, &shared);
                    scope.spawn(move || {
                        for round in 0..3 {
                            let own = place.checkpoint(&format!("own{thread}"), &[thread, round]);
                            assert!(matches!(publish(registry, &own), Outcome::New(_)));
                        }
                        publish(registry, shared);
                    });
                }
            });
            let versions = registry.versions(&model("approach")).unwrap();
            assert_eq!(versions, (1..=25).collect::<Vec<_>>());
            let mut weights: Vec<_> = versions
                .iter()
                .map(|&number| registry.load(&model("approach"), number).unwrap().manifest.layers[2].digest)
                .collect();
            weights.sort();
            weights.dedup();
            assert_eq!(weights.len(), 25, "each checkpoint exactly once");
            assert!(registry.verify(None).unwrap().problems.is_empty());
        }
    }

    #[test]
    fn a_lost_response_is_not_a_conflict() {
        for misbehavior in [Misbehavior::LosesAnswers, Misbehavior::DeniesEveryOther] {
            let (place, registry) = (Place::local(), Registry { store: misbehaving(misbehavior) });
            for number in 1..=3 {
                assert_eq!(place.publish(&registry, "approach", &[number as u8]).version, number);
            }
            assert_eq!(registry.verify(None).unwrap().problems, []);
        }
    }

    /// A killed publication may leave blobs and half-written files, but no version.
    #[test]
    fn leftovers_of_a_crash_are_harmless() {
        let place = Place::local();
        let registry = place.registry();
        registry.store.put_blob(b"orphan".to_vec()).unwrap();
        let versions = place.path("registry/models/approach/versions");
        fs::create_dir_all(&versions).unwrap();
        fs::write(versions.join("000001#1"), "sha256:").unwrap();
        assert!(registry.list().unwrap().is_empty());
        assert!(registry.verify(None).unwrap().problems.is_empty());
        assert_eq!(place.publish(&registry, "approach", b"weights").version, 1);
    }

    #[test]
    fn a_number_that_something_else_has_is_skipped() {
        let place = Place::local();
        let registry = place.registry();
        fs::create_dir_all(place.path("registry/models/approach/versions/000001")).unwrap();
        assert_eq!(place.publish(&registry, "approach", b"weights").version, 2);
    }

    #[test]
    fn values_that_json_cannot_represent_are_refused() {
        let place = Place::local();
        let registry = place.registry();
        let checkpoint = place.checkpoint("checkpoint", b"weights");
        let metrics = BTreeMap::from([("loss".into(), f64::NAN)]);
        let provenance = Provenance { metrics, ..Provenance::default() };
        let message = registry.publish(&model("approach"), &checkpoint, provenance).unwrap_err().to_string();
        assert!(message.contains("`loss`: it is NaN"), "{message}");
        assert!(registry.list().unwrap().is_empty());
    }

    #[test]
    fn a_damaged_checkpoint_is_refused() {
        for place in Place::all() {
            let registry = place.registry();
            let checkpoint = place.checkpoint("checkpoint", b"weights");
            let publish = |path: &str, content: &[u8]| {
                let expected = BTreeMap::from([(path.to_owned(), Digest::of(content))]);
                let provenance = Provenance { expected, ..Provenance::default() };
                registry
                    .publish(&model("approach"), &checkpoint, provenance)
                    .map_err(|error| error.to_string())
            };
            let damaged = publish("state/step.json", b"8").unwrap_err();
            assert!(damaged.contains("step.json") && damaged.contains("damaged"), "{damaged}");
            assert!(publish("optimizer.json", b"").unwrap_err().contains("optimizer.json: missing"));
            assert!(registry.list().unwrap().is_empty());
            publish("state/step.json", b"7").unwrap();
        }
    }

    /// Blobs are written before the number is taken: a publication that ends there has created no version.
    #[test]
    fn a_failed_publication_creates_no_version() {
        let place = Place::local();
        let registry = place.registry();
        let checkpoint = place.checkpoint("checkpoint", b"abc");
        let obstacle = place.path("registry/models");
        fs::write(&obstacle, "").unwrap();
        let result = registry.publish(&model("approach"), &checkpoint, Provenance::default());
        assert!(matches!(result, Err(Error::Failed { .. })), "{result:?}");
        assert!(place.path("registry").join(blob_key(Digest::of(b"abc"))).exists());
        fs::remove_file(obstacle).unwrap();
        assert!(registry.list().unwrap().is_empty());
        assert_eq!(publish(&registry, &checkpoint).value().version, 1);
    }

    #[test]
    fn what_could_not_be_read_back_is_not_written() {
        let place = Place::local();
        let registry = place.registry();
        let mut version = place.publish(&registry, "approach", b"weights");
        let publish = |manifest: &Manifest| {
            let published =
                registry.add_version(&version.name, manifest, &manifest.to_bytes().unwrap(), &|_, _| false);
            published.unwrap_err().to_string()
        };
        version.manifest.lineage.device = Some("x".repeat(DOCUMENT_LIMIT as usize));
        assert!(publish(&version.manifest).contains("more than 4194304"));
        version.manifest.lineage.device = None;
        let last = pointer_key(&versions_key(&version.name), LAST_NUMBER);
        registry.store.put(&last, b"taken".to_vec()).unwrap();
        assert!(publish(&version.manifest).contains("all 999999 numbers are taken"));
    }
}
