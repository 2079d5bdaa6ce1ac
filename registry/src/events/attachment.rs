//! Attachments: statements about a version that are made after its publication. OCI calls them referrers.
//!
//! An attachment is a blob, named by an event of the version. It is never removed. Of several evaluations, the last one counts.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};
use serde_json::Value;

use super::Log;
use crate::error::{Error, Result};
use crate::model::{Descriptor, Event, EventKind, ModelVersion, Note};
use crate::outcome::Outcome;
use crate::problem::Fault;
use crate::registry::Registry;
use crate::signature::{self, PublicKey, Signature, SignedFiles};
use crate::store::sequence::encode;

/// Media type of an evaluation.
const EVALUATION: &str = "application/vnd.flowservo.evaluation.v1+json";

/// Metrics of a version and the configuration of their measurement: a JSON document that is attached to the version.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct Evaluation {
    /// Name, ending in its unit, and finite value.
    pub metrics: BTreeMap<String, f64>,
    /// Configuration of the measurement, in the evaluator's words: enough to repeat it.
    pub configuration: BTreeMap<String, Value>,
}

/// One metric of a version.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
#[non_exhaustive]
pub struct Metric {
    /// The value.
    pub value: f64,
    /// Number of the event that attached the evaluation. `None` if the value is from the version's own manifest.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub attachment: Option<u64>,
}

/// Refuses values that JSON cannot represent.
pub(crate) fn check_finite(metrics: &BTreeMap<String, f64>) -> Result<()> {
    match metrics.iter().find(|(_, value)| !value.is_finite()) {
        Some((name, value)) => Err(Error::refused(
            &format!("metric `{name}`"),
            format!("it is {value}; only finite numbers can be published"),
        )),
        None => Ok(()),
    }
}

/// What can be attached to a version.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub enum Attachment {
    /// A signature of its files.
    Signature(Signature),
    /// An evaluation.
    Evaluation(Evaluation),
}

impl Attachment {
    /// Returns the media type and the bytes. Refuses an attachment that does not belong to `version`.
    fn encode(&self, version: &ModelVersion) -> Result<(&'static str, Vec<u8>)> {
        match self {
            Self::Signature(signature) => {
                SignedFiles::of_version(version).compare(&signature.payload()?)?;
                Ok((signature::MEDIA_TYPE, signature.as_str().into()))
            }
            Self::Evaluation(evaluation) if evaluation.metrics.is_empty() => {
                Err(Error::refused(version, "the evaluation has no metrics"))
            }
            Self::Evaluation(evaluation) => {
                check_finite(&evaluation.metrics)?;
                Ok((EVALUATION, encode(version, evaluation)?))
            }
        }
    }

    /// Parses an attachment. Returns `None` for an unknown media type.
    fn parse(media_type: &str, bytes: &[u8]) -> std::result::Result<Option<Self>, String> {
        Ok(match media_type {
            signature::MEDIA_TYPE => {
                Some(Self::Signature(Signature::parse(bytes).map_err(|error| error.to_string())?))
            }
            EVALUATION => {
                Some(Self::Evaluation(serde_json::from_slice(bytes).map_err(|error| error.to_string())?))
            }
            _ => None,
        })
    }
}

impl Registry {
    /// Attaches something to `version`, a version of this registry. Returns the event that attaches it.
    ///
    /// Several processes may attach at once. Each content is attached once.
    pub fn attach(
        &self,
        version: &ModelVersion,
        attachment: &Attachment,
        note: &Note,
    ) -> Result<Outcome<Event>> {
        let (media_type, bytes) = attachment.encode(version)?;
        self.attach_bytes(version, &Descriptor::document(media_type, &bytes), &bytes, note)
    }

    /// Attaches `bytes`, which `attached` describes.
    pub(crate) fn attach_bytes(
        &self,
        version: &ModelVersion,
        attached: &Descriptor,
        bytes: &[u8],
        note: &Note,
    ) -> Result<Outcome<Event>> {
        // A damaged blob is repaired, even if it is attached already.
        self.store.put_document(version, bytes)?;
        let log = Log::of_version(version);
        let is_same = |event: &Event| event.attached.as_ref() == Some(attached);
        if let Some(event) = self.history(&log)?.into_iter().find(is_same) {
            return Ok(Outcome::AlreadyThere(event));
        }
        let draft = log.draft(EventKind::Attached, Some(version.target()), note);
        let event = Event { attached: Some(attached.clone()), ..draft };
        let recorded = self.record(&log, event, &|events| Ok(!events.iter().any(is_same)))?;
        // If nothing was recorded, another process was faster.
        recorded.map_or_else(
            || self.attach_bytes(version, attached, bytes, note),
            |event| Ok(Outcome::New(event)),
        )
    }

    /// Returns the events that attach something to `version`, in order. [`Registry::attachment`] reads what they attach.
    pub fn attachments(&self, version: &ModelVersion) -> Result<Vec<Event>> {
        Ok(self.events(version)?.into_iter().filter(|event| event.attached.is_some()).collect())
    }

    /// Reads what `event`, one of the [`attachments`](Self::attachments) of `version`, attaches, and verifies it. Returns `None`
    /// for a kind of attachment that this program does not know.
    pub fn attachment(&self, version: &ModelVersion, event: &Event) -> Result<Option<Attachment>> {
        let Some(attached) = &event.attached else { return Ok(None) };
        let log = Log::of_version(version);
        let bytes = self.store.document(&log.affected(), attached.digest)?;
        let malformed = |reason| log.problem(event.number, Fault::Malformed { reason }).into();
        Attachment::parse(&attached.media_type, &bytes).map_err(malformed)
    }

    /// Returns the metrics of `version`: those of its manifest, overridden by the last attached evaluation.
    pub fn metrics(&self, version: &ModelVersion) -> Result<BTreeMap<String, Metric>> {
        let metric = |attachment| move |(name, value)| (name, Metric { value, attachment });
        let mut metrics: BTreeMap<_, _> =
            version.manifest.metrics.clone().into_iter().map(metric(None)).collect();
        let events = self.attachments(version)?;
        if let Some(newest) = of_type(&events, EVALUATION).next_back()
            && let Some(Attachment::Evaluation(evaluation)) = self.attachment(version, newest)?
        {
            metrics.extend(evaluation.metrics.into_iter().map(metric(Some(newest.number))));
        }
        Ok(metrics)
    }

    /// Returns the values of [`metrics`](Self::metrics).
    pub(crate) fn values(&self, version: &ModelVersion) -> Result<BTreeMap<String, f64>> {
        Ok(self.metrics(version)?.into_iter().map(|(name, metric)| (name, metric.value)).collect())
    }

    /// Returns the event that attaches a valid signature of `version` with the owner's `key`. Fails with [`Error::NotFound`] if
    /// there is none.
    pub fn signature_by(&self, version: &ModelVersion, key: &PublicKey) -> Result<Event> {
        let files = SignedFiles::of_version(version);
        let mut found = Vec::new();
        for event in of_type(&self.attachments(version)?, signature::MEDIA_TYPE) {
            let verified = match self.attachment(version, event) {
                Ok(Some(Attachment::Signature(signature))) => files.verify(&signature, key),
                Ok(_) => continue,
                Err(error) => Err(error),
            };
            match verified {
                Ok(()) => return Ok(event.clone()),
                // A problem with one signature does not affect the others.
                Err(error) => found.push(format!("attachment {}: {error}", event.number)),
            }
        }
        let reason = match found.len() {
            0 => "no signature is attached; `model sign` attaches one".to_owned(),
            count => format!("none of {count} signatures is valid; {}", found.join("; ")),
        };
        Err(Error::NotFound(format!("{version} is not signed with this key: {reason}")))
    }
}

/// Returns the events that attach something of this media type.
fn of_type<'a>(events: &'a [Event], media_type: &str) -> impl DoubleEndedIterator<Item = &'a Event> {
    let is_of_type = move |attached: &Descriptor| attached.media_type == media_type;
    events.iter().filter(move |event| event.attached.as_ref().is_some_and(is_of_type))
}

#[cfg(test)]
mod tests {
    use std::collections::{BTreeMap, BTreeSet};
    use std::fs;

    use super::*;
    use crate::digest::Digest;
    use crate::events::alias::Precondition;
    use crate::fixture::{Place, evaluation, flip, key, model};
    use crate::model::{Provenance, Target};
    use crate::store::DOCUMENT_LIMIT;
    use crate::store::blob_key;
    use crate::store::sequence::pointer_key;

    const LOG: &str = "models/approach/events/000001";

    /// A registry with a version that has a signature and two evaluations.
    fn with_attachments(place: &Place) -> (Registry, ModelVersion) {
        let registry = place.registry();
        let version = place.publish(&registry, "approach", b"weights");
        let signature = SignedFiles::of_version(&version).sign(&key(1)).unwrap();
        for attachment in
            [evaluation("error_mm", 0.5), Attachment::Signature(signature), evaluation("error_mm", 0.25)]
        {
            let attached = registry.attach(&version, &attachment, &Note::default()).unwrap();
            assert!(matches!(attached, Outcome::New(_)));
        }
        (registry, version)
    }

    fn attach(registry: &Registry, version: &ModelVersion, value: f64) -> Outcome<Event> {
        registry.attach(version, &evaluation("error_mm", value), &Note::default()).unwrap()
    }

    #[test]
    fn attachments_read_back_and_are_attached_once() {
        for place in Place::all() {
            let (registry, version) = with_attachments(&place);
            let events = registry.attachments(&version).unwrap();
            assert_eq!(events.iter().map(|event| event.number).collect::<Vec<_>>(), [1, 2, 3]);
            let content = registry.attachment(&version, &events[0]).unwrap();
            assert_eq!(content, Some(evaluation("error_mm", 0.5)));
            let signature = registry.attachment(&version, &events[1]).unwrap().unwrap();
            assert!(matches!(&signature, Attachment::Signature(s) if s.key_hint().unwrap().len() == 64));
            for (again, number) in [(evaluation("error_mm", 0.5), 1), (signature, 2)] {
                let again = registry.attach(&version, &again, &Note::default()).unwrap();
                assert!(matches!(again, Outcome::AlreadyThere(event) if event.number == number));
            }
            assert_eq!(registry.attachments(&version).unwrap().len(), 3);

            // Attachments belong to a version, not to a model.
            let second = place.publish(&registry, "approach", b"others");
            assert!(registry.attachments(&second).unwrap().is_empty());
            assert!(matches!(attach(&registry, &second, 0.5), Outcome::New(_)));
        }
    }

    /// The format on disk, on the raw JSON.
    #[test]
    fn events_have_their_format() {
        let place = Place::local();
        let (registry, version) = with_attachments(&place);
        let read = |key: &str| fs::read_to_string(place.path("registry").join(key)).unwrap();
        let event = |pointer: &str| read(&blob_key(read(pointer).trim_end().parse().unwrap()));
        let entry: serde_json::Value = serde_json::from_str(&event(&format!("{LOG}/000001"))).unwrap();
        assert_eq!((&entry["subject"], &entry["event"]), (&"approach@1".into(), &"attached".into()));
        assert_eq!(entry["target"]["digest"], version.digest.to_string());
        assert_eq!(entry["attached"]["mediaType"], "application/vnd.flowservo.evaluation.v1+json");
        let digest: Digest = entry["attached"]["digest"].as_str().unwrap().parse().unwrap();
        let blob: serde_json::Value = serde_json::from_str(&read(&blob_key(digest))).unwrap();
        assert_eq!(blob["metrics"]["error_mm"], 0.5);
        registry.set_alias(&"best".parse().unwrap(), &version, Precondition::Any, &Note::default()).unwrap();
        let expected = format!(
            "{{\n  \"subject\": \"approach:best\",\n  \"number\": 1,\n  \"event\": \"alias_set\",\n  \"target\": {{\n    \"version\": 1,\n    \
             \"digest\": \"{}\"\n  }}\n}}\n",
            version.digest
        );
        assert_eq!(event("models/approach/events/best/000001"), expected);
    }

    /// Different contents are all attached, each once.
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
                        let note = Note { who: Some(thread.to_string()), ..Note::default() };
                        for value in [-1.0, f64::from(thread), -2.0] {
                            let evaluation = evaluation("error_mm", value);
                            let attached = registry.attach(version, &evaluation, &note).unwrap();
                            if matches!(attached, Outcome::New(_)) {
                                new.fetch_add(1, std::sync::atomic::Ordering::Relaxed);
                            }
                        }
                    });
                }
            });
            let events = registry.attachments(version).unwrap();
            let contents: BTreeSet<_> = events.iter().map(|e| e.attached.as_ref().unwrap().digest).collect();
            assert_eq!((events.len(), contents.len(), new.into_inner()), (10, 10, 10));
            assert!(registry.verify(None).unwrap().problems.is_empty());
        }
    }

    #[test]
    fn empty_and_foreign_attachments_are_refused() {
        let place = Place::local();
        let registry = place.registry();
        let version = place.publish(&registry, "approach", b"weights");
        let refusal = |attachment: &Attachment| {
            registry.attach(&version, attachment, &Note::default()).unwrap_err().to_string()
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
    fn damage_is_found_in_pointer_event_and_blob() {
        let place = Place::local();
        let (registry, version) = with_attachments(&place);
        let found = registry.verify(None).unwrap();
        // Three files, the configuration, and three attached blobs.
        assert_eq!((found.events, found.blobs, found.problems.len()), (3, 7, 0), "{found:?}");
        let root = place.path("registry");
        for logged in registry.attachments(&version).unwrap() {
            let pointer = pointer_key(LOG, logged.number);
            let event = blob_key(registry.store.follow("", &pointer).unwrap().1);
            let blob = blob_key(logged.attached.as_ref().unwrap().digest);
            for object in [&pointer, &event, &blob] {
                let intact = fs::read(root.join(object)).unwrap();
                for position in (0..intact.len()).step_by(17) {
                    let mut damaged = intact.clone();
                    damaged[position] ^= 1 << (position % 8);
                    fs::write(root.join(object), damaged).unwrap();
                    for reference in [None, Some("approach@1".parse().unwrap())] {
                        let problems = registry.verify(reference.as_ref()).unwrap().problems;
                        assert_eq!(problems.len(), 1, "{problems:?}");
                        assert_eq!(problems[0].object, *object);
                        assert_eq!(problems[0].model.as_deref(), Some("approach@1/events"));
                    }
                    let read =
                        registry.attachments(&version).and_then(|_| registry.attachment(&version, &logged));
                    assert!(matches!(read, Err(Error::Damaged(_))), "{object}");
                }
                fs::write(root.join(object), &intact).unwrap();
            }
        }
        assert!(registry.verify(None).unwrap().problems.is_empty());
    }

    #[test]
    fn strays_gaps_and_events_of_other_versions_are_found() {
        let place = Place::local();
        let (registry, version) = with_attachments(&place);
        let root = place.path("registry");
        fs::write(root.join("models/approach/events/notes"), "").unwrap();
        fs::create_dir(root.join("models/approach/events/1")).unwrap();
        fs::write(root.join(format!("{LOG}/1")), "").unwrap();
        fs::remove_file(root.join(format!("{LOG}/000002"))).unwrap();
        let mut found: Vec<_> =
            registry.verify(None).unwrap().problems.into_iter().map(|p| (p.object, p.fault)).collect();
        found.sort_by(|a, b| a.0.cmp(&b.0));
        let stray = |key: &str| (format!("models/approach/events/{key}"), Fault::Stray);
        let gap = (format!("{LOG}/000002"), Fault::Missing);
        assert_eq!(found, [gap, stray("000001/1"), stray("1"), stray("notes")]);

        // An event that names another manifest, and one of a version that does not exist.
        let place = Place::local();
        let (registry, mut other) = with_attachments(&place);
        other.digest = version.manifest.config.digest;
        attach(&registry, &other, 7.0);
        let problems = registry.verify(None).unwrap().problems;
        assert!(problems.len() == 1 && problems[0].to_string().contains("which has"), "{problems:?}");
        let version = registry.load(&other.name, 1).unwrap();
        assert!(registry.attachments(&version).unwrap_err().to_string().contains("another version"));
        other.version = 9;
        attach(&registry, &other, 7.0);
        assert!(registry.verify(None).unwrap().problems[1].to_string().contains("version 9"));
    }

    /// An event of another kind, and one of another version, correctly stored.
    #[test]
    fn events_in_the_wrong_log_are_refused() {
        let place = Place::local();
        let (registry, version) = with_attachments(&place);
        let (events, log) = (registry.events(&version).unwrap(), Log::of_version(&version));
        let previous = registry.event(&log, 3).unwrap().digest;
        let other = Target { version: 2, ..version.target() };
        for (kind, target) in [(EventKind::AliasRemoved, None), (EventKind::Yanked, Some(other))] {
            let wrong = Event { number: 4, previous, kind, target, attached: None, ..events[0].clone() };
            let bytes = encode(&wrong.subject, &wrong).unwrap();
            let digest = registry.store.put_blob(bytes).unwrap();
            assert!(registry.store.point(&log.folder, 4, digest).unwrap());
            let refusal = registry.attachments(&version).unwrap_err().to_string();
            assert!(refusal.contains("events/000001/000004"), "{refusal}");
            assert_eq!(registry.verify(None).unwrap().problems.len(), 1);
            registry.store.delete(&pointer_key(&log.folder, 4)).unwrap();
        }
    }

    /// Attaching the same content again repairs it.
    #[test]
    fn a_damaged_blob_is_repaired() {
        let place = Place::local();
        let (registry, version) = with_attachments(&place);
        let entry = registry.attachments(&version).unwrap().remove(0);
        flip(&place.path("registry"), &blob_key(entry.attached.as_ref().unwrap().digest));
        assert_eq!(registry.verify(None).unwrap().problems.len(), 1);
        assert!(matches!(attach(&registry, &version, 0.5), Outcome::AlreadyThere(_)));
        assert!(registry.verify(None).unwrap().problems.is_empty());
    }

    /// An attachment of a later program is listed and verified, but not understood.
    #[test]
    fn unknown_kinds_are_tolerated() {
        let place = Place::local();
        let (registry, version) = with_attachments(&place);
        let attached = Descriptor::document("application/spdx+json", b"sbom");
        registry.attach_bytes(&version, &attached, b"sbom", &Note::default()).unwrap();
        assert!(registry.verify(None).unwrap().problems.is_empty());
        let events = registry.attachments(&version).unwrap();
        assert_eq!(registry.attachment(&version, &events[3]).unwrap(), None);
        assert_eq!(registry.metrics(&version).unwrap()["error_mm"].attachment, Some(3));
    }

    #[test]
    fn the_last_evaluation_overrides_the_manifest() {
        for place in Place::all() {
            let registry = place.registry();
            let metrics = BTreeMap::from([("loss".to_owned(), 0.5), ("error_mm".to_owned(), 4.0)]);
            let provenance = Provenance { metrics, ..Provenance::default() };
            let checkpoint = place.checkpoint("run", b"weights");
            let published = registry.publish(&model("approach"), &checkpoint, provenance).unwrap();
            let version = published.value();
            let values = || {
                let metrics = registry.metrics(version).unwrap();
                metrics.into_iter().map(|(name, m)| (name, m.value, m.attachment)).collect::<Vec<_>>()
            };
            let manifest = ("loss".to_owned(), 0.5, None);
            assert_eq!(values(), [("error_mm".to_owned(), 4.0, None), manifest.clone()]);
            for (number, value) in [(1, 3.0), (2, 2.0)] {
                registry.attach(version, &evaluation("error_mm", value), &Note::default()).unwrap();
                assert_eq!(values(), [("error_mm".to_owned(), value, Some(number)), manifest.clone()]);
            }
            // Metrics of an older evaluation are omitted: it was another measurement.
            registry.attach(version, &evaluation("skill", 0.75), &Note::default()).unwrap();
            let expected =
                [("error_mm".to_owned(), 4.0, None), manifest, ("skill".to_owned(), 0.75, Some(3))];
            assert_eq!(values(), expected);
        }
    }

    #[test]
    fn card_and_difference_include_it() {
        let place = Place::local();
        let registry = place.registry();
        let version = place.publish(&registry, "approach", b"one");
        place.publish(&registry, "approach", b"two");
        registry.attach(&version, &evaluation("error_mm", 2.5), &Note::default()).unwrap();
        let (one, two) = ("approach@1".parse().unwrap(), "approach@2".parse().unwrap());
        let compared = registry.diff(&one, &two).unwrap().metrics;
        assert_eq!(
            (compared[0].metric.as_str(), compared[0].from, compared[0].to),
            ("error_mm", Some(2.5), None)
        );
        registry.export_huggingface(&one, &place.path("hub"), None).unwrap();
        let card = fs::read_to_string(place.path("hub/README.md")).unwrap();
        assert!(card.contains("type: error_mm") && card.contains("| `error_mm` | 2.5 |"), "{card}");
    }

    /// A damaged evaluation is reported, and the version is still delivered: its files are intact.
    #[test]
    fn a_damaged_evaluation_does_not_block_the_files() {
        let place = Place::local();
        let registry = place.registry();
        let version = place.publish(&registry, "approach", b"one");
        let attached = registry.attach(&version, &evaluation("x", 1.0), &Note::default()).unwrap();
        let digest = attached.value().attached.as_ref().unwrap().digest;
        flip(&place.path("registry"), &blob_key(digest));
        assert!(matches!(registry.metrics(&version), Err(Error::Damaged(_))));
        registry.pull(&"approach".parse().unwrap(), &place.path("pulled")).unwrap();
    }
}
