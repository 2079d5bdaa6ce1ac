//! Verification: everything that a version needs is there and is what was published, and so is what was said about it.

use std::collections::BTreeMap;

use serde::Serialize;

use crate::alias::{AliasName, alias_log, aliases_key};
use crate::attachment::{attachment_log, attachments_key};
use crate::digest::{Digest, Fingerprint};
use crate::error::{Error, Result};
use crate::log::{Entry, Log, broken_chain, entry_number};
use crate::manifest::Descriptor;
use crate::name::ModelName;
use crate::problem::{Fault, Problem};
use crate::reference::ModelRef;
use crate::registry::{Registry, folder_number, version_number};
use crate::store::{Listing, MODELS, blob_key, version_key, versions_key};
use crate::yank::{yank_log, yanks_key};

/// What verification found.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize)]
#[non_exhaustive]
pub struct Verification {
    /// How many versions were verified.
    pub versions: usize,
    /// How many different blobs of theirs were read.
    pub blobs: usize,
    /// How many entries about aliases, yanked versions and attachments were verified.
    pub entries: usize,
    /// What is wrong, by model, version and file; empty if all is well.
    pub problems: Vec<Problem>,
}

impl Registry {
    /// Reads every byte of the version that `reference` names and of what is attached to it, or of all versions, their
    /// attachments, aliases and yanks, and says what is not as published. A number that is missing below the newest is a
    /// problem too: versions and entries are never removed.
    ///
    /// Blobs that no version names are no problem: an interrupted publication leaves them.
    pub fn verify(&self, reference: Option<&ModelRef>) -> Result<Verification> {
        let mut run = Run { registry: self, stored: BTreeMap::new(), result: Verification::default() };
        match reference {
            Some(reference) => {
                let (name, number) = (&reference.name, self.find(reference)?);
                let own = [(number, run.version(name, number))].into();
                run.log(&attachment_log(name, number), &own)?;
            }
            None => run.everything()?,
        }
        run.result.blobs = run.stored.len();
        Ok(run.result)
    }
}

/// The versions of a model by number, with the digest of their manifest where it is intact.
type Versions = BTreeMap<u64, Option<Digest>>;

/// What is wrong with `entry` if it means none of `versions`.
fn misled(entry: &Entry, versions: &Versions) -> Option<Fault> {
    let target = entry.target?;
    let reason = match versions.get(&target.version) {
        None => format!("it means version {}, which it cannot", target.version),
        Some(Some(digest)) if *digest != target.digest => {
            format!("it means version {} with digest {}, which has {digest}", target.version, target.digest)
        }
        Some(_) => return None,
    };
    Some(Fault::Malformed { reason })
}

/// A verification in progress.
struct Run<'a> {
    registry: &'a Registry,
    /// What the blobs hold that were read already: versions share blobs. The error is the reason why one cannot be read.
    stored: BTreeMap<Digest, std::result::Result<Option<Fingerprint>, String>>,
    result: Verification,
}

impl Run<'_> {
    fn everything(&mut self) -> Result<()> {
        let models = self.list(MODELS)?;
        for object in models.objects {
            self.stray(format!("{MODELS}/{object}"));
        }
        for folder in models.folders {
            match folder.parse::<ModelName>() {
                Ok(name) => self.model(&name)?,
                Err(_) => self.stray(format!("{MODELS}/{folder}")),
            }
        }
        // Those that were met on the way are known.
        let mut links = self.registry.store.not_plain("")?;
        links.retain(|link| !self.result.problems.contains(link));
        self.result.problems.extend(links);
        Ok(())
    }

    /// What lies in the folder `key`; nothing if a link leads there, which is a problem. The links in it are found at the end.
    fn list(&mut self, key: &str) -> Result<Listing> {
        match self.registry.store.list_with_problems(key) {
            Ok((listing, _)) => Ok(listing),
            Err(Error::Damaged(problem)) => {
                self.result.problems.push(*problem);
                Ok(Listing::default())
            }
            Err(error) => Err(error),
        }
    }

    fn model(&mut self, name: &ModelName) -> Result<()> {
        let objects = self.list(&versions_key(name))?.objects;
        for object in objects.iter().filter(|object| version_number(object).is_none()) {
            self.stray(format!("{}/{object}", versions_key(name)));
        }
        let newest = objects.iter().filter_map(|object| version_number(object)).max().unwrap_or(0);
        let versions = (1..=newest).map(|number| (number, self.version(name, number))).collect();
        self.aliases(name, &versions)?;
        self.of_versions(&yanks_key(name), &|number| yank_log(name, number), &versions)?;
        self.of_versions(&attachments_key(name), &|number| attachment_log(name, number), &versions)
    }

    fn aliases(&mut self, name: &ModelName, versions: &Versions) -> Result<()> {
        for folder in self.folders(&aliases_key(name))? {
            match folder.parse::<AliasName>() {
                Ok(alias) => self.log(&alias_log(name, &alias), versions)?,
                Err(_) => self.stray(format!("{}/{folder}", aliases_key(name))),
            }
        }
        Ok(())
    }

    /// Verifies the logs in the folder `key`, each of which is about one version.
    fn of_versions(&mut self, key: &str, log: &dyn Fn(u64) -> Log, versions: &Versions) -> Result<()> {
        for folder in self.folders(key)? {
            match folder_number(&folder) {
                Some(number) => {
                    // The only version that these entries can mean.
                    let own = versions.range(number..=number).map(|(&n, &digest)| (n, digest)).collect();
                    self.log(&log(number), &own)?;
                }
                None => self.stray(format!("{key}/{folder}")),
            }
        }
        Ok(())
    }

    /// The folders in `key`, in which nothing else has a place.
    fn folders(&mut self, key: &str) -> Result<Vec<String>> {
        let listing = self.list(key)?;
        for object in listing.objects {
            self.stray(format!("{key}/{object}"));
        }
        Ok(listing.folders)
    }

    /// Verifies all entries of a log: that they are what was written, follow each other, and mean some of `versions`; and the
    /// blobs that they attach.
    fn log(&mut self, log: &Log, versions: &Versions) -> Result<()> {
        let objects = self.list(&log.folder)?.objects;
        for object in objects.iter().filter(|object| entry_number(object).is_none()) {
            self.stray(format!("{}/{object}", log.folder));
        }
        let last = objects.iter().filter_map(|object| entry_number(object)).max().unwrap_or(0);
        // Digest of the entry before; unknown where that one is damaged.
        let mut previous = Some(None);
        for number in 1..=last {
            self.result.entries += 1;
            let fault = match self.registry.entry(log, number) {
                Ok((entry, digest)) => {
                    if let Some(attached) = &entry.attached {
                        self.blob(&log.subject, attached);
                    }
                    let broken = previous.and_then(|previous| broken_chain(&entry, previous));
                    previous = Some(Some(digest));
                    broken.or_else(|| misled(&entry, versions))
                }
                Err(error) => {
                    previous = None;
                    if let Error::Damaged(problem) = error {
                        self.result.problems.push(*problem);
                        continue;
                    }
                    Some(Fault::Unreadable { reason: error.to_string() })
                }
            };
            self.result.problems.extend(fault.map(|fault| log.problem(number, fault)));
        }
        Ok(())
    }

    /// Verifies a version and returns the digest of its manifest, if that is intact.
    fn version(&mut self, name: &ModelName, number: u64) -> Option<Digest> {
        self.result.versions += 1;
        match self.registry.load(name, number) {
            Ok(version) => {
                self.blob(&version.to_string(), &version.manifest.config);
                for layer in &version.manifest.layers {
                    self.blob(&version.to_string(), layer);
                }
                return Some(version.digest);
            }
            Err(Error::Damaged(problem)) => self.result.problems.push(*problem),
            Err(error) => {
                let (model, object) = (Some(format!("{name}@{number}")), version_key(name, number));
                let fault = Fault::Unreadable { reason: error.to_string() };
                self.result.problems.push(Problem { model, file: None, object, fault });
            }
        }
        None
    }

    fn blob(&mut self, model: &str, descriptor: &Descriptor) {
        let digest = descriptor.digest;
        let stored = self
            .stored
            .entry(digest)
            .or_insert_with(|| self.registry.store.inspect_blob(digest).map_err(|error| error.to_string()));
        let fault = match stored {
            Ok(found) => Fault::of_blob(descriptor.content(), *found),
            Err(reason) => Some(Fault::Unreadable { reason: reason.clone() }),
        };
        if let Some(fault) = fault {
            let (model, file) = (Some(model.to_owned()), descriptor.path().map(str::to_owned));
            self.result.problems.push(Problem { model, file, object: blob_key(digest), fault });
        }
    }

    fn stray(&mut self, object: String) {
        self.result.problems.push(Problem { model: None, file: None, object, fault: Fault::Stray });
    }
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;
    use std::fs;
    use std::path::Path;

    use serde_json::{Value, json};

    use super::*;
    use crate::fixture::{Place, evaluation, flip};
    use crate::log::{Expect, Remark};
    use crate::manifest::Provenance;
    use crate::registry::ModelVersion;

    /// A registry with two versions of `approach` that share all blobs but the weights, the second one returned.
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
            let expected = Verification { versions: 2, blobs: 6, entries: 0, problems: vec![] };
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

    /// Pulls into a folder of `out`, which is empty before and afterwards.
    fn delivers_what_was_published_or_nothing(registry: &Registry, reference: &ModelRef, out: &Path) {
        match registry.pull(reference, &out.join("pulled")) {
            Ok(pulled) => {
                let delivered = fs::read(out.join("pulled/weights.bin")).unwrap();
                assert_eq!(delivered, WEIGHTS[pulled.version().version as usize - 1]);
                fs::remove_dir_all(out).unwrap();
            }
            Err(error) => {
                assert!(matches!(error, Error::Damaged(_)), "{error}");
                let left = fs::read_dir(out).map_or(0, Iterator::count);
                assert_eq!(left, 0, "{reference} left something behind");
            }
        }
    }

    /// Every bit of every object, one at a time: `verify` names the object, or the registry is not opened, and no reference
    /// gives anything but what was published.
    #[test]
    fn every_flipped_bit_is_found_and_never_delivered() {
        let [_, place] = Place::all();
        let registry = place.registry();
        let published = WEIGHTS.map(|content| {
            let (name, small) = ("approach".parse().unwrap(), place.path("small"));
            fs::create_dir_all(&small).unwrap();
            fs::write(small.join("weights.bin"), content).unwrap();
            registry.publish(&name, &small, Provenance::default()).unwrap().version().clone()
        });
        let references = ["approach@1", "approach@2", "approach", "approach:champion"]
            .map(|reference| reference.parse::<ModelRef>().unwrap());
        let (champion, none) = ("champion".parse().unwrap(), Remark::default());
        for version in &published {
            registry.set_alias(&champion, version, Expect::Anything, &none).unwrap();
        }
        registry.yank(&published[1], &none).unwrap();
        registry.attach(&published[0], &evaluation("error_mm", 0.5), &none).unwrap();
        assert_eq!(registry.verify(None).unwrap().problems, []);
        for object in registry.store.walk("").unwrap() {
            let intact = registry.store.read(&object.key).unwrap().unwrap();
            for bit in 0..8 * intact.len() {
                let mut damaged = intact.clone();
                damaged[bit / 8] ^= 1 << (bit % 8);
                registry.store.put(&object.key, damaged).unwrap();
                if object.key == "registry.json" {
                    assert!(Registry::on(registry.store.clone()).is_err(), "bit {bit}");
                    continue;
                }
                let problems = registry.verify(None).unwrap().problems;
                let named = problems.iter().all(|problem| problem.object == object.key);
                assert!(named && !problems.is_empty(), "bit {bit} of {}: {problems:?}", object.key);
                // `pull` begins with what `show` gives and reads nothing but its files: where none of them is damaged, one pull
                // for each object is enough.
                for reference in &references {
                    let shown = registry.show(reference);
                    let is_read = |version: &ModelVersion| {
                        version.manifest.layers.iter().any(|layer| blob_key(layer.digest) == object.key)
                    };
                    if bit == 0 || shown.as_ref().map_or(true, is_read) {
                        delivers_what_was_published_or_nothing(&registry, reference, &place.path("out"));
                    } else {
                        assert!(
                            published.iter().any(|version| version.digest == shown.as_ref().unwrap().digest)
                        );
                    }
                }
            }
            registry.store.put(&object.key, intact).unwrap();
        }
    }

    /// What a manifest may say that is stored correctly, with its copy, but lies.
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
            ("`config.toml` is named twice", |m| set_path(m, "config.toml")),
            ("`config.toml` is a file and the folder", |m| set_path(m, "config.toml/x")),
            ("`` cannot be a file", |m| m["layers"][2]["annotations"] = json!({})),
            ("it names no files", |m| m["layers"] = json!([])),
            ("is `avoid`, expected `approach`", |m| {
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
        for (told, lie) in cases {
            let mut manifest = serde_json::to_value(&second.manifest).unwrap();
            manifest["annotations"]["org.opencontainers.image.version"] = "3".into();
            lie(&mut manifest);
            refused(&place, &registry, manifest.to_string().into_bytes(), told);
        }
    }

    fn set_path(manifest: &mut Value, path: &str) {
        manifest["layers"][2]["annotations"]["org.cncf.model.filepath"] = path.into();
    }

    /// Puts `manifest` at version 3, which is found wrong and not delivered, and takes it away again.
    fn refused(place: &Place, registry: &Registry, manifest: Vec<u8>, told: &str) {
        let name = "approach".parse().unwrap();
        registry.store.put_blob(Digest::of(&manifest), manifest.clone()).unwrap();
        registry.store.create(&version_key(&name, 3), manifest).unwrap();
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
            problems.first().is_some_and(|problem| problem.to_string().contains(told)),
            "{told}: {problems:?}"
        );
        let refusal = registry.pull(&"approach".parse().unwrap(), &place.path("pulled")).unwrap_err();
        assert!(matches!(refusal, Error::Damaged(_)) && refusal.to_string().contains(told), "{refusal}");
        assert_eq!(around(), before);
        registry.store.remove(&version_key(&name, 3)).unwrap();
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
            for (told, manifest) in &cases {
                refused(&place, &registry, manifest.clone(), told);
            }
        }
    }

    /// Nothing of the configuration is delivered: only `verify` and an export that holds it look at it.
    #[test]
    fn a_wrong_size_of_the_configuration_is_found() {
        let place = Place::local();
        let (registry, mut second) = two_versions(&place);
        second.manifest.set_version(3);
        second.manifest.config.size += 1;
        let manifest = second.manifest.to_bytes().unwrap();
        registry.store.put_blob(Digest::of(&manifest), manifest.clone()).unwrap();
        registry.store.create(&version_key(&second.name, 3), manifest).unwrap();
        assert!(matches!(registry.verify(None).unwrap().problems[0].fault, Fault::Size { .. }));
        assert!(registry.export_oci(&"approach".parse().unwrap(), &place.path("layout")).is_err());
        assert!(!place.path("layout").exists());
    }

    /// Two versions with an alias and a yanked one, four entries in all.
    fn with_entries(place: &Place) -> (Registry, ModelVersion) {
        let (registry, second) = two_versions(place);
        let first = registry.load(&second.name, 1).unwrap();
        let champion = "champion".parse().unwrap();
        for version in [&first, &second] {
            registry.set_alias(&champion, version, Expect::Anything, &Remark::default()).unwrap();
        }
        registry.yank(&first, &Remark::default()).unwrap();
        registry.unyank(&first, &Remark::default()).unwrap();
        (registry, second)
    }

    const ALIAS: &str = "models/approach/aliases/champion";
    #[test]
    fn holes_strays_and_entries_that_mean_nothing_are_found() {
        let place = Place::local();
        let (registry, mut second) = with_entries(&place);
        let root = place.path("registry");
        fs::write(root.join("models/approach/aliases/current"), "").unwrap();
        fs::create_dir_all(root.join("models/approach/aliases/3")).unwrap();
        fs::write(root.join(format!("{ALIAS}/12.json")), "").unwrap();
        fs::remove_file(root.join(format!("{ALIAS}/000000001.json"))).unwrap();
        fs::create_dir_all(root.join("models/approach/yanks/7")).unwrap();
        let found: Vec<_> =
            registry.verify(None).unwrap().problems.into_iter().map(|p| (p.object, p.fault)).collect();
        let stray = |key: &str| (format!("models/approach/{key}"), Fault::Stray);
        let expected = [
            stray("aliases/current"),
            stray("aliases/3"),
            stray("aliases/champion/12.json"),
            (format!("{ALIAS}/000000001.json"), Fault::Missing),
            stray("yanks/7"),
        ];
        assert_eq!(found, expected);

        // A version that is not there, and one that has another digest.
        let place = Place::local();
        let (registry, _) = with_entries(&place);
        second.digest = Digest::of(b"another");
        registry.set_alias(&"other".parse().unwrap(), &second, Expect::Anything, &Remark::default()).unwrap();
        second.version = 9;
        registry.set_alias(&"gone".parse().unwrap(), &second, Expect::Anything, &Remark::default()).unwrap();
        registry.yank(&second, &Remark::default()).unwrap();
        let told: Vec<_> = registry.verify(None).unwrap().problems.iter().map(ToString::to_string).collect();
        assert_eq!(told.len(), 3, "{told:?}");
        assert!(told[0].starts_with("approach:gone: ") && told[0].contains("version 9"), "{told:?}");
        assert!(told[1].starts_with("approach:other: ") && told[1].contains("digest"), "{told:?}");
        assert!(told[2].starts_with("approach@9: "), "{told:?}");
    }

    #[test]
    fn strays_gaps_and_misfiled_manifests_are_found() {
        let place = Place::local();
        let (registry, _) = two_versions(&place);
        let versions = place.path("registry/models/approach/versions");
        fs::copy(versions.join("000001.json"), versions.join("000004.json")).unwrap();
        fs::write(versions.join("latest.json"), "1").unwrap();
        fs::write(place.path("registry/models/notes.txt"), "").unwrap();
        fs::create_dir(place.path("registry/models/My Models")).unwrap();
        let found: Vec<_> =
            registry.verify(None).unwrap().problems.into_iter().map(|p| (p.object, p.fault)).collect();
        let manifest = |number| version_key(&"approach".parse().unwrap(), number);
        assert_eq!(found.len(), 5);
        assert_eq!(found[0], ("models/notes.txt".into(), Fault::Stray));
        assert!(found[1].0.starts_with("models/My"));
        assert_eq!(
            found[2],
            (format!("{}/latest.json", versions_key(&"approach".parse().unwrap())), Fault::Stray)
        );
        assert_eq!(found[3], (manifest(3), Fault::Missing));
        assert!(
            matches!(&found[4].1, Fault::Malformed { reason } if reason.contains("version")),
            "{found:?}"
        );
    }
}
