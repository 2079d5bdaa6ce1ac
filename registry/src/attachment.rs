//! Attachments: what is said of a version after it was published, and which it therefore cannot hold: signatures, evaluations.
//! OCI calls such things referrers.
//!
//! Each version has a numbered log of them, `models/<name>/attachments/000003/000000001.json`: an entry names the version with its
//! manifest's digest, and a blob. What was attached stays; of evaluations the last one counts.

use crate::error::{Error, Result};
use crate::evaluation::Evaluation;
use crate::log::{Entry, Log, Remark};
use crate::manifest::Descriptor;
use crate::name::ModelName;
use crate::problem::Fault;
use crate::registry::{ModelVersion, Registry};
use crate::signature::{Signature, SignedFiles};
use crate::store::{DOCUMENT_LIMIT, MODELS};

/// Media type of a signature.
pub(crate) const SIGNATURE: &str = "application/vnd.dev.sigstore.bundle.v0.3+json";
/// Media type of an evaluation.
pub(crate) const EVALUATION: &str = "application/vnd.flowservo.evaluation.v1+json";

/// What can be attached to a version.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub enum Attachment {
    /// Who vouches for it.
    Signature(Signature),
    /// How good it is.
    Evaluation(Evaluation),
}

/// What attaching did.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Attached {
    /// An entry was created.
    New(Entry),
    /// This entry attached the same content before: none was created.
    AlreadyThere(Entry),
}

impl Attached {
    /// The entry that attaches the content now.
    pub fn entry(&self) -> &Entry {
        match self {
            Self::New(entry) | Self::AlreadyThere(entry) => entry,
        }
    }
}

impl Attachment {
    fn media_type(&self) -> &'static str {
        match self {
            Self::Signature(_) => SIGNATURE,
            Self::Evaluation(_) => EVALUATION,
        }
    }

    /// The bytes that are stored, if they may be attached to `version`.
    fn to_bytes(&self, version: &ModelVersion) -> Result<Vec<u8>> {
        let refuse = |reason| Error::Attachment { model: version.to_string(), reason };
        let bytes = match self {
            Self::Signature(signature) => {
                SignedFiles::of_version(version).are_named_by(signature)?;
                signature.as_str().as_bytes().to_owned()
            }
            Self::Evaluation(evaluation) => {
                evaluation.check(version)?;
                let text =
                    serde_json::to_string_pretty(evaluation).map_err(|error| refuse(error.to_string()))?;
                format!("{text}\n").into_bytes()
            }
        };
        if bytes.len() as u64 > DOCUMENT_LIMIT {
            return Err(refuse(format!("it has {} bytes, more than {DOCUMENT_LIMIT}", bytes.len())));
        }
        Ok(bytes)
    }

    /// Reads what is stored; none if it is of a kind that this program does not know.
    fn parse(media_type: &str, bytes: &[u8]) -> std::result::Result<Option<Self>, String> {
        match media_type {
            SIGNATURE => {
                Signature::parse(bytes).map(|found| Some(Self::Signature(found))).map_err(|e| e.to_string())
            }
            EVALUATION => serde_json::from_slice(bytes)
                .map(|found| Some(Self::Evaluation(found)))
                .map_err(|error| error.to_string()),
            _ => Ok(None),
        }
    }
}

/// Folder of the attachments of the versions of `name`.
pub(crate) fn attachments_key(name: &ModelName) -> String {
    format!("{MODELS}/{name}/attachments")
}

/// The log of what is attached to version `number` of `name`.
pub(crate) fn attachment_log(name: &ModelName, number: u64) -> Log {
    let folder = format!("{}/{number:06}", attachments_key(name));
    Log { subject: format!("{name}@{number}/attachments"), folder, attaches: true }
}

/// Those of `entries` that attach something of this media type.
pub(crate) fn of_kind<'a>(
    entries: &'a [Entry],
    media_type: &'static str,
) -> impl DoubleEndedIterator<Item = &'a Entry> {
    let is_of = move |attached: &Descriptor| attached.media_type == media_type;
    entries.iter().filter(move |entry| entry.attached.as_ref().is_some_and(is_of))
}

impl Registry {
    /// Attaches something to `version`, a version of this registry, unless that was done before.
    ///
    /// Several processes may attach at once: each gets its own entry, and of those with the same content one does.
    pub fn attach(
        &self,
        version: &ModelVersion,
        attachment: &Attachment,
        remark: &Remark,
    ) -> Result<Attached> {
        let bytes = attachment.to_bytes(version)?;
        let content = Descriptor::document(attachment.media_type(), &bytes);
        self.store.put_blob(content.digest, bytes)?;
        let log = attachment_log(&version.name, version.version);
        let mut entries = self.chain(&log)?;
        loop {
            let same = entries.iter().find(|(entry, _)| entry.attached.as_ref() == Some(&content));
            if let Some((entry, _)) = same {
                return Ok(Attached::AlreadyThere(entry.clone()));
            }
            let (target, attached) = (Some(version.target()), Some(content.clone()));
            let entry = Entry { target, attached, ..log.after(entries.last(), remark) };
            if self.create_entry(&log, &entry)? {
                return Ok(Attached::New(entry));
            }
            // Another writer was first: see whether it attached the same, then try the next number.
            entries.push(self.entry(&log, entry.number)?);
        }
    }

    /// The entries that attach something to `version`, from the first, with their chain verified. What they attach is not read:
    /// [`Registry::attachment`] does.
    pub fn attachments(&self, version: &ModelVersion) -> Result<Vec<Entry>> {
        let log = attachment_log(&version.name, version.version);
        let entries = self.history(&log)?;
        match entries.iter().find(|entry| entry.target != Some(version.target())) {
            Some(other) => {
                let reason = format!("it means another version than {}", version.digest);
                Err(log.problem(other.number, Fault::Malformed { reason }).into())
            }
            None => Ok(entries),
        }
    }

    /// What `entry`, one of the [`attachments`](Self::attachments) of `version`, attaches, verified; none if it is of a kind that
    /// this program does not know.
    pub fn attachment(&self, version: &ModelVersion, entry: &Entry) -> Result<Option<Attachment>> {
        let Some(attached) = &entry.attached else { return Ok(None) };
        let log = attachment_log(&version.name, version.version);
        let bytes = self.document(&log.subject, attached)?;
        let malformed = |reason| log.problem(entry.number, Fault::Malformed { reason }).into();
        Attachment::parse(&attached.media_type, &bytes).map_err(malformed)
    }
}

#[cfg(test)]
mod tests {
    use std::collections::{BTreeMap, BTreeSet};
    use std::fs;

    use super::*;
    use crate::digest::Digest;
    use crate::fixture::{Place, evaluation, flip, key, model};
    use crate::log::Expect;
    use crate::store::blob_key;

    const LOG: &str = "models/approach/attachments/000001";

    /// A registry with a version that has a signature and two evaluations.
    fn with_attachments(place: &Place) -> (Registry, ModelVersion) {
        let registry = place.registry();
        let version = place.publish(&registry, "approach", b"weights");
        let signature = SignedFiles::of_version(&version).sign(&key(1)).unwrap();
        for attachment in
            [evaluation("error_mm", 0.5), Attachment::Signature(signature), evaluation("error_mm", 0.25)]
        {
            let attached = registry.attach(&version, &attachment, &Remark::default()).unwrap();
            assert!(matches!(attached, Attached::New(_)));
        }
        (registry, version)
    }

    fn attach(registry: &Registry, version: &ModelVersion, value: f64) -> Attached {
        registry.attach(version, &evaluation("error_mm", value), &Remark::default()).unwrap()
    }

    #[test]
    fn what_is_attached_comes_back_and_is_attached_once() {
        for place in Place::all() {
            let (registry, version) = with_attachments(&place);
            let entries = registry.attachments(&version).unwrap();
            assert_eq!(entries.iter().map(|entry| entry.number).collect::<Vec<_>>(), [1, 2, 3]);
            let content = registry.attachment(&version, &entries[0]).unwrap();
            assert_eq!(content, Some(evaluation("error_mm", 0.5)));
            let signature = registry.attachment(&version, &entries[1]).unwrap().unwrap();
            assert!(matches!(&signature, Attachment::Signature(s) if s.key_hint().unwrap().len() == 64));
            for (again, number) in [(evaluation("error_mm", 0.5), 1), (signature, 2)] {
                let again = registry.attach(&version, &again, &Remark::default()).unwrap();
                assert!(matches!(again, Attached::AlreadyThere(entry) if entry.number == number));
            }
            assert_eq!(registry.attachments(&version).unwrap().len(), 3);

            // To the version, not to the model.
            let second = place.publish(&registry, "approach", b"others");
            assert!(registry.attachments(&second).unwrap().is_empty());
            assert!(matches!(attach(&registry, &second, 0.5), Attached::New(_)));
        }
    }

    /// The form on disk, on the raw JSON; aliases and yanks stay as they were.
    #[test]
    fn entries_have_their_form() {
        let place = Place::local();
        let (registry, version) = with_attachments(&place);
        let read = |key: &str| fs::read_to_string(place.path("registry").join(key)).unwrap();
        let entry: serde_json::Value = serde_json::from_str(&read(&format!("{LOG}/000000001.json"))).unwrap();
        assert_eq!(entry["subject"], "approach@1/attachments");
        assert_eq!(entry["target"]["digest"], version.digest.to_string());
        assert_eq!(entry["attached"]["mediaType"], "application/vnd.flowservo.evaluation.v1+json");
        let digest: Digest = entry["attached"]["digest"].as_str().unwrap().parse().unwrap();
        let blob: serde_json::Value = serde_json::from_str(&read(&blob_key(digest))).unwrap();
        assert_eq!(blob["metrics"]["error_mm"], 0.5);
        registry.set_alias(&"best".parse().unwrap(), &version, Expect::Anything, &Remark::default()).unwrap();
        let expected = format!(
            "{{\n  \"subject\": \"approach:best\",\n  \"number\": 1,\n  \"target\": {{\n    \"version\": 1,\n    \
             \"digest\": \"{}\"\n  }}\n}}\n",
            version.digest
        );
        assert_eq!(read("models/approach/aliases/best/000000001.json"), expected);
    }

    /// Different contents all get in; of one and the same content one entry is made.
    #[test]
    fn racing_writers_lose_nothing_and_make_nothing_twice() {
        for place in Place::all() {
            let registry = place.registry();
            let version = place.publish(&registry, "approach", b"weights");
            let (registry, version) = (&registry, &version);
            let new = std::sync::atomic::AtomicUsize::new(0);
            std::thread::scope(|scope| {
                for thread in 0..8 {
                    let new = &new;
                    scope.spawn(move || {
                        let remark = Remark { who: Some(thread.to_string()), ..Remark::default() };
                        for value in [-1.0, f64::from(thread), -2.0] {
                            let evaluation = evaluation("error_mm", value);
                            let attached = registry.attach(version, &evaluation, &remark).unwrap();
                            if matches!(attached, Attached::New(_)) {
                                new.fetch_add(1, std::sync::atomic::Ordering::Relaxed);
                            }
                        }
                    });
                }
            });
            let entries = registry.attachments(version).unwrap();
            let contents: BTreeSet<_> = entries.iter().map(|e| e.attached.as_ref().unwrap().digest).collect();
            assert_eq!((entries.len(), contents.len(), new.into_inner()), (10, 10, 10));
            assert!(registry.verify(None).unwrap().problems.is_empty());
        }
    }

    #[test]
    fn what_says_nothing_or_something_else_is_refused() {
        let place = Place::local();
        let registry = place.registry();
        let version = place.publish(&registry, "approach", b"weights");
        let refusal = |attachment: &Attachment| {
            registry.attach(&version, attachment, &Remark::default()).unwrap_err().to_string()
        };
        for value in [f64::NAN, f64::INFINITY] {
            assert!(refusal(&evaluation("x", value)).contains("only finite numbers"));
        }
        assert!(refusal(&Attachment::Evaluation(Evaluation::default())).contains("no metrics"));
        let text = "x".repeat(usize::try_from(DOCUMENT_LIMIT).unwrap());
        let large = Evaluation {
            configuration: BTreeMap::from([("text".to_owned(), text.into())]),
            metrics: BTreeMap::from([("x".to_owned(), 0.0)]),
        };
        assert!(refusal(&Attachment::Evaluation(large)).contains("more than 4194304"));
        let other = place.publish(&registry, "approach", b"others");
        let foreign = SignedFiles::of_version(&other).sign(&key(1)).unwrap();
        assert!(refusal(&Attachment::Signature(foreign)).contains("weights.bin"));
        assert!(registry.attachments(&version).unwrap().is_empty());
    }

    #[test]
    fn every_flipped_bit_is_found_in_entry_copy_and_blob() {
        let place = Place::local();
        let (registry, version) = with_attachments(&place);
        let found = registry.verify(None).unwrap();
        // Three files, the configuration, and three attached blobs.
        assert_eq!((found.entries, found.blobs, found.problems.len()), (3, 7, 0), "{found:?}");
        let root = place.path("registry");
        for entry in registry.attachments(&version).unwrap() {
            let key = format!("{LOG}/{:09}.json", entry.number);
            let copy = blob_key(Digest::of(&fs::read(root.join(&key)).unwrap()));
            let blob = blob_key(entry.attached.as_ref().unwrap().digest);
            for object in [&key, &copy, &blob] {
                let intact = fs::read(root.join(object)).unwrap();
                for position in (0..intact.len()).step_by(31) {
                    let mut damaged = intact.clone();
                    damaged[position] ^= 1 << (position % 8);
                    fs::write(root.join(object), damaged).unwrap();
                    for reference in [None, Some("approach@1".parse().unwrap())] {
                        let problems = registry.verify(reference.as_ref()).unwrap().problems;
                        assert_eq!(problems.len(), 1, "{problems:?}");
                        assert_eq!(problems[0].object, *object);
                        assert_eq!(problems[0].model.as_deref(), Some("approach@1/attachments"));
                    }
                    let read =
                        registry.attachments(&version).and_then(|_| registry.attachment(&version, &entry));
                    assert!(matches!(read, Err(Error::Damaged(_))), "{object}");
                }
                fs::write(root.join(object), &intact).unwrap();
            }
        }
        assert!(registry.verify(None).unwrap().problems.is_empty());
    }

    #[test]
    fn strays_holes_and_entries_of_other_versions_are_found() {
        let place = Place::local();
        let (registry, version) = with_attachments(&place);
        let root = place.path("registry");
        fs::write(root.join("models/approach/attachments/notes"), "").unwrap();
        fs::create_dir(root.join("models/approach/attachments/1")).unwrap();
        fs::write(root.join(format!("{LOG}/1.json")), "").unwrap();
        fs::remove_file(root.join(format!("{LOG}/000000002.json"))).unwrap();
        let found: Vec<_> =
            registry.verify(None).unwrap().problems.into_iter().map(|p| (p.object, p.fault)).collect();
        let stray = |key: &str| (format!("models/approach/attachments/{key}"), Fault::Stray);
        let hole = (format!("{LOG}/000000002.json"), Fault::Missing);
        assert_eq!(found, [stray("notes"), stray("000001/1.json"), hole, stray("1")]);

        // Of another version, and of none.
        let place = Place::local();
        let (registry, mut other) = with_attachments(&place);
        other.digest = version.manifest.config.digest;
        attach(&registry, &other, 7.0);
        let told = registry.verify(None).unwrap().problems;
        assert!(told.len() == 1 && told[0].to_string().contains("which has"), "{told:?}");
        let version = registry.load(&other.name, 1).unwrap();
        assert!(registry.attachments(&version).unwrap_err().to_string().contains("another version"));
        other.version = 9;
        attach(&registry, &other, 7.0);
        assert!(registry.verify(None).unwrap().problems[1].to_string().contains("version 9"));
    }

    /// An entry about something else that is put into the log, with all digests right.
    #[test]
    fn what_attaches_nothing_is_no_attachment() {
        let place = Place::local();
        let (registry, version) = with_attachments(&place);
        let log = attachment_log(&version.name, 1);
        let chain = registry.chain(&log).unwrap();
        let nothing = Entry { target: Some(version.target()), ..log.after(chain.last(), &Remark::default()) };
        assert!(registry.create_entry(&log, &nothing).unwrap());
        let refusal = registry.attachments(&version).unwrap_err().to_string();
        assert!(refusal.contains("000000004.json") && refusal.contains("attached"), "{refusal}");
    }

    /// Content that was damaged is mended where it is attached again.
    #[test]
    fn a_damaged_blob_is_mended() {
        let place = Place::local();
        let (registry, version) = with_attachments(&place);
        let entry = registry.attachments(&version).unwrap().remove(0);
        flip(&place.path("registry"), &blob_key(entry.attached.unwrap().digest));
        assert_eq!(registry.verify(None).unwrap().problems.len(), 1);
        assert!(matches!(attach(&registry, &version, 0.5), Attached::AlreadyThere(_)));
        assert!(registry.verify(None).unwrap().problems.is_empty());
    }

    /// Of a later program: listed, verified, and not understood.
    #[test]
    fn unknown_kinds_are_no_obstacle() {
        let place = Place::local();
        let (registry, version) = with_attachments(&place);
        let log = attachment_log(&model("approach"), 1);
        let chain = registry.chain(&log).unwrap();
        registry.store.put_blob(Digest::of(b"sbom"), b"sbom".to_vec()).unwrap();
        let (target, attached) =
            (Some(version.target()), Some(Descriptor::document("application/spdx+json", b"sbom")));
        let entry = Entry { target, attached, ..log.after(chain.last(), &Remark::default()) };
        registry.create_entry(&log, &entry).unwrap();
        assert!(registry.verify(None).unwrap().problems.is_empty());
        let entries = registry.attachments(&version).unwrap();
        assert_eq!(registry.attachment(&version, &entries[3]).unwrap(), None);
        assert_eq!(registry.metrics(&version).unwrap()["error_mm"].attachment, Some(3));
    }
}
