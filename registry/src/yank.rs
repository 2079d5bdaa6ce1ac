//! Yanking: a version that should not be used any more, and why. It is never deleted, only no longer the newest.
//!
//! Each yanked version has a numbered log, `models/<name>/yanks/000003/000000001.json`: an entry with the version yanks it, one
//! without takes that back.

use crate::error::Result;
use crate::log::{Entry, Expect, Log, Remark};
use crate::name::ModelName;
use crate::registry::{ModelVersion, Registry, folder_number};
use crate::store::MODELS;

/// Folder of the yanked versions of `name`.
pub(crate) fn yanks_key(name: &ModelName) -> String {
    format!("{MODELS}/{name}/yanks")
}

/// The log of the yanking of version `number` of `name`.
pub(crate) fn yank_log(name: &ModelName, number: u64) -> Log {
    let (subject, folder) = (format!("{name}@{number}"), format!("{}/{number:06}", yanks_key(name)));
    Log { subject, folder, attaches: false }
}

impl Registry {
    /// Yanks `version`, a version of this registry, and returns the new entry; none if it is yanked already.
    ///
    /// It can still be had by its number, its digest or an alias, and says then that it is yanked; it is not the newest.
    pub fn yank(&self, version: &ModelVersion, remark: &Remark) -> Result<Option<Entry>> {
        self.append(
            &yank_log(&version.name, version.version),
            Some(version.target()),
            Expect::Anything,
            remark,
        )
    }

    /// Takes the yanking of `version` back and returns the new entry; none if it is not yanked.
    pub fn unyank(&self, version: &ModelVersion, remark: &Remark) -> Result<Option<Entry>> {
        self.append(&yank_log(&version.name, version.version), None, Expect::Anything, remark)
    }

    /// Why version `number` of `name` was yanked; none if it is not.
    pub(crate) fn yanked(&self, name: &ModelName, number: u64) -> Result<Option<Remark>> {
        Ok(self.current(&yank_log(name, number))?.map(|(_, remark)| remark))
    }

    /// The numbers of the yanked versions of `name`, in rising order.
    pub(crate) fn yanked_versions(&self, name: &ModelName) -> Result<Vec<u64>> {
        let mut yanked = Vec::new();
        let folders = self.store.list(&yanks_key(name))?.folders;
        for number in folders.iter().filter_map(|folder| folder_number(folder)) {
            if self.yanked(name, number)?.is_some() {
                yanked.push(number);
            }
        }
        Ok(yanked)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::error::Error;
    use crate::fixture::{Place, model};
    use crate::manifest::Provenance;

    #[test]
    fn a_yanked_version_is_not_the_newest_but_is_still_there() {
        for place in Place::all() {
            let registry = place.registry();
            let first = place.publish(&registry, "approach", b"one");
            let second = place.publish(&registry, "approach", b"two");
            let show = |text: &str| registry.show(&text.parse().unwrap());
            let remark = Remark { reason: Some("trained on the test set".into()), ..Remark::default() };
            let champion = "champion".parse().unwrap();
            registry.set_alias(&champion, &second, Expect::Anything, &Remark::default()).unwrap();

            assert!(registry.yank(&second, &remark).unwrap().is_some());
            assert_eq!(registry.yank(&second, &remark).unwrap(), None);
            assert_eq!(show("approach").unwrap(), first);
            let by_digest = format!("approach@{}", second.digest);
            for reference in ["approach@2", "approach:champion", &by_digest] {
                let shown = show(reference).unwrap();
                assert_eq!((shown.version, shown.yanked.as_ref()), (2, Some(&remark)), "{reference}");
            }
            let pulled = registry.pull(&"approach@2".parse().unwrap(), &place.path("pulled")).unwrap();
            assert_eq!(pulled.version().yanked.as_ref(), Some(&remark));
            assert_eq!(registry.list().unwrap()[0].yanked, [2]);

            registry.yank(&first, &Remark::default()).unwrap();
            let all = show("approach").unwrap_err();
            assert!(matches!(all, Error::AllYanked { .. }), "{all}");
            assert!(registry.unyank(&second, &Remark::default()).unwrap().is_some());
            assert_eq!(registry.unyank(&second, &Remark::default()).unwrap(), None);
            assert_eq!(show("approach").unwrap(), second);
            assert_eq!(registry.yanked_versions(&model("approach")).unwrap(), [1]);
            assert!(registry.verify(None).unwrap().problems.is_empty());
        }
    }

    #[test]
    fn publishing_a_yanked_version_again_says_so() {
        let place = Place::local();
        let registry = place.registry();
        let version = place.publish(&registry, "approach", b"one");
        registry.yank(&version, &Remark::default()).unwrap();
        let checkpoint = place.checkpoint("checkpoint", b"one");
        let again = registry.publish(&version.name, &checkpoint, Provenance::default()).unwrap();
        assert_eq!(again.version().yanked, Some(Remark::default()));
    }
}
