//! Publishing: blobs first, the numbered manifest last.

use std::ops::RangeInclusive;
use std::path::Path;

use serde::Serialize;

use crate::checkpoint;
use crate::digest::{Digest, Fingerprint};
use crate::error::{Error, Result};
use crate::gc::References;
use crate::manifest::{Descriptor, Manifest, Provenance, model_config};
use crate::name::ModelName;
use crate::registry::{ModelVersion, Registry};
use crate::safetensors;
use crate::store::{DOCUMENT_LIMIT, LAST_VERSION, version_key};

/// Bytes of the largest blob that is written without asking whether it is there.
pub(crate) const SMALL: u64 = 1 << 20;

/// How many manifests are in memory at a time.
const AT_ONCE: usize = 64;

/// What publishing did.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[serde(tag = "published", content = "version", rename_all = "snake_case")]
pub enum Published {
    /// A version was created.
    New(ModelVersion),
    /// This version has the same files: none was created. Its provenance stands as it was first published.
    AlreadyThere(ModelVersion),
}

impl Published {
    /// The version that holds the files now.
    pub fn version(&self) -> &ModelVersion {
        match self {
            Self::New(version) | Self::AlreadyThere(version) => version,
        }
    }
}

impl Registry {
    /// Publishes the files in the folder `checkpoint` as the next version of `name`.
    ///
    /// Several processes may publish at once: each gets its own number. If it is interrupted, no version is created. If a
    /// blob was stored before and has been damaged since, it is mended.
    pub fn publish(&self, name: &ModelName, checkpoint: &Path, provenance: Provenance) -> Result<Published> {
        if let Some((metric, &value)) = provenance.metrics.iter().find(|(_, value)| !value.is_finite()) {
            return Err(Error::Metric { name: metric.clone(), value });
        }
        let files = checkpoint::list(checkpoint)?;
        for (path, source) in &files {
            if let Err(reason) = safetensors::check_file(path, source)? {
                return Err(Error::Checkpoint { path: source.clone(), reason });
            }
        }
        let mut references = None;
        let mut layers = Vec::new();
        let mut expected = provenance.expected.clone();
        for (path, source) in files {
            let content = self.keep_file(&source, &mut references)?;
            if let Some(digest) = expected.remove(&path).filter(|&digest| digest != content.digest) {
                let reason = format!("damaged: it has digest {}, and should have {digest}", content.digest);
                return Err(Error::Checkpoint { path: source, reason });
            }
            layers.push(Descriptor::file(&path, content));
        }
        if let Some((path, _)) = expected.pop_first() {
            return Err(Error::Checkpoint { path: checkpoint.join(path), reason: "missing".to_owned() });
        }
        let unwritable =
            |error: serde_json::Error| Error::Version { model: name.to_string(), reason: error.to_string() };
        let config = model_config(name, &layers).map_err(unwritable)?;
        self.store.put_blob(Digest::of(&config), config.clone())?;
        self.number(name, Manifest::new(name, &config, layers, provenance))
    }

    /// Creates `manifest` under the first free number, unless a version with the same files is met on the way.
    pub(crate) fn number(&self, name: &ModelName, mut manifest: Manifest) -> Result<Published> {
        let mut examined = 0;
        let mut taken = 0;
        loop {
            let newest = self.versions(name)?.last().copied().unwrap_or(0).max(taken);
            if let Some(version) = self.same(name, examined + 1..=newest, &manifest)? {
                let yanked = self.yanked(name, version.version)?;
                return Ok(Published::AlreadyThere(ModelVersion { yanked, ..version }));
            }
            examined = newest;
            let number = newest + 1;
            manifest.set_version(number);
            let bytes = encode(&manifest, number)
                .map_err(|reason| Error::Version { model: format!("{name}@{number}"), reason })?;
            let digest = Digest::of(&bytes);
            self.store.put_blob(digest, bytes.clone())?;
            if self.store.create(&version_key(name, number), bytes)? {
                return Ok(Published::New(ModelVersion {
                    name: name.clone(),
                    version: number,
                    digest,
                    manifest,
                    yanked: None,
                }));
            }
            // Another process took the number: see whether it published the same, then try the next.
            taken = number;
        }
    }

    /// Whether a blob need not be written: it is intact, and no garbage that might be deleted before a manifest names it. A
    /// small one is written sooner than that is found out. `references` are read when the first large blob is met that is
    /// there.
    fn is_kept(&self, content: Fingerprint, references: &mut Option<References>) -> Result<bool> {
        if content.size <= SMALL || self.store.inspect_blob(content.digest)? != Some(content) {
            return Ok(false);
        }
        let known = match references {
            Some(known) => known,
            None => references.insert(References::of(&self.store)?),
        };
        Ok(known.names(content.digest))
    }

    /// The first of these versions of `name` that has the same files as `manifest`.
    fn same(
        &self,
        name: &ModelName,
        numbers: RangeInclusive<u64>,
        manifest: &Manifest,
    ) -> Result<Option<ModelVersion>> {
        let numbers: Vec<_> = numbers.collect();
        for numbers in numbers.chunks(AT_ONCE) {
            let keys: Vec<_> = numbers.iter().map(|&number| version_key(name, number)).collect();
            for (&number, bytes) in numbers.iter().zip(self.store.read_each(&keys)?) {
                if !Manifest::parse(&bytes, name, number).is_ok_and(|found| is_same(&found, manifest)) {
                    continue;
                }
                match self.load(name, number) {
                    Ok(version) if is_same(&version.manifest, manifest) => return Ok(Some(version)),
                    // A damaged version is no reason not to publish the next one.
                    Ok(_) | Err(Error::Damaged(_)) => {}
                    Err(error) => return Err(error),
                }
            }
        }
        Ok(None)
    }

    /// Stores a checkpoint's file as a blob, unless it is kept, and says what it holds.
    pub(crate) fn keep_file(
        &self,
        source: &Path,
        references: &mut Option<References>,
    ) -> Result<Fingerprint> {
        self.store.ingest(source, &mut |content| self.is_kept(content, references))
    }
}

/// The bytes of a manifest that can be read back, or why there are none.
fn encode(manifest: &Manifest, number: u64) -> std::result::Result<Vec<u8>, String> {
    if number > LAST_VERSION {
        return Err(format!("a model has at most {LAST_VERSION} versions; publish under a new name"));
    }
    let bytes = manifest.to_bytes().map_err(|error| error.to_string())?;
    if bytes.len() as u64 > DOCUMENT_LIMIT {
        let size = bytes.len();
        return Err(format!(
            "its manifest has {size} bytes, more than {DOCUMENT_LIMIT}; publish fewer files or metrics"
        ));
    }
    Ok(bytes)
}

/// Whether two versions have the same files and configuration.
fn is_same(a: &Manifest, b: &Manifest) -> bool {
    a.config == b.config && a.layers == b.layers
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeMap;
    use std::fs;

    use super::*;
    use crate::fixture::{Place, bytes, flip, model, quirky};
    use crate::manifest::Lineage;
    use crate::quirk::Quirk;
    use crate::store::blob_key;

    fn publish(registry: &Registry, checkpoint: &Path) -> Published {
        registry.publish(&model("approach"), checkpoint, Provenance::default()).unwrap()
    }

    /// All files below `root` and their content.
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
            assert!(matches!(published, Published::New(_)));
            let shown = registry.show(&"approach@1".parse().unwrap()).unwrap();
            assert_eq!(&shown, published.version());
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
        let version = publish(&registry, &first).version().clone();
        publish(&registry, &second);
        let before = snapshot(&place.path("registry"));
        assert_eq!(publish(&registry, &first), Published::AlreadyThere(version));
        assert_eq!(snapshot(&place.path("registry")), before);
        // Under another name it is another model.
        let other = registry.publish(&model("avoid"), &first, Provenance::default()).unwrap();
        assert_eq!(other.version().to_string(), "avoid@1");
    }

    /// The layout that later programs and other tools rely on.
    #[test]
    fn layout() {
        let place = Place::local();
        let version = place.publish(&place.registry(), "approach", b"abc");
        let root = place.path("registry");
        let keys: Vec<_> = snapshot(&root).into_iter().map(|(path, _)| path).collect();
        let has = |key: &str| keys.contains(&root.join(key).display().to_string());
        assert!(has("registry.json") && has("models/approach/versions/000001.json"));
        assert!(has("blobs/sha256/ba/ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad"));
        assert!(has(&blob_key(version.digest)) && has(&blob_key(version.manifest.config.digest)));
        assert_eq!(keys.len(), 7, "and two more files: {keys:?}");
    }

    #[test]
    fn publishing_again_mends_a_damaged_blob() {
        let place = Place::local();
        let registry = place.registry();
        let checkpoint = place.checkpoint("checkpoint", b"weights");
        let version = publish(&registry, &checkpoint).version().clone();
        flip(&place.path("registry"), &blob_key(version.manifest.layers[2].digest));
        assert_eq!(registry.verify(None).unwrap().problems.len(), 1);
        assert_eq!(publish(&registry, &checkpoint), Published::AlreadyThere(version));
        assert!(registry.verify(None).unwrap().problems.is_empty());
    }

    /// Each thread publishes checkpoints of its own and one that all publish.
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
                            assert!(matches!(publish(registry, &own), Published::New(_)));
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
    fn a_lost_answer_is_no_conflict() {
        for quirk in [Quirk::LosesAnswers, Quirk::DeniesEveryOther] {
            let (place, registry) = (Place::local(), Registry { store: quirky(quirk) });
            for number in 1..=3 {
                assert_eq!(place.publish(&registry, "approach", &[number as u8]).version, number);
            }
            assert_eq!(registry.verify(None).unwrap().problems, []);
        }
    }

    /// What a publication that was killed may leave: blobs, staged files, but no version.
    #[test]
    fn leftovers_of_a_crash_are_harmless() {
        let place = Place::local();
        let registry = place.registry();
        registry.store.put_blob(Digest::of(b"orphan"), b"orphan".to_vec()).unwrap();
        let versions = place.path("registry/models/approach/versions");
        fs::create_dir_all(&versions).unwrap();
        fs::write(versions.join("000001.json#1"), "half a mani").unwrap();
        assert!(registry.list().unwrap().is_empty());
        assert!(registry.verify(None).unwrap().problems.is_empty());
        assert_eq!(place.publish(&registry, "approach", b"weights").version, 1);
    }

    #[test]
    fn a_taken_number_that_is_no_version_is_passed_over() {
        let place = Place::local();
        let registry = place.registry();
        fs::create_dir_all(place.path("registry/models/approach/versions/000001.json")).unwrap();
        assert_eq!(place.publish(&registry, "approach", b"weights").version, 2);
    }

    #[test]
    fn what_json_cannot_hold_is_refused() {
        let place = Place::local();
        let registry = place.registry();
        let checkpoint = place.checkpoint("checkpoint", b"weights");
        let metrics = BTreeMap::from([("loss".into(), f64::NAN)]);
        let provenance = Provenance { metrics, ..Provenance::default() };
        let message = registry.publish(&model("approach"), &checkpoint, provenance).unwrap_err().to_string();
        assert!(message.contains("`loss` is NaN"), "{message}");
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
        assert!(matches!(result, Err(Error::Io { .. })), "{result:?}");
        assert!(place.path("registry").join(blob_key(Digest::of(b"abc"))).exists());
        fs::remove_file(obstacle).unwrap();
        assert!(registry.list().unwrap().is_empty());
        assert_eq!(publish(&registry, &checkpoint).version().version, 1);
    }

    #[test]
    fn what_could_not_be_read_back_is_not_written() {
        let place = Place::local();
        let mut manifest = place.publish(&place.registry(), "approach", b"weights").manifest;
        assert!(encode(&manifest, LAST_VERSION).is_ok());
        assert!(encode(&manifest, LAST_VERSION + 1).unwrap_err().contains("at most 999999 versions"));
        manifest.lineage.device = Some("x".repeat(DOCUMENT_LIMIT as usize));
        assert!(encode(&manifest, 1).unwrap_err().contains("more than 4194304"));
    }
}
