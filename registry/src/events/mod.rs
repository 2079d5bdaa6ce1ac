//! Append-only logs of events: what may change is kept as entries that never do.
//!
//! Each alias and each version has a log, a sequence of numbered pointers to events. Each event names the digest of the previous
//! one. The state is a fold over the events: the version that an alias names, whether a version is yanked, what is attached to
//! it. A log cannot tell that its last events were removed.

use crate::digest::Digest;
use crate::error::Result;
use crate::model::{AliasName, Event, EventKind, ModelName, ModelVersion, Note, Target};
use crate::problem::{Fault, Problem};
use crate::registry::Registry;
use crate::store::MODELS;
use crate::store::sequence::{encode, parse_number, pointer_key};

pub(crate) mod alias;
pub(crate) mod attachment;
pub(crate) mod yank;

/// Returns the folder of the logs of `name`.
pub(crate) fn events_key(name: &ModelName) -> String {
    format!("{MODELS}/{name}/events")
}

/// A log of events.
#[derive(Debug)]
pub(crate) struct Log {
    /// The alias (`approach:champion`) or version (`approach@3`).
    subject: String,
    /// Folder of the pointers.
    pub(crate) folder: String,
    /// Number of the version, for the log of a version.
    version: Option<u64>,
}

impl Log {
    /// Returns the log of an alias.
    pub(crate) fn of_alias(name: &ModelName, alias: &AliasName) -> Self {
        let (subject, folder) = (format!("{name}:{alias}"), format!("{}/{alias}", events_key(name)));
        Self { subject, folder, version: None }
    }

    /// Returns the log of version `number`.
    pub(crate) fn of_number(name: &ModelName, number: u64) -> Self {
        let (subject, folder) = (format!("{name}@{number}"), format!("{}/{number:06}", events_key(name)));
        Self { subject, folder, version: Some(number) }
    }

    /// Returns the log of a version.
    pub(crate) fn of_version(version: &ModelVersion) -> Self {
        Self::of_number(&version.name, version.version)
    }

    /// Returns the log in a folder of this name: a version's number or an alias.
    pub(crate) fn in_folder(name: &ModelName, folder: &str) -> Option<Self> {
        let of_alias = || Some(Self::of_alias(name, &folder.parse().ok()?));
        parse_number(folder).map(|number| Self::of_number(name, number)).or_else(of_alias)
    }

    /// Returns an event to be recorded.
    fn draft(&self, kind: EventKind, target: Option<Target>, note: &Note) -> Event {
        let (subject, note) = (self.subject.clone(), note.clone());
        Event { subject, number: 1, previous: None, digest: None, kind, target, attached: None, note }
    }

    /// Returns what a problem in this log affects. The files of a version are not affected.
    pub(crate) fn affected(&self) -> String {
        if self.version.is_some() { format!("{}/events", self.subject) } else { self.subject.clone() }
    }

    /// Attributes a fault to event `number`.
    pub(crate) fn problem(&self, number: u64, fault: Fault) -> Problem {
        fault.of(&self.affected(), &pointer_key(&self.folder, number))
    }

    /// Parses event `number`. The error describes what is wrong with it.
    pub(crate) fn parse(&self, bytes: &[u8], number: u64) -> std::result::Result<Event, String> {
        let event: Event = serde_json::from_slice(bytes).map_err(|error| error.to_string())?;
        if (event.subject.as_str(), event.number) != (&self.subject, number) {
            return Err(format!("it is event {} of `{}`", event.number, event.subject));
        }
        if event.previous.is_some() != (number > 1) {
            return Err("each event but the first names the digest of the previous one".into());
        }
        let expected = match event.kind {
            EventKind::AliasSet => (true, true, false),
            EventKind::AliasRemoved => (true, false, false),
            EventKind::Yanked | EventKind::Unyanked => (false, true, false),
            EventKind::Attached => (false, true, true),
        };
        if (self.version.is_none(), event.target.is_some(), event.attached.is_some()) != expected {
            return Err("it is of another subject than its kind, or has the fields of another kind".into());
        }
        match event.target {
            Some(target) if self.version.is_some_and(|version| version != target.version) => {
                Err(format!("it refers to version {}", target.version))
            }
            _ => Ok(event),
        }
    }
}

/// Describes what is wrong if `event` does not follow the one with digest `previous`.
pub(crate) fn broken_chain(event: &Event, previous: Option<Digest>) -> Option<Fault> {
    let name = |digest: Option<Digest>| digest.map_or("none".into(), |digest| digest.to_string());
    let (found, expected) = (name(event.previous), name(previous));
    let reason = || format!("the previous event has digest {expected}, this one names {found}");
    (event.previous != previous).then(|| Fault::Malformed { reason: reason() })
}

impl Registry {
    /// Reads event `number`. Fails with [`crate::Error::Damaged`] if it is not the one that was recorded.
    pub(crate) fn event(&self, log: &Log, number: u64) -> Result<Event> {
        let (bytes, digest) = self.store.follow(&log.affected(), &pointer_key(&log.folder, number))?;
        let event = log.parse(&bytes, number);
        let event = event.map_err(|reason| log.problem(number, Fault::Malformed { reason }))?;
        Ok(Event { digest: Some(digest), ..event })
    }

    /// Reads the last event.
    fn last_event(&self, log: &Log) -> Result<Option<Event>> {
        let last = self.store.numbers(&log.folder)?.last().copied();
        last.map(|number| self.event(log, number)).transpose()
    }

    /// Reads all events in order, and verifies their chain.
    fn history(&self, log: &Log) -> Result<Vec<Event>> {
        let mut events: Vec<Event> = Vec::new();
        for number in 1..=self.store.numbers(&log.folder)?.last().copied().unwrap_or(0) {
            let event = self.event(log, number)?;
            if let Some(fault) = broken_chain(&event, events.last().and_then(|last| last.digest)) {
                return Err(log.problem(number, fault).into());
            }
            events.push(event);
        }
        Ok(events)
    }

    /// Returns the events of a version in order.
    pub(crate) fn events(&self, version: &ModelVersion) -> Result<Vec<Event>> {
        let log = Log::of_version(version);
        let events = self.history(&log)?;
        match events.iter().find(|event| event.target != Some(version.target())) {
            Some(other) => {
                let reason = format!("it refers to another version than {}", version.digest);
                Err(log.problem(other.number, Fault::Malformed { reason }).into())
            }
            None => Ok(events),
        }
    }

    /// Appends `event` if it `is_due`, given the last event of an alias or all events of a version. Sets its number, its digest and
    /// the previous one. If another writer is first, `is_due` is asked again with its event.
    fn record(
        &self,
        log: &Log,
        mut event: Event,
        is_due: &dyn Fn(&[Event]) -> Result<bool>,
    ) -> Result<Option<Event>> {
        let mut known = if log.version.is_some() {
            self.history(log)?
        } else {
            self.last_event(log)?.into_iter().collect()
        };
        while is_due(&known)? {
            event.number = known.last().map_or(0, |last| last.number) + 1;
            event.previous = known.last().and_then(|last| last.digest);
            let digest = self.store.put_document(&log.subject, &encode(&log.subject, &event)?)?;
            if self.store.point(&log.folder, event.number, digest)? {
                return Ok(Some(Event { digest: Some(digest), ..event }));
            }
            known.push(self.event(log, event.number)?);
        }
        Ok(None)
    }
}

#[cfg(test)]
mod tests {
    use std::fs;

    use super::*;
    use crate::error::Error;
    use crate::events::alias::Precondition;
    use crate::fixture::{Place, flip, model};

    fn log() -> Log {
        Log::of_alias(&model("approach"), &"champion".parse().unwrap())
    }

    fn version(number: u64) -> ModelVersion {
        let place = Place::local();
        let version = place.publish(&place.registry(), "approach", &number.to_le_bytes());
        ModelVersion { version: number, ..version }
    }

    fn set(registry: &Registry, version: &ModelVersion, precondition: Precondition) -> Result<Option<Event>> {
        registry.set_alias(&"champion".parse().unwrap(), version, precondition, &Note::default())
    }

    fn current(registry: &Registry) -> Result<Option<u64>> {
        Ok(registry.last_event(&log())?.and_then(|event| event.target).map(|target| target.version))
    }

    #[test]
    fn the_last_event_is_in_force() {
        let (one, two) = (version(1), version(2));
        for place in Place::all() {
            let registry = place.registry();
            place.publish(&registry, "approach", b"weights");
            let end = || {
                registry.remove_alias(
                    &one.name,
                    &"champion".parse().unwrap(),
                    Precondition::Any,
                    &Note::default(),
                )
            };
            assert_eq!(current(&registry).unwrap(), None);
            assert!(end().unwrap_err().to_string().contains("no alias"));
            assert_eq!(set(&registry, &one, Precondition::Any).unwrap().unwrap().number, 1);
            assert_eq!(set(&registry, &one, Precondition::Any).unwrap(), None, "already in force");
            let note = Note { reason: Some("it won".into()), ..Note::default() };
            registry.set_alias(&"champion".parse().unwrap(), &two, Precondition::Version(1), &note).unwrap();
            assert_eq!(registry.last_event(&log()).unwrap().unwrap().note, note);
            assert_eq!(current(&registry).unwrap(), Some(2));
            end().unwrap();
            assert_eq!(current(&registry).unwrap(), None);
            let events = registry.history(&log()).unwrap();
            let targets: Vec<_> = events.iter().map(|event| (event.number, event.target)).collect();
            assert_eq!(targets, [(1, Some(one.target())), (2, Some(two.target())), (3, None)]);
        }
    }

    #[test]
    fn failed_preconditions_change_nothing() {
        let place = Place::local();
        let registry = place.registry();
        let (one, three) = (version(1), version(3));
        let unset = set(&registry, &one, Precondition::Version(1)).unwrap_err().to_string();
        assert!(unset.contains("approach:champion is unset"), "{unset}");
        set(&registry, &one, Precondition::Unset).unwrap().unwrap();
        for wrong in [Precondition::Unset, Precondition::Version(2)] {
            let error = set(&registry, &three, wrong).unwrap_err().to_string();
            assert!(error.contains("approach:champion is version 1"), "{error}");
        }
        assert_eq!(registry.history(&log()).unwrap().len(), 1);
    }

    /// Each event exists once, and of the writers that expect the same state only one succeeds.
    #[test]
    fn racing_writers_lose_nothing() {
        let template = version(1);
        for place in Place::all() {
            let registry = place.registry();
            let winners = std::sync::atomic::AtomicUsize::new(0);
            let version = |version| ModelVersion { version, ..template.clone() };
            std::thread::scope(|scope| {
                for thread in 0..8 {
                    let (registry, winners, version) = (&registry, &winners, &version);
                    scope.spawn(move || {
                        if set(registry, &version(100 + thread), Precondition::Unset).is_ok() {
                            winners.fetch_add(1, std::sync::atomic::Ordering::Relaxed);
                        }
                        for round in 0..4 {
                            let version = version(10 * thread + round + 1);
                            set(registry, &version, Precondition::Any).unwrap().unwrap();
                        }
                    });
                }
            });
            let events = registry.history(&log()).unwrap();
            let mut versions: Vec<_> = events.iter().map(|event| event.target.unwrap().version).collect();
            versions.sort_unstable();
            versions.dedup();
            assert_eq!((events.len(), versions.len()), (33, 33));
            assert_eq!(winners.into_inner(), 1);
        }
    }

    #[test]
    fn a_damaged_event_is_neither_trusted_nor_extended() {
        let (one, two) = (version(1), version(2));
        for damage_document in [false, true] {
            let place = Place::local();
            let registry = place.registry();
            set(&registry, &one, Precondition::Any).unwrap();
            set(&registry, &two, Precondition::Any).unwrap();
            let pointer = pointer_key(&log().folder, 2);
            let digest = registry.event(&log(), 2).unwrap().digest.unwrap();
            let key = if damage_document { crate::store::blob_key(digest) } else { pointer };
            flip(&place.path("registry"), &key);
            assert!(matches!(current(&registry), Err(Error::Damaged(_))));
            assert!(matches!(set(&registry, &one, Precondition::Any), Err(Error::Damaged(_))));
        }
    }

    #[test]
    fn misfiled_events_and_broken_chains_are_found() {
        let place = Place::local();
        let registry = place.registry();
        for number in 1..=3 {
            set(&registry, &version(number), Precondition::Any).unwrap();
        }
        let path = |number| place.path("registry").join(pointer_key(&log().folder, number));
        fs::copy(path(1), path(4)).unwrap();
        let misfiled = current(&registry).unwrap_err().to_string();
        assert!(misfiled.contains("event 1 of `approach:champion`"), "{misfiled}");
        fs::remove_file(path(4)).unwrap();

        // Another event 2, correctly stored: only the digest in event 3 reveals it.
        let mut other = registry.event(&log(), 2).unwrap();
        other.target = Some(version(7).target());
        fs::remove_file(path(2)).unwrap();
        let digest = registry.store.put_blob(encode(&other.subject, &other).unwrap()).unwrap();
        assert!(registry.store.point(&log().folder, 2, digest).unwrap());
        let broken = registry.history(&log()).unwrap_err().to_string();
        assert!(broken.contains("000003") && broken.contains("the previous event"), "{broken}");
    }
}
