//! Finding versions: listing models, resolving references.

use std::collections::BTreeMap;

use serde::Serialize;

use crate::error::{Error, Result};
use crate::events::events_key;
use crate::model::{AliasName, ModelName, ModelRef, ModelVersion, Selector};
use crate::registry::{Registry, versions_key};
use crate::store::file_name;
use crate::store::sequence::parse_number;

/// A model with its versions and aliases.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct Model {
    /// Its name.
    pub name: ModelName,
    /// Numbers of its versions, in ascending order.
    pub versions: Vec<u64>,
    /// Numbers of the yanked versions, in ascending order.
    pub yanked: Vec<u64>,
    /// Its aliases and the numbers of the versions that they name.
    pub aliases: BTreeMap<AliasName, u64>,
}

impl Registry {
    /// Returns all models with their versions and aliases, sorted by name.
    pub fn list(&self) -> Result<Vec<Model>> {
        let mut models = Vec::new();
        for name in self.names()? {
            let versions = self.versions(&name)?;
            if !versions.is_empty() {
                let (yanked, aliases) = (self.yanked_versions(&name)?, self.aliases(&name)?);
                models.push(Model { name, versions, yanked, aliases });
            }
        }
        Ok(models)
    }

    fn yanked_versions(&self, name: &ModelName) -> Result<Vec<u64>> {
        let mut yanked = Vec::new();
        let folders = self.store.list(&events_key(name))?.checked()?.folders;
        for number in folders.iter().filter_map(|folder| parse_number(file_name(folder))) {
            if self.yanked(name, number)?.is_some() {
                yanked.push(number);
            }
        }
        Ok(yanked)
    }

    /// Resolves `reference`. The manifest is verified. The files are not read.
    pub fn show(&self, reference: &ModelRef) -> Result<ModelVersion> {
        self.with_yank(self.load(&reference.name, self.find(reference)?)?)
    }

    /// Returns the number of the version that `reference` names.
    pub(crate) fn find(&self, reference: &ModelRef) -> Result<u64> {
        let name = &reference.name;
        let numbers = self.existing_versions(name)?;
        let found = match &reference.selector {
            Selector::Newest => Some(self.newest(name, &numbers)?),
            Selector::Alias(alias) => Some(self.aliased(name, alias)?),
            Selector::Version(number) => numbers.binary_search(number).is_ok().then_some(*number),
            Selector::Digest(digest) => {
                let pointers = self.store.pointers(&versions_key(name), &numbers)?;
                pointers.into_iter().find(|(_, found)| found == digest).map(|(number, _)| number)
            }
        };
        let newest = numbers.last().unwrap_or(&0);
        found.ok_or_else(|| {
            Error::NotFound(format!("there is no version `{reference}`; the newest is {name}@{newest}"))
        })
    }

    /// Returns the highest of `numbers`, those of all versions of `name`, that is not yanked.
    fn newest(&self, name: &ModelName, numbers: &[u64]) -> Result<u64> {
        for &number in numbers.iter().rev() {
            if self.yanked(name, number)?.is_none() {
                return Ok(number);
            }
        }
        let newest = numbers.last().unwrap_or(&0);
        Err(Error::NotFound(format!(
            "{name}: every version is yanked; to use one anyway, name it by its number, as {name}@{newest}"
        )))
    }
}

#[cfg(test)]
mod tests {
    use crate::fixture::Place;

    #[test]
    fn finds_versions_by_number_digest_and_age() {
        for place in Place::all() {
            let registry = place.registry();
            let first = place.publish(&registry, "approach", b"one");
            let second = place.publish(&registry, "approach", b"two");
            place.publish(&registry, "avoid", b"one");
            let show = |text: &str| registry.show(&text.parse().unwrap());
            assert_eq!(show("approach@1").unwrap(), first);
            assert_eq!(show("approach").unwrap(), second);
            assert_eq!(show(&format!("approach@{}", first.digest)).unwrap(), first);
            let models = registry.list().unwrap().into_iter();
            let listed: Vec<_> = models.map(|model| (model.name.to_string(), model.versions)).collect();
            assert_eq!(listed, [("approach".into(), vec![1, 2]), ("avoid".into(), vec![1])]);

            let missing = show("approach@3").unwrap_err().to_string();
            assert!(
                missing.contains("`approach@3`") && missing.contains("newest is approach@2"),
                "{missing}"
            );
            let other = show(&format!("avoid@{}", first.digest)).unwrap_err();
            assert!(other.to_string().contains("no version `avoid@sha256:"), "{other}");
            let unknown = show("aproach").unwrap_err().to_string();
            assert!(unknown.contains("it has: approach, avoid"), "{unknown}");
        }
    }
}
