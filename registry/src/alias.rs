//! Aliases: names that people give to versions and move from one to another, as `approach:champion`.
//!
//! Each is a numbered log, `models/<name>/aliases/<alias>/000000012.json`: who had which version when stays known.

use std::collections::BTreeMap;
use std::fmt;
use std::str::FromStr;

use serde::{Deserialize, Serialize};

use crate::digest::Digest;
use crate::error::{Error, Result};
use crate::log::{Entry, Expect, Log, Remark};
use crate::name::{ModelName, is_name};
use crate::problem::{Fault, Problem};
use crate::registry::{ModelVersion, Registry};
use crate::store::{MODELS, version_key};

/// Name of an alias: as a model's name, but it begins with a letter, so that no one takes it for a version.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(try_from = "String", into = "String")]
pub struct AliasName(String);

impl AliasName {
    /// The name as text.
    pub fn as_str(&self) -> &str {
        &self.0
    }
}

impl fmt::Display for AliasName {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.0)
    }
}

impl FromStr for AliasName {
    type Err = Error;

    fn from_str(text: &str) -> Result<Self> {
        text.to_owned().try_into()
    }
}

impl TryFrom<String> for AliasName {
    type Error = Error;

    fn try_from(name: String) -> Result<Self> {
        if is_name(&name) && name.starts_with(|c: char| c.is_ascii_lowercase()) {
            Ok(Self(name))
        } else {
            Err(Error::AliasName { name })
        }
    }
}

impl From<AliasName> for String {
    fn from(alias: AliasName) -> Self {
        alias.0
    }
}

/// Folder of the aliases of `name`.
pub(crate) fn aliases_key(name: &ModelName) -> String {
    format!("{MODELS}/{name}/aliases")
}

/// The log of an alias.
pub(crate) fn alias_log(name: &ModelName, alias: &AliasName) -> Log {
    let (subject, folder) = (format!("{name}:{alias}"), format!("{}/{alias}", aliases_key(name)));
    Log { subject, folder, attaches: false }
}

impl Registry {
    /// Lets `alias` mean `version`, a version of this registry, and returns the new entry; none if it means that already.
    ///
    /// Of several at once each writes its entry, one after the other, unless `expect` asks for what no longer holds.
    pub fn set_alias(
        &self,
        alias: &AliasName,
        version: &ModelVersion,
        expect: Expect,
        remark: &Remark,
    ) -> Result<Option<Entry>> {
        self.append(&alias_log(&version.name, alias), Some(version.target()), expect, remark)
    }

    /// Ends `alias`: it means no version from now on, and its history stays. An alias that means none is an error.
    pub fn remove_alias(
        &self,
        name: &ModelName,
        alias: &AliasName,
        expect: Expect,
        remark: &Remark,
    ) -> Result<Entry> {
        match self.append(&alias_log(name, alias), None, expect, remark)? {
            Some(entry) => Ok(entry),
            None => Err(self.no_alias(name, alias)?),
        }
    }

    /// The aliases of `name` and the numbers of the versions that they mean.
    pub fn aliases(&self, name: &ModelName) -> Result<BTreeMap<AliasName, u64>> {
        if self.versions(name)?.is_empty() {
            return Err(self.no_model(name)?);
        }
        let mut aliases = BTreeMap::new();
        let folders = self.store.list(&aliases_key(name))?.folders;
        for alias in folders.into_iter().filter_map(|folder| folder.parse().ok()) {
            if let Some((target, _)) = self.current(&alias_log(name, &alias))? {
                aliases.insert(alias, target.version);
            }
        }
        Ok(aliases)
    }

    /// All that `alias` ever meant, from the first entry. An alias that never was is an error.
    pub fn alias_history(&self, name: &ModelName, alias: &AliasName) -> Result<Vec<Entry>> {
        let entries = self.history(&alias_log(name, alias))?;
        if entries.is_empty() { Err(self.no_alias(name, alias)?) } else { Ok(entries) }
    }

    /// Number of the version that `alias` means: exactly the version that it was set to.
    pub(crate) fn aliased(&self, name: &ModelName, alias: &AliasName) -> Result<u64> {
        let Some((target, _)) = self.current(&alias_log(name, alias))? else {
            return Err(self.no_alias(name, alias)?);
        };
        let object = version_key(name, target.version);
        let bytes = self.store.read(&object)?;
        let fault = match bytes.map(|bytes| Digest::of(&bytes)) {
            Some(found) if found == target.digest => return Ok(target.version),
            Some(found) => Fault::Digest { expected: target.digest, found },
            None => Fault::Missing,
        };
        Err(Problem { model: Some(format!("{name}:{alias}")), file: None, object, fault }.into())
    }

    fn no_alias(&self, name: &ModelName, alias: &AliasName) -> Result<Error> {
        let known = self.aliases(name)?;
        let known = known.keys().map(AliasName::as_str).collect::<Vec<_>>().join(", ");
        let known = if known.is_empty() { "none".to_owned() } else { known };
        Ok(Error::NoAlias { name: name.to_string(), alias: alias.to_string(), known })
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
    fn names() {
        for good in ["champion", "a", "best-2026"] {
            assert_eq!(alias(good).as_str(), good);
        }
        for bad in ["", "3", "3rd", "Champion", "a/b", "..", "a:b", "a@1", "-a"] {
            assert!(bad.parse::<AliasName>().is_err(), "{bad}");
        }
    }

    #[test]
    fn an_alias_is_the_version_that_it_was_set_to() {
        for place in Place::all() {
            let registry = place.registry();
            let first = place.publish(&registry, "approach", b"one");
            let second = place.publish(&registry, "approach", b"two");
            let (champion, none) = (alias("champion"), Remark::default());
            let champion_of = || registry.show(&"approach:champion".parse().unwrap());
            let set = |version| registry.set_alias(&champion, version, Expect::Anything, &none).unwrap();

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
            registry.remove_alias(&model("approach"), &champion, Expect::Version(1), &none).unwrap();
            assert!(matches!(champion_of(), Err(Error::NoAlias { .. })));
            assert!(registry.aliases(&model("approach")).unwrap().is_empty());
            let history = registry.alias_history(&model("approach"), &champion).unwrap();
            let meant: Vec<_> = history.iter().map(|entry| entry.target.map(|t| t.version)).collect();
            assert_eq!(meant, [Some(2), Some(1), None]);
            assert!(registry.remove_alias(&model("approach"), &champion, Expect::Anything, &none).is_err());
            let missing = registry.alias_history(&model("aproach"), &champion).unwrap_err();
            assert!(matches!(missing, Error::NoModel { .. }), "{missing}");
        }
    }

    /// The manifest of another version under the number, correctly stored: the alias does not mean that one.
    #[test]
    fn a_replaced_version_is_not_delivered() {
        let place = Place::local();
        let registry = place.registry();
        let first = place.publish(&registry, "approach", b"one");
        let mut second = place.publish(&registry, "approach", b"two");
        registry.set_alias(&alias("champion"), &first, Expect::Anything, &Remark::default()).unwrap();
        second.manifest.set_version(1);
        let bytes = second.manifest.to_bytes().unwrap();
        registry.store.put_blob(Digest::of(&bytes), bytes.clone()).unwrap();
        fs::write(place.path("registry").join(version_key(&first.name, 1)), bytes).unwrap();
        assert!(registry.show(&"approach@1".parse().unwrap()).is_ok());
        let error = registry.show(&"approach:champion".parse().unwrap()).unwrap_err();
        assert!(matches!(error, Error::Damaged(_)), "{error}");
    }
}
