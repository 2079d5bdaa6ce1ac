//! Numbered logs: what may change, kept as entries that never do.
//!
//! The highest number is what holds now. Each entry is created once under the next number, so that of two writers at once one
//! has to begin again from what the other wrote. It names the digest of the entry before, and stands among the blobs, byte for
//! byte, as a manifest does. What no log can tell is that its last entries were taken away, with their copies.

use serde::{Deserialize, Serialize};

use crate::digest::Digest;
use crate::error::{Error, Result};
use crate::manifest::Descriptor;
use crate::problem::{Fault, Problem};
use crate::registry::{ModelVersion, Registry};

/// The highest number of an entry: numbers have nine digits, so that names sort as numbers do.
const LAST_ENTRY: u64 = 999_999_999;

/// Bytes of the largest entry.
const ENTRY_LIMIT: usize = 1 << 16;

/// One entry of a log.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[non_exhaustive]
pub struct Entry {
    /// What the log is about: an alias, `approach:champion`, the yanking of a version, `approach@3`, or what is attached to it,
    /// `approach@3/attachments`.
    pub subject: String,
    /// Number of the entry, from 1.
    pub number: u64,
    /// Digest of the entry before; none for the first.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub previous: Option<Digest>,
    /// The version that the alias means from here on, that is yanked, or to which something is attached; none if it ends.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub target: Option<Target>,
    /// The blob that is attached to the version.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub attached: Option<Descriptor>,
    /// What the writer said about it.
    #[serde(flatten)]
    pub remark: Remark,
}

/// The version that an entry means.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct Target {
    /// Its number.
    pub version: u64,
    /// Digest of its manifest.
    pub digest: Digest,
}

/// What the writer of an entry says about it. The registry has no clock and asks nobody's name.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Remark {
    /// Who wrote it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub who: Option<String>,
    /// Why.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub reason: Option<String>,
    /// When, in RFC 3339 (`2026-11-22T10:00:00Z`).
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub when: Option<String>,
}

/// What has to hold now for an entry to be written: compare and swap.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub enum Expect {
    /// Whatever it is.
    #[default]
    Anything,
    /// No version.
    Nothing,
    /// This version.
    Version(u64),
}

impl Expect {
    fn holds(self, current: Option<Target>) -> bool {
        match self {
            Self::Anything => true,
            Self::Nothing => current.is_none(),
            Self::Version(number) => current.is_some_and(|target| target.version == number),
        }
    }
}

impl ModelVersion {
    /// What an entry says of this version.
    pub(crate) fn target(&self) -> Target {
        Target { version: self.version, digest: self.digest }
    }
}

/// A log's place.
#[derive(Debug)]
pub(crate) struct Log {
    /// What it is about.
    pub(crate) subject: String,
    /// Folder of its entries.
    pub(crate) folder: String,
    /// Whether each of its entries attaches a blob to a version.
    pub(crate) attaches: bool,
}

impl Log {
    /// Key of entry `number`.
    pub(crate) fn key(&self, number: u64) -> String {
        format!("{}/{number:09}.json", self.folder)
    }

    /// A problem with entry `number`.
    pub(crate) fn problem(&self, number: u64, fault: Fault) -> Problem {
        Problem { model: Some(self.subject.clone()), file: None, object: self.key(number), fault }
    }

    /// Reads what stands at entry `number`, or says what is wrong with it.
    pub(crate) fn parse(&self, bytes: &[u8], number: u64) -> std::result::Result<Entry, String> {
        let entry: Entry = serde_json::from_slice(bytes).map_err(|error| error.to_string())?;
        if (entry.subject.as_str(), entry.number) != (&self.subject, number) {
            return Err(format!("it is entry {} about `{}`", entry.number, entry.subject));
        }
        if entry.previous.is_some() != (number > 1) {
            return Err("each entry but the first names the digest of the one before".into());
        }
        if entry.attached.is_some() != self.attaches || (self.attaches && entry.target.is_none()) {
            return Err("a blob that is attached to a version belongs in a log of attachments".into());
        }
        Ok(entry)
    }

    /// The entry after `last`, the last one and its digest, with nothing in it yet.
    pub(crate) fn after(&self, last: Option<&(Entry, Digest)>, remark: &Remark) -> Entry {
        Entry {
            subject: self.subject.clone(),
            number: last.map_or(0, |(entry, _)| entry.number) + 1,
            previous: last.map(|&(_, digest)| digest),
            target: None,
            attached: None,
            remark: remark.clone(),
        }
    }
}

/// Number in the name of an entry, `000000012.json`.
pub(crate) fn entry_number(object: &str) -> Option<u64> {
    let number = object.strip_suffix(".json")?.parse().ok()?;
    ((1..=LAST_ENTRY).contains(&number) && object == format!("{number:09}.json")).then_some(number)
}

impl Registry {
    /// Entry `number` of `log` and its digest; [`Error::Damaged`] if it is not the one that was written.
    pub(crate) fn entry(&self, log: &Log, number: u64) -> Result<(Entry, Digest)> {
        let (bytes, digest) = self.proven(&log.subject, &log.key(number))?;
        let entry =
            log.parse(&bytes, number).map_err(|reason| log.problem(number, Fault::Malformed { reason }))?;
        Ok((entry, digest))
    }

    /// The last entry of `log` and its digest: what holds now.
    fn last_entry(&self, log: &Log) -> Result<Option<(Entry, Digest)>> {
        let objects = self.store.list(&log.folder)?.objects;
        let last = objects.iter().filter_map(|object| entry_number(object)).max();
        last.map(|number| self.entry(log, number)).transpose()
    }

    /// What `log` says now: the version that it means, if any, and what was said about that.
    pub(crate) fn current(&self, log: &Log) -> Result<Option<(Target, Remark)>> {
        let last = self.last_entry(log)?;
        Ok(last.and_then(|(entry, _)| entry.target.map(|target| (target, entry.remark))))
    }

    /// All entries of `log`, from the first, with their chain verified.
    pub(crate) fn history(&self, log: &Log) -> Result<Vec<Entry>> {
        Ok(self.chain(log)?.into_iter().map(|(entry, _)| entry).collect())
    }

    /// All entries of `log` and their digests, as [`history`](Self::history) verifies them.
    pub(crate) fn chain(&self, log: &Log) -> Result<Vec<(Entry, Digest)>> {
        let Some((last, _)) = self.last_entry(log)? else { return Ok(Vec::new()) };
        let mut entries: Vec<(Entry, Digest)> = Vec::new();
        for number in 1..=last.number {
            let (entry, digest) = self.entry(log, number)?;
            if let Some(fault) = broken_chain(&entry, entries.last().map(|&(_, digest)| digest)) {
                return Err(log.problem(number, fault).into());
            }
            entries.push((entry, digest));
        }
        Ok(entries)
    }

    /// Makes `log` mean `target` from now on and returns the new entry; none if it means that already. If `expect` does not hold,
    /// nothing is written.
    pub(crate) fn append(
        &self,
        log: &Log,
        target: Option<Target>,
        expect: Expect,
        remark: &Remark,
    ) -> Result<Option<Entry>> {
        let mut last = self.last_entry(log)?;
        loop {
            let current = last.as_ref().and_then(|(entry, _)| entry.target);
            if !expect.holds(current) {
                return Err(Error::Unexpected {
                    subject: log.subject.clone(),
                    found: current.map(|t| t.version),
                });
            }
            if current == target {
                return Ok(None);
            }
            let entry = Entry { target, ..log.after(last.as_ref(), remark) };
            if self.create_entry(log, &entry)? {
                return Ok(Some(entry));
            }
            // Another writer was first: begin again from what it wrote.
            last = Some(self.entry(log, entry.number)?);
        }
    }

    /// Writes `entry` into `log`; false if another entry has its number.
    pub(crate) fn create_entry(&self, log: &Log, entry: &Entry) -> Result<bool> {
        let bytes = encode(entry).map_err(|reason| Error::Entry { subject: log.subject.clone(), reason })?;
        self.store.put_blob(Digest::of(&bytes), bytes.clone())?;
        self.store.create(&log.key(entry.number), bytes)
    }
}

/// The bytes of an entry that can be read back, or why there are none.
pub(crate) fn encode(entry: &Entry) -> std::result::Result<Vec<u8>, String> {
    if entry.number > LAST_ENTRY {
        return Err(format!("a log has at most {LAST_ENTRY} entries"));
    }
    let mut bytes = serde_json::to_vec_pretty(entry).map_err(|error| error.to_string())?;
    bytes.push(b'\n');
    if bytes.len() > ENTRY_LIMIT {
        return Err(format!("it would have {} bytes, more than {ENTRY_LIMIT}; say it shorter", bytes.len()));
    }
    Ok(bytes)
}

/// What is wrong if `entry` does not follow the one with digest `previous`.
pub(crate) fn broken_chain(entry: &Entry, previous: Option<Digest>) -> Option<Fault> {
    let name = |digest: Option<Digest>| digest.map_or("none".into(), |digest| digest.to_string());
    let (found, expected) = (name(entry.previous), name(previous));
    let reason = || format!("the entry before has digest {expected}, this one names {found}");
    (entry.previous != previous).then(|| Fault::Malformed { reason: reason() })
}

#[cfg(test)]
mod tests {
    use std::fs;

    use super::*;
    use crate::fixture::{Place, flip};

    fn log() -> Log {
        let folder = "models/approach/aliases/champion".into();
        Log { subject: "approach:champion".into(), folder, attaches: false }
    }

    fn target(version: u64) -> Target {
        Target { version, digest: Digest::of(&version.to_le_bytes()) }
    }

    fn write(
        registry: &Registry,
        version: impl Into<Option<Target>>,
        expect: Expect,
    ) -> Result<Option<Entry>> {
        registry.append(&log(), version.into(), expect, &Remark::default())
    }

    #[test]
    fn the_highest_number_holds() {
        for place in Place::all() {
            let registry = place.registry();
            assert_eq!(registry.current(&log()).unwrap(), None);
            assert_eq!(write(&registry, None::<Target>, Expect::Anything).unwrap(), None, "nothing to end");
            assert_eq!(write(&registry, target(1), Expect::Anything).unwrap().unwrap().number, 1);
            assert_eq!(write(&registry, target(1), Expect::Anything).unwrap(), None, "holds already");
            let remark = Remark { reason: Some("it won".into()), ..Remark::default() };
            registry.append(&log(), Some(target(2)), Expect::Version(1), &remark).unwrap();
            assert_eq!(registry.current(&log()).unwrap(), Some((target(2), remark)));
            write(&registry, None::<Target>, Expect::Anything).unwrap();
            assert_eq!(registry.current(&log()).unwrap(), None);
            let told: Vec<_> =
                registry.history(&log()).unwrap().iter().map(|e| (e.number, e.target)).collect();
            assert_eq!(told, [(1, Some(target(1))), (2, Some(target(2))), (3, None)]);
        }
    }

    #[test]
    fn what_is_not_as_expected_is_not_changed() {
        let place = Place::local();
        let registry = place.registry();
        assert!(write(&registry, target(1), Expect::Version(1)).is_err());
        write(&registry, target(1), Expect::Nothing).unwrap().unwrap();
        for wrong in [Expect::Nothing, Expect::Version(2)] {
            let error = write(&registry, target(3), wrong).unwrap_err().to_string();
            assert!(error.contains("approach:champion is version 1"), "{error}");
        }
        assert_eq!(registry.history(&log()).unwrap().len(), 1);
    }

    /// Every entry is there once, and of those who expect the same state only one writes.
    #[test]
    fn racing_writers_lose_nothing() {
        for place in Place::all() {
            let registry = place.registry();
            let winners = std::sync::atomic::AtomicUsize::new(0);
            std::thread::scope(|scope| {
                for thread in 0..8 {
                    let (registry, winners) = (&registry, &winners);
                    scope.spawn(move || {
                        if write(registry, target(100 + thread), Expect::Nothing).is_ok() {
                            winners.fetch_add(1, std::sync::atomic::Ordering::Relaxed);
                        }
                        for round in 0..4 {
                            write(registry, target(10 * thread + round + 1), Expect::Anything)
                                .unwrap()
                                .unwrap();
                        }
                    });
                }
            });
            let entries = registry.history(&log()).unwrap();
            let mut versions: Vec<_> = entries.iter().map(|entry| entry.target.unwrap().version).collect();
            versions.sort_unstable();
            versions.dedup();
            assert_eq!((entries.len(), versions.len()), (33, 33));
            assert_eq!(winners.into_inner(), 1);
        }
    }

    #[test]
    fn a_damaged_entry_is_neither_believed_nor_built_upon() {
        let place = Place::local();
        let registry = place.registry();
        write(&registry, target(1), Expect::Anything).unwrap();
        write(&registry, target(2), Expect::Anything).unwrap();
        flip(&place.path("registry"), &log().key(2));
        assert!(matches!(registry.current(&log()), Err(Error::Damaged(_))));
        assert!(matches!(write(&registry, target(3), Expect::Anything), Err(Error::Damaged(_))));
    }

    #[test]
    fn misfiled_entries_and_broken_chains_are_found() {
        let place = Place::local();
        let registry = place.registry();
        for version in 1..=3 {
            write(&registry, target(version), Expect::Anything).unwrap();
        }
        let path = |number| place.path("registry").join(log().key(number));
        fs::copy(path(1), path(4)).unwrap();
        let misfiled = registry.current(&log()).unwrap_err().to_string();
        assert!(misfiled.contains("entry 1 about `approach:champion`"), "{misfiled}");
        fs::remove_file(path(4)).unwrap();

        // Another entry 2, correctly stored: only the digest in entry 3 tells.
        let (mut other, _) = registry.entry(&log(), 2).unwrap();
        other.target = Some(target(7));
        let bytes = encode(&other).unwrap();
        registry.store.put_blob(Digest::of(&bytes), bytes.clone()).unwrap();
        fs::write(path(2), bytes).unwrap();
        let broken = registry.history(&log()).unwrap_err().to_string();
        assert!(broken.contains("000000003.json") && broken.contains("the entry before"), "{broken}");
    }
}
