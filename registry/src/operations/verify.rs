//! Verification: everything that a version needs exists and is what was published, and so are its events.

use std::collections::BTreeMap;

use serde::Serialize;

use crate::digest::{Digest, Fingerprint};
use crate::error::{Error, Result};
use crate::events::{Log, broken_chain};
use crate::model::{Descriptor, Event, ModelName, ModelRef};
use crate::problem::{Fault, Problem};
use crate::registry::{Registry, blob_problem, versions_key};
use crate::store::folder::is_staged;
use crate::store::sequence::{parse_number, pointer_key};
use crate::store::{MODELS, blob_key};

/// Result of a verification.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize)]
#[non_exhaustive]
pub struct Verification {
    /// Number of verified versions.
    pub versions: usize,
    /// Number of different blobs that were read: files, configurations and attachments.
    pub blobs: usize,
    /// Number of verified events.
    pub events: usize,
    /// What is wrong, by model, version and file. Empty if all is well.
    pub problems: Vec<Problem>,
}

impl Registry {
    /// Reads every byte of the version that `reference` names, its events and its attachments, or of the whole registry. Reports
    /// what is not as published. Versions and events are never removed, so a missing number below the newest is a problem.
    ///
    /// Blobs that nothing names are not a problem: an interrupted publication leaves them.
    pub fn verify(&self, reference: Option<&ModelRef>) -> Result<Verification> {
        let result = Verification::default();
        let mut verifier = Verifier { registry: self, stored: BTreeMap::new(), result };
        match reference {
            Some(reference) => {
                let (name, number) = (&reference.name, self.find(reference)?);
                let versions = [(number, verifier.version(name, number))].into();
                let log = Log::of_number(name, number);
                let events = self.store.numbers(&log.folder)?;
                verifier.log(&log, events.last().copied().unwrap_or(0), &versions);
            }
            None => verifier.everything()?,
        }
        verifier.result.blobs = verifier.stored.len();
        Ok(verifier.result)
    }
}

/// Returns the model, the folder of the log (empty for the versions) and the number of a pointer, or 0 for a folder of pointers.
/// Returns `None` if nothing belongs there.
fn place(key: &str, is_folder: bool) -> Option<(ModelName, &str, u64)> {
    let mut parts = key.split('/').skip(1);
    let name = parts.next()?.parse().ok()?;
    let log = match parts.next() {
        Some("versions") | None => "",
        Some("events") => parts.next().unwrap_or_default(),
        Some(_) => return None,
    };
    let number = match parts.next() {
        Some(number) if !is_folder => parse_number(number)?,
        None if is_folder => 0,
        _ => return None,
    };
    let is_known = log.is_empty() || Log::in_folder(&name, log).is_some();
    (is_known && parts.next().is_none()).then_some((name, log, number))
}

/// The versions of a model by number, with the digest of the manifest where it is intact.
type Versions = BTreeMap<u64, Option<Digest>>;

/// Describes what is wrong if `event` refers to none of `versions`.
fn wrong_target(event: &Event, versions: &Versions) -> Option<Fault> {
    let target = event.target?;
    let state = match versions.get(&target.version) {
        None => "does not exist".to_owned(),
        Some(Some(digest)) if *digest != target.digest => format!("has {digest}"),
        Some(_) => return None,
    };
    let reason =
        format!("it refers to version {} with digest {}, which {state}", target.version, target.digest);
    Some(Fault::Malformed { reason })
}

/// A verification in progress.
struct Verifier<'a> {
    registry: &'a Registry,
    /// Blobs that were read already: versions share blobs. The error is the reason why a blob cannot be read.
    stored: BTreeMap<Digest, std::result::Result<Option<Fingerprint>, String>>,
    result: Verification,
}

impl Verifier<'_> {
    fn everything(&mut self) -> Result<()> {
        let store = &self.registry.store;
        // In a folder, links are a problem wherever they are.
        let found = store.walk(if store.folder.is_some() { "" } else { MODELS })?;
        self.result.problems = found.problems;
        let folders = found.folders.into_iter().map(|key| (key, true));
        let objects = found.objects.into_iter().map(|object| (object.key, false));
        let below_models = |(key, _): &(String, bool)| key.starts_with("models/") && !is_staged(key);
        // The highest number of the versions and of each log.
        let mut models = BTreeMap::<_, BTreeMap<_, u64>>::new();
        for (key, is_folder) in folders.chain(objects).filter(below_models) {
            match place(&key, is_folder) {
                Some((name, log, number)) => {
                    let last = models.entry(name).or_default().entry(log.to_owned()).or_default();
                    *last = number.max(*last);
                }
                None => self.result.problems.push(Fault::Stray.of("", &key)),
            }
        }
        for (name, logs) in models {
            let newest = logs.get("").copied().unwrap_or(0);
            let versions = (1..=newest).map(|number| (number, self.version(&name, number))).collect();
            self.duplicates(&name, &versions);
            for (log, last) in logs {
                if let Some(log) = Log::in_folder(&name, &log) {
                    self.log(&log, last, &versions);
                }
            }
        }
        Ok(())
    }

    /// Reports versions with the same manifest: publishing never creates them.
    fn duplicates(&mut self, name: &ModelName, versions: &Versions) {
        let mut first = BTreeMap::new();
        for (&number, digest) in versions {
            let Some(digest) = digest else { continue };
            let earlier = *first.entry(digest).or_insert(number);
            if earlier != number {
                let reason = format!("it names the manifest of version {earlier}");
                let key = pointer_key(&versions_key(name), number);
                self.result.problems.push(Fault::Malformed { reason }.of(&format!("{name}@{number}"), &key));
            }
        }
    }

    /// Verifies a version and returns the digest of its manifest, if that is intact.
    fn version(&mut self, name: &ModelName, number: u64) -> Option<Digest> {
        self.result.versions += 1;
        let model = format!("{name}@{number}");
        match self.registry.load(name, number) {
            Ok(version) => {
                version.manifest.blobs().for_each(|blob| self.blob(&model, blob));
                Some(version.digest)
            }
            Err(error) => {
                let key = pointer_key(&versions_key(name), number);
                self.failed(error, &|fault| fault.of(&model, &key));
                None
            }
        }
    }

    /// Verifies that the `last` events of a log are what was recorded, follow each other, and refer to some of `versions`. Verifies the
    /// attached blobs.
    fn log(&mut self, log: &Log, last: u64, versions: &Versions) {
        // Digest of the previous event, unknown where that one is damaged.
        let mut previous = Some(None);
        for number in 1..=last {
            self.result.events += 1;
            match self.registry.event(log, number) {
                Ok(event) => {
                    if let Some(attached) = &event.attached {
                        self.blob(&log.affected(), attached);
                    }
                    let broken = previous.and_then(|previous| broken_chain(&event, previous));
                    let fault = broken.or_else(|| wrong_target(&event, versions));
                    self.result.problems.extend(fault.map(|fault| log.problem(number, fault)));
                    previous = Some(event.digest);
                }
                Err(error) => {
                    previous = None;
                    self.failed(error, &|fault| log.problem(number, fault));
                }
            }
        }
    }

    fn blob(&mut self, model: &str, blob: &Descriptor) {
        let inspect =
            || self.registry.store.inspect(&blob_key(blob.digest)).map_err(|error| error.to_string());
        let fault = match self.stored.entry(blob.digest).or_insert_with(inspect) {
            Ok(found) => Fault::of_blob(blob.content(), *found),
            Err(reason) => Some(Fault::Unreadable { reason: reason.clone() }),
        };
        self.result.problems.extend(fault.map(|fault| blob_problem(model, blob, fault)));
    }

    /// Records damage, or what could not be read, which `attribute` attributes to an object.
    fn failed(&mut self, error: Error, attribute: &dyn Fn(Fault) -> Problem) {
        self.result.problems.push(match error {
            Error::Damaged(problem) => *problem,
            error => attribute(Fault::Unreadable { reason: error.to_string() }),
        });
    }
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;
    use std::fs;
    use std::path::Path;

    use serde_json::{Value, json};

    use super::*;
    use crate::events::alias::Precondition;
    use crate::fixture::{Place, evaluation, flip, model, version_key};
    use crate::model::ModelVersion;
    use crate::model::Note;
    use crate::model::Provenance;
    use crate::store::blob_key;

    /// Publishes two versions of `approach` that share all files but the weights. Returns the second one.
    fn two_versions(place: &Place) -> (Registry, ModelVersion) {
        let registry = place.registry();
        place.publish(&registry, "approach", b"weights one");
        let second = place.publish(&registry, "approach", b"weights two");
        (registry, second)
    }

    fn weights(version: &ModelVersion) -> String {
        blob_key(version.manifest.layers[2].digest)
    }

    #[test]
    fn an_intact_registry_has_no_problems() {
        for place in Place::all() {
            let (registry, _) = two_versions(&place);
            // Two configurations and weights; config.toml and state/step.json are shared.
            let expected = Verification { versions: 2, blobs: 6, events: 0, problems: vec![] };
            assert_eq!(registry.verify(None).unwrap(), expected);
            let one = registry.verify(Some(&"approach@1".parse().unwrap())).unwrap();
            assert_eq!((one.versions, one.blobs, one.problems.len()), (1, 4, 0));
            assert!(registry.verify(Some(&"avoid".parse().unwrap())).is_err());
        }
    }

    #[test]
    fn damaged_blobs_are_found_and_named() {
        type Damage = fn(&Path, &str);
        type Expected = fn(&Fault) -> bool;
        let cases: [(Damage, Expected); 3] = [
            (flip, |fault| matches!(fault, Fault::Digest { .. })),
            (
                |root, key| {
                    fs::OpenOptions::new().write(true).open(root.join(key)).unwrap().set_len(7).unwrap();
                },
                |fault| matches!(fault, Fault::Size { expected: 11, found: 7 }),
            ),
            (|root, key| fs::remove_file(root.join(key)).unwrap(), |fault| matches!(fault, Fault::Missing)),
        ];
        for (damage, expected) in cases {
            let place = Place::local();
            let (registry, second) = two_versions(&place);
            damage(&place.path("registry"), &weights(&second));
            let problems = registry.verify(None).unwrap().problems;
            assert_eq!(problems.len(), 1, "{problems:?}");
            assert_eq!(problems[0].model.as_deref(), Some("approach@2"));
            assert_eq!(problems[0].file.as_deref(), Some("weights.bin"));
            assert!(expected(&problems[0].fault), "{}", problems[0]);
            assert!(registry.verify(Some(&"approach@1".parse().unwrap())).unwrap().problems.is_empty());
            let destination = place.path("pulled");
            assert!(registry.pull(&"approach@2".parse().unwrap(), &destination).is_err());
            assert!(!destination.exists());
        }
    }

    const WEIGHTS: [&[u8]; 2] = [b"one", b"two"];

    /// Pulls into a folder in `out`, which is empty before and afterwards.
    fn delivers_what_was_published_or_nothing(registry: &Registry, reference: &ModelRef, out: &Path) {
        match registry.pull(reference, &out.join("pulled")) {
            Ok(pulled) => {
                let delivered = fs::read(out.join("pulled/weights.bin")).unwrap();
                assert_eq!(delivered, WEIGHTS[pulled.value().version as usize - 1]);
                fs::remove_dir_all(out).unwrap();
            }
            Err(error) => {
                assert!(matches!(error, Error::Damaged(_)), "{error}");
                let left = fs::read_dir(out).map_or(0, Iterator::count);
                assert_eq!(left, 0, "{reference} left something behind");
            }
        }
    }

    /// Flips one bit of every byte of every object, about 3,500 in all: bit `position % 8`. Each time, `verify` names the object, or
    /// the registry cannot be opened, and no reference delivers anything but what was published.
    #[test]
    fn every_changed_byte_is_found_and_never_delivered() {
        let [_, place] = Place::all();
        let registry = place.registry();
        let published = WEIGHTS.map(|content| {
            let small = place.path("small");
            fs::create_dir_all(&small).unwrap();
            fs::write(small.join("weights.bin"), content).unwrap();
            registry.publish(&model("approach"), &small, Provenance::default()).unwrap().value().clone()
        });
        let references = ["approach@1", "approach", "approach:champion"]
            .map(|reference| reference.parse::<ModelRef>().unwrap());
        let (champion, none) = ("champion".parse().unwrap(), Note::default());
        for version in &published {
            registry.set_alias(&champion, version, Precondition::Any, &none).unwrap();
        }
        registry.yank(&published[1], &none).unwrap();
        registry.attach(&published[0], &evaluation("error_mm", 0.5), &none).unwrap();
        assert_eq!(registry.verify(None).unwrap().problems, []);
        let objects = registry.store.walk("").unwrap().objects;
        // The marker; pointers to 2 versions and 4 events; these 6 documents; 2 weights, 2 configurations, an evaluation.
        assert_eq!(objects.len(), 1 + 6 + 6 + 5);
        let mut changed = 0;
        for object in objects {
            let intact = registry.store.read(&object.key).unwrap().unwrap();
            for position in 0..intact.len() {
                let mut damaged = intact.clone();
                damaged[position] ^= 1 << (position % 8);
                registry.store.put(&object.key, damaged).unwrap();
                changed += 1;
                if object.key == "registry.json" {
                    assert!(Registry::on(registry.store.clone()).is_err(), "byte {position}");
                    continue;
                }
                let problems = registry.verify(None).unwrap().problems;
                let is_named = problems.iter().all(|problem| problem.object == object.key);
                assert!(is_named && !problems.is_empty(), "byte {position} of {}: {problems:?}", object.key);
                for reference in &references {
                    // `pull` starts with `show` and then reads only the version's files. If none of them is damaged, one pull
                    // for each object is enough.
                    let shown = registry.show(reference);
                    let is_read = |version: &ModelVersion| {
                        version.manifest.layers.iter().any(|layer| blob_key(layer.digest) == object.key)
                    };
                    if position == 0 || shown.as_ref().is_ok_and(is_read) {
                        delivers_what_was_published_or_nothing(&registry, reference, &place.path("out"));
                    }
                    match shown {
                        Ok(shown) => assert!(published.iter().any(|version| version.digest == shown.digest)),
                        Err(error) => assert!(matches!(error, Error::Damaged(_)), "{error}"),
                    }
                }
            }
            registry.store.put(&object.key, intact).unwrap();
        }
        assert!(changed > 3000, "{changed} bytes");
        eprintln!("{changed} bytes were changed");
    }

    /// Manifests that are stored correctly, but lie.
    #[test]
    fn lying_manifests_are_refused() {
        type Lie = fn(&mut Value);
        let cases: [(&str, Lie); 22] = [
            ("has 11 bytes, expected 0", |m| m["layers"][2]["size"] = 0.into()),
            ("has 11 bytes, expected 12", |m| m["layers"][2]["size"] = 12.into()),
            ("has 11 bytes, expected 18446744073709551615", |m| m["layers"][2]["size"] = u64::MAX.into()),
            ("invalid value: integer `-1`", |m| m["layers"][2]["size"] = (-1).into()),
            ("floating point", |m| m["layers"][2]["size"] = 11.5.into()),
            ("`sha256:../../x` is not a digest", |m| m["layers"][2]["digest"] = "sha256:../../x".into()),
            ("is missing", |m| m["layers"][2]["digest"] = Digest::of(b"nothing").to_string().into()),
            ("`../x` cannot be a file", |m| set_path(m, "../x")),
            ("`state/../../x` cannot be a file", |m| set_path(m, "state/../../x")),
            ("`/etc/x` cannot be a file", |m| set_path(m, "/etc/x")),
            ("`C:\\x` cannot be a file", |m| set_path(m, "C:\\x")),
            ("`..\\x` cannot be a file", |m| set_path(m, "..\\x")),
            ("`a\0b` cannot be a file", |m| set_path(m, "a\0b")),
            ("`a//b` cannot be a file", |m| set_path(m, "a//b")),
            ("`` cannot be a file", |m| set_path(m, "")),
            ("`NUL` cannot be a file on Windows", |m| set_path(m, "NUL")),
            ("`config.toml` occurs twice", |m| set_path(m, "config.toml")),
            ("`config.toml` is both a file and the folder", |m| set_path(m, "config.toml/x")),
            ("`` cannot be a file", |m| m["layers"][2]["annotations"] = json!({})),
            ("it names no files", |m| m["layers"] = json!([])),
            ("it names a version of `avoid`", |m| {
                m["annotations"]["org.opencontainers.image.title"] = "avoid".into();
            }),
            ("has 11 bytes, expected 12", |m| {
                m["layers"][2]["size"] = 12.into();
                let layer = m["layers"][2].clone();
                for number in 0..5000 {
                    let mut layer = layer.clone();
                    layer["annotations"]["org.cncf.model.filepath"] = format!("more/{number}").into();
                    m["layers"].as_array_mut().unwrap().push(layer);
                }
            }),
        ];
        let place = Place::local();
        let (registry, second) = two_versions(&place);
        for (reason, lie) in cases {
            let mut manifest = serde_json::to_value(&second.manifest).unwrap();
            lie(&mut manifest);
            refused(&place, &registry, manifest.to_string().as_bytes(), reason);
        }
    }

    fn set_path(manifest: &mut Value, path: &str) {
        manifest["layers"][2]["annotations"]["org.cncf.model.filepath"] = path.into();
    }

    /// Stores `manifest` as version 3 and asserts that it is found and not delivered. Then removes it.
    fn refused(place: &Place, registry: &Registry, manifest: &[u8], reason: &str) {
        let digest = registry.store.put_blob(manifest.to_vec()).unwrap();
        assert!(registry.store.create(&version_key(3), format!("{digest}\n").into_bytes()).unwrap());
        let around = || {
            let entries = fs::read_dir(place.path("")).unwrap();
            entries.map(|entry| entry.unwrap().file_name()).collect::<BTreeSet<_>>()
        };
        let before = around();
        let problems = registry.verify(None).unwrap().problems;
        assert!(
            problems.iter().all(|problem| problem.model.as_deref() == Some("approach@3")),
            "{problems:?}"
        );
        assert!(
            problems.first().is_some_and(|problem| problem.to_string().contains(reason)),
            "{reason}: {problems:?}"
        );
        let refusal = registry.pull(&"approach".parse().unwrap(), &place.path("pulled")).unwrap_err();
        assert!(matches!(refusal, Error::Damaged(_)) && refusal.to_string().contains(reason), "{refusal}");
        assert_eq!(around(), before);
        registry.store.delete(&version_key(3)).unwrap();
    }

    #[test]
    fn manifests_too_large_or_too_deep_are_refused() {
        let cases = [
            ("more than 4194304 bytes", vec![b' '; 5 << 20]),
            ("recursion limit", (r#"{"interface":{"x":"#.to_owned() + &"[".repeat(100_000)).into_bytes()),
            ("EOF while parsing", Vec::new()),
        ];
        for place in Place::all() {
            let (registry, _) = two_versions(&place);
            for (reason, manifest) in &cases {
                refused(&place, &registry, manifest, reason);
            }
        }
    }

    /// `pull` does not deliver the configuration. Only `verify` and an export that includes it read it.
    #[test]
    fn a_wrong_size_of_the_configuration_is_found() {
        let place = Place::local();
        let (registry, mut second) = two_versions(&place);
        second.manifest.config.size += 1;
        let manifest = second.manifest.to_bytes().unwrap();
        let digest = registry.store.put_blob(manifest).unwrap();
        assert!(registry.store.point(&versions_key(&second.name), 3, digest).unwrap());
        assert!(matches!(registry.verify(None).unwrap().problems[0].fault, Fault::Size { .. }));
        assert!(registry.export_oci(&"approach".parse().unwrap(), &place.path("layout")).is_err());
        assert!(!place.path("layout").exists());
    }

    /// Two versions with an alias and a yank that was taken back: four events.
    fn with_events(place: &Place) -> (Registry, ModelVersion) {
        let (registry, second) = two_versions(place);
        let first = registry.load(&second.name, 1).unwrap();
        let champion = "champion".parse().unwrap();
        for version in [&first, &second] {
            registry.set_alias(&champion, version, Precondition::Any, &Note::default()).unwrap();
        }
        registry.yank(&first, &Note::default()).unwrap();
        registry.unyank(&first, &Note::default()).unwrap();
        (registry, second)
    }

    #[test]
    fn gaps_strays_and_events_of_missing_versions_are_found() {
        let place = Place::local();
        let (registry, mut second) = with_events(&place);
        let events = place.path("registry/models/approach/events");
        fs::write(events.join("current"), "").unwrap();
        fs::create_dir_all(events.join("3")).unwrap();
        fs::write(events.join("champion/12"), "").unwrap();
        fs::remove_file(events.join("champion/000001")).unwrap();
        fs::create_dir_all(events.join("Upper")).unwrap();
        let mut found: Vec<_> =
            registry.verify(None).unwrap().problems.into_iter().map(|p| (p.object, p.fault)).collect();
        found.sort_by(|a, b| a.0.cmp(&b.0));
        let at = |key: &str| format!("models/approach/events/{key}");
        let expected = [
            (at("3"), Fault::Stray),
            (at("Upper"), Fault::Stray),
            (at("champion/000001"), Fault::Missing),
            (at("champion/12"), Fault::Stray),
            (at("current"), Fault::Stray),
        ];
        assert_eq!(found, expected);

        // A version that does not exist, and one that has another digest.
        let place = Place::local();
        let (registry, _) = with_events(&place);
        second.digest = Digest::of(b"another");
        registry.set_alias(&"other".parse().unwrap(), &second, Precondition::Any, &Note::default()).unwrap();
        second.version = 9;
        registry.set_alias(&"gone".parse().unwrap(), &second, Precondition::Any, &Note::default()).unwrap();
        registry.yank(&second, &Note::default()).unwrap();
        let told: Vec<_> = registry.verify(None).unwrap().problems.iter().map(ToString::to_string).collect();
        assert_eq!(told.len(), 3, "{told:?}");
        assert!(told[0].starts_with("approach@9/events: "), "{told:?}");
        assert!(told[1].starts_with("approach:gone: ") && told[1].contains("version 9"), "{told:?}");
        assert!(told[2].starts_with("approach:other: ") && told[2].contains("digest"), "{told:?}");
    }

    #[test]
    fn strays_gaps_and_misfiled_versions_are_found() {
        let place = Place::local();
        let (registry, _) = two_versions(&place);
        let versions = place.path("registry/models/approach/versions");
        fs::copy(versions.join("000001"), versions.join("000004")).unwrap();
        fs::write(versions.join("latest"), "1").unwrap();
        fs::write(place.path("registry/models/notes.txt"), "").unwrap();
        fs::create_dir(place.path("registry/models/My Models")).unwrap();
        let found: Vec<_> =
            registry.verify(None).unwrap().problems.into_iter().map(|p| (p.object, p.fault)).collect();
        assert_eq!(found.len(), 5, "{found:?}");
        assert!(found[0].0.starts_with("models/My"));
        assert_eq!(found[1], ("models/notes.txt".into(), Fault::Stray));
        assert_eq!(found[2], ("models/approach/versions/latest".into(), Fault::Stray));
        assert_eq!(found[3], (version_key(3), Fault::Missing));
        assert_eq!(found[4].0, version_key(4));
        assert!(
            matches!(&found[4].1, Fault::Malformed { reason } if reason.contains("version 1")),
            "{found:?}"
        );
    }
}
