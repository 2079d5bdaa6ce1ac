//! Aliases: names that users give to versions and move from one to another, as `approach:champion`.

use std::collections::BTreeMap;

use super::{Log, events_key};
use crate::error::{Error, Result};
use crate::model::{AliasName, Event, EventKind, ModelName, ModelVersion, Note, Target};
use crate::problem::Fault;
use crate::registry::{Registry, listed, versions_key};
use crate::store::file_name;
use crate::store::sequence::pointer_key;

/// What an alias must name for a change to take place: compare and swap.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub enum Precondition {
    /// Anything.
    #[default]
    Any,
    /// No version.
    Unset,
    /// This version.
    Version(u64),
}

impl Precondition {
    fn holds(self, current: Option<Target>) -> bool {
        match self {
            Self::Any => true,
            Self::Unset => current.is_none(),
            Self::Version(number) => current.is_some_and(|target| target.version == number),
        }
    }
}

impl Registry {
    /// Makes `alias` name `version`, a version of this registry, and returns the new event. Returns `None` if it already does.
    ///
    /// Simultaneous changes take place one after the other, unless `precondition` no longer holds.
    pub fn set_alias(
        &self,
        alias: &AliasName,
        version: &ModelVersion,
        precondition: Precondition,
        note: &Note,
    ) -> Result<Option<Event>> {
        self.change_alias(&Log::of_alias(&version.name, alias), Some(version.target()), precondition, note)
    }

    /// Ends `alias`: it names no version from now on, and its history stays. Fails if it names none already.
    pub fn remove_alias(
        &self,
        name: &ModelName,
        alias: &AliasName,
        precondition: Precondition,
        note: &Note,
    ) -> Result<Event> {
        let removed = self.change_alias(&Log::of_alias(name, alias), None, precondition, note)?;
        removed.map_or_else(|| Err(self.no_alias(name, alias)), Ok)
    }

    fn change_alias(
        &self,
        log: &Log,
        target: Option<Target>,
        precondition: Precondition,
        note: &Note,
    ) -> Result<Option<Event>> {
        let kind = if target.is_some() { EventKind::AliasSet } else { EventKind::AliasRemoved };
        self.record(log, log.draft(kind, target, note), &|events| {
            let current = events.last().and_then(|event| event.target);
            if !precondition.holds(current) {
                let found = current.map_or("unset".into(), |target| format!("version {}", target.version));
                return Err(Error::Conflict(format!("{} is {found}", log.subject)));
            }
            Ok(current != target)
        })
    }

    /// Returns the aliases of `name` and the numbers of the versions that they name.
    pub fn aliases(&self, name: &ModelName) -> Result<BTreeMap<AliasName, u64>> {
        self.existing_versions(name)?;
        let mut aliases = BTreeMap::new();
        let folders = self.store.list(&events_key(name))?.checked()?.folders;
        for alias in folders.iter().filter_map(|folder| file_name(folder).parse().ok()) {
            if let Some(target) = self.target(name, &alias)? {
                aliases.insert(alias, target.version);
            }
        }
        Ok(aliases)
    }

    /// Returns all events of `alias`, in order. Fails if it was never set.
    pub fn alias_history(&self, name: &ModelName, alias: &AliasName) -> Result<Vec<Event>> {
        let events = self.history(&Log::of_alias(name, alias))?;
        if events.is_empty() {
            return Err(self.no_alias(name, alias));
        }
        Ok(events)
    }

    /// Returns what `alias` names now.
    fn target(&self, name: &ModelName, alias: &AliasName) -> Result<Option<Target>> {
        Ok(self.last_event(&Log::of_alias(name, alias))?.and_then(|event| event.target))
    }

    /// Returns the number of the version that `alias` names, and verifies that it is still the version that the alias was set
    /// to.
    pub(crate) fn aliased(&self, name: &ModelName, alias: &AliasName) -> Result<u64> {
        let Some(Target { version, digest }) = self.target(name, alias)? else {
            return Err(self.no_alias(name, alias));
        };
        let folder = versions_key(name);
        let fault = match self.store.pointers(&folder, &[version])?.first() {
            Some(&(_, found)) if found == digest => return Ok(version),
            Some(&(_, found)) => Fault::Digest { expected: digest, found },
            None => Fault::Missing,
        };
        Err(fault.of(&format!("{name}:{alias}"), &pointer_key(&folder, version)).into())
    }

    fn no_alias(&self, name: &ModelName, alias: &AliasName) -> Error {
        self.aliases(name).map_or_else(Into::into, |aliases| {
            let known = listed(aliases.keys());
            Error::NotFound(format!("there is no alias `{alias}` of {name}; its aliases are: {known}"))
        })
    }
}

#[cfg(test)]
mod tests {
    use std::fs;

    use super::*;
    use crate::fixture::{Place, model};

    fn alias(text: &str) -> AliasName {
        text.parse().unwrap()
    }

    #[test]
    fn an_alias_is_the_version_that_it_was_set_to() {
        for place in Place::all() {
            let registry = place.registry();
            let first = place.publish(&registry, "approach", b"one");
            let second = place.publish(&registry, "approach", b"two");
            let (champion, none) = (alias("champion"), Note::default());
            let champion_of = || registry.show(&"approach:champion".parse().unwrap());
            let set = |version| registry.set_alias(&champion, version, Precondition::Any, &none).unwrap();

            let unknown = champion_of().unwrap_err().to_string();
            assert!(unknown.contains("no alias `champion`") && unknown.contains("are: none"), "{unknown}");
            set(&second).unwrap();
            set(&first).unwrap();
            assert_eq!(champion_of().unwrap(), first);
            assert_eq!(set(&first), None);
            place.publish(&registry, "approach", b"three");
            assert_eq!(champion_of().unwrap(), first, "a new version moves no alias");
            let misspelt = registry.show(&"approach:champoin".parse().unwrap()).unwrap_err().to_string();
            assert!(misspelt.contains("are: champion"), "{misspelt}");

            assert_eq!(registry.aliases(&model("approach")).unwrap(), [(champion.clone(), 1)].into());
            registry.remove_alias(&model("approach"), &champion, Precondition::Version(1), &none).unwrap();
            assert!(champion_of().unwrap_err().to_string().contains("no alias"));
            assert!(registry.aliases(&model("approach")).unwrap().is_empty());
            let history = registry.alias_history(&model("approach"), &champion).unwrap();
            let meant: Vec<_> =
                history.iter().map(|event| event.target.map(|target| target.version)).collect();
            assert_eq!(meant, [Some(2), Some(1), None]);
            assert!(registry.remove_alias(&model("approach"), &champion, Precondition::Any, &none).is_err());
            let missing = registry.alias_history(&model("aproach"), &champion).unwrap_err();
            assert!(missing.to_string().contains("no model `aproach`"), "{missing}");
        }
    }

    /// Another version under the number, correctly stored: the alias does not name that one.
    #[test]
    fn a_replaced_version_is_not_delivered() {
        let place = Place::local();
        let registry = place.registry();
        let first = place.publish(&registry, "approach", b"one");
        place.publish(&registry, "approach", b"two");
        registry.set_alias(&alias("champion"), &first, Precondition::Any, &Note::default()).unwrap();
        let versions = place.path("registry/models/approach/versions");
        fs::copy(versions.join("000002"), versions.join("000001")).unwrap();
        assert!(registry.show(&"approach@1".parse().unwrap()).is_ok());
        let error = registry.show(&"approach:champion".parse().unwrap()).unwrap_err();
        assert!(matches!(error, Error::Damaged(_)), "{error}");
    }
}
