//! Probing whether a store can hold a registry: it must create an object only if there is none.
//!
//! Everything else depends on this. Some servers ignore the condition and overwrite, which would silently lose versions. Some
//! file systems and servers do not support it at all.

use bytes::Bytes;

use super::Store;
use super::folder::is_numeral;
use crate::error::{Error, Result};

/// Prefix of the temporary keys.
pub(crate) const PROBE: &str = "probe-";

/// Returns whether `key` is that of a probe's object. A killed probe leaves it behind.
pub(crate) fn is_probe(key: &str) -> bool {
    key.strip_prefix(PROBE).is_some_and(is_numeral)
}

/// Number of keys to try. Others may be probing too, or have been killed while they did.
const ATTEMPTS: u32 = 200;

/// Refuses a store that could overwrite what is published. The probe's object is deleted again.
pub(crate) fn probe(store: &Store) -> Result<()> {
    let unfit = |reason: &str| {
        let reason = format!(
            "cannot hold a registry: {reason}. Of two simultaneous publications, one would be lost. A folder must be on a file \
             system with hard links (not FAT or exFAT), and an S3 server must honor `If-None-Match: *`"
        );
        Error::refused(&store.root, reason)
    };
    for number in 0..ATTEMPTS {
        let key = format!("{PROBE}{number}");
        match store.try_create(&key, Bytes::from_static(b"first")) {
            Ok(true) => {}
            Ok(false) => continue,
            Err(error) => {
                // If the object can be written without the condition, the condition is what failed.
                if store.put(&key, b"probe".to_vec()).is_err() {
                    return Err(error);
                }
                store.delete(&key)?;
                let cause = root_cause(&error);
                return Err(unfit(&format!("it cannot create an object only if there is none ({cause})")));
            }
        }
        let again = store.try_create(&key, Bytes::from_static(b"second"));
        let left = store.read(&key);
        store.delete(&key)?;
        return match (again?, left?.as_deref()) {
            (false, Some(b"first")) => Ok(()),
            (true, _) => Err(unfit("it ignores the condition that there is no object yet")),
            (false, _) => Err(unfit("it reports that the object exists, and overwrites it")),
        };
    }
    Err(unfit("it reports every name as taken"))
}

/// Returns the innermost error: the answer of the system or server itself.
fn root_cause(error: &dyn std::error::Error) -> &dyn std::error::Error {
    error.source().map_or(error, root_cause)
}

#[cfg(test)]
mod tests {
    use crate::fixture::{Place, misbehaving};
    use crate::registry::Registry;
    use crate::store::misbehaving::Misbehavior;

    #[test]
    fn stores_that_lose_races_are_refused() {
        let cases = [
            (Misbehavior::IgnoresCondition, "ignores the condition"),
            (Misbehavior::OverwritesAndDenies, "overwrites it"),
            (Misbehavior::LacksCondition, "only if there is none"),
            (Misbehavior::DeniesAll, "every name"),
        ];
        for (misbehavior, expected) in cases {
            let store = misbehaving(misbehavior);
            let message = Registry::on(store.clone()).unwrap_err().to_string();
            assert!(message.contains(expected) && message.starts_with("misbehaving: "), "{message}");
            let left = store.list("").unwrap();
            assert!(left.objects.is_empty() && left.folders.is_empty(), "{left:?}");
        }
    }

    #[test]
    fn a_probe_leaves_no_trace() {
        for place in Place::all() {
            let store = place.store();
            // Left by a killed probe. It does not count as content.
            store.put("probe-0", b"first".to_vec()).unwrap();
            let registry = Registry::on(store.clone()).unwrap();
            registry.probe().unwrap();
            let keys: Vec<_> = store.list("").unwrap().objects.into_iter().map(|object| object.key).collect();
            assert_eq!(keys, ["probe-0", "registry.json"]);
        }
    }
}
