//! Yanks: marks on versions that should no longer be used. A yanked version is never deleted, but no longer the newest.

use super::Log;
use crate::error::Result;
use crate::model::{Event, EventKind, ModelName, ModelVersion, Note};
use crate::registry::Registry;

/// Returns the last yank or reversal of a yank.
pub(crate) fn last_yank(events: &[Event]) -> Option<&Event> {
    events.iter().rev().find(|event| matches!(event.kind, EventKind::Yanked | EventKind::Unyanked))
}

/// Returns the note of the yank in force after these events.
fn yank_in_force(events: &[Event]) -> Option<Note> {
    last_yank(events).filter(|event| event.kind == EventKind::Yanked).map(|event| event.note.clone())
}

impl Registry {
    /// Yanks `version`, a version of this registry, and returns the new event. Returns `None` if it is yanked already.
    ///
    /// Its number, its digest and its aliases still name it. It is then marked as yanked, and not the newest.
    pub fn yank(&self, version: &ModelVersion, note: &Note) -> Result<Option<Event>> {
        self.set_yanked(version, EventKind::Yanked, note)
    }

    /// Takes the yank of `version` back and returns the new event. Returns `None` if it is not yanked.
    pub fn unyank(&self, version: &ModelVersion, note: &Note) -> Result<Option<Event>> {
        self.set_yanked(version, EventKind::Unyanked, note)
    }

    fn set_yanked(&self, version: &ModelVersion, kind: EventKind, note: &Note) -> Result<Option<Event>> {
        let log = Log::of_version(version);
        self.record(&log, log.draft(kind, Some(version.target()), note), &|events| {
            Ok(yank_in_force(events).is_some() != (kind == EventKind::Yanked))
        })
    }

    /// Returns the note of the yank in force for version `number`, if any.
    pub(crate) fn yanked(&self, name: &ModelName, number: u64) -> Result<Option<Note>> {
        Ok(yank_in_force(&self.history(&Log::of_number(name, number))?))
    }

    /// Completes a loaded version with the yank in force.
    pub(crate) fn with_yank(&self, version: ModelVersion) -> Result<ModelVersion> {
        let yanked = yank_in_force(&self.events(&version)?);
        Ok(ModelVersion { yanked, ..version })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::events::alias::Precondition;
    use crate::fixture::Place;
    use crate::model::Provenance;

    #[test]
    fn a_yanked_version_is_not_the_newest_but_is_still_there() {
        for place in Place::all() {
            let registry = place.registry();
            let first = place.publish(&registry, "approach", b"one");
            let second = place.publish(&registry, "approach", b"two");
            let show = |text: &str| registry.show(&text.parse().unwrap());
            let note = Note { reason: Some("trained on the test set".into()), ..Note::default() };
            let champion = "champion".parse().unwrap();
            registry.set_alias(&champion, &second, Precondition::Any, &Note::default()).unwrap();

            assert!(registry.yank(&second, &note).unwrap().is_some());
            assert_eq!(registry.yank(&second, &note).unwrap(), None);
            assert_eq!(show("approach").unwrap(), first);
            let by_digest = format!("approach@{}", second.digest);
            for reference in ["approach@2", "approach:champion", &by_digest] {
                let shown = show(reference).unwrap();
                assert_eq!((shown.version, shown.yanked.as_ref()), (2, Some(&note)), "{reference}");
            }
            let pulled = registry.pull(&"approach@2".parse().unwrap(), &place.path("pulled")).unwrap();
            assert_eq!(pulled.value().yanked.as_ref(), Some(&note));
            assert_eq!(registry.list().unwrap()[0].yanked, [2]);

            registry.yank(&first, &Note::default()).unwrap();
            let all = show("approach").unwrap_err();
            assert!(all.to_string().contains("every version is yanked"), "{all}");
            assert!(registry.unyank(&second, &Note::default()).unwrap().is_some());
            assert_eq!(registry.unyank(&second, &Note::default()).unwrap(), None);
            assert_eq!(show("approach").unwrap(), second);
            assert_eq!(registry.list().unwrap()[0].yanked, [1]);
            assert!(registry.verify(None).unwrap().problems.is_empty());
        }
    }

    #[test]
    fn publishing_a_yanked_version_again_reports_the_yank() {
        let place = Place::local();
        let registry = place.registry();
        let version = place.publish(&registry, "approach", b"one");
        registry.yank(&version, &Note::default()).unwrap();
        let checkpoint = place.checkpoint("checkpoint", b"one");
        let again = registry.publish(&version.name, &checkpoint, Provenance::default()).unwrap();
        assert_eq!(again.value().yanked, Some(Note::default()));
    }
}
