//! Whether a store can hold a registry: whether it creates an object only where there is none.
//!
//! All else rests on that. Some servers answer the condition with success and overwrite, which would lose versions in
//! silence; some file systems and servers cannot do it at all.

use bytes::Bytes;

use crate::error::{Error, Result};
use crate::store::Store;

/// Beginning of the keys that are written for a moment.
pub(crate) const PROBE: &str = "probe-";

/// Whether `key` is that of an object that a probe writes, and leaves behind if it is killed.
pub(crate) fn is_probe(key: &str) -> bool {
    let number = key.strip_prefix(PROBE);
    number.is_some_and(|number| !number.is_empty() && number.bytes().all(|c| c.is_ascii_digit()))
}

/// How many keys are tried: others may be probing too, or have been killed while they did.
const ATTEMPTS: u32 = 200;

/// Refuses a store that would lose a race. What is written is removed again.
pub(crate) fn probe(store: &Store) -> Result<()> {
    let unfit = |reason: String| Error::Unfit { root: store.root().to_owned(), reason };
    for number in 0..ATTEMPTS {
        let key = format!("{PROBE}{number}");
        match store.try_create(&key, Bytes::from_static(b"first")) {
            Ok(true) => {}
            Ok(false) => continue,
            Err(error) => {
                // Where an object can be written without the condition, it is the condition that failed.
                if store.put(&key, b"probe".to_vec()).is_err() {
                    return Err(error);
                }
                store.remove(&key)?;
                let cause = root_cause(&error);
                return Err(unfit(format!(
                    "it cannot create an object on condition that there is none ({cause})"
                )));
            }
        }
        let again = store.try_create(&key, Bytes::from_static(b"second"));
        let left = store.read(&key);
        store.remove(&key)?;
        return match (again?, left?.as_deref()) {
            (false, Some(b"first")) => Ok(()),
            (true, _) => Err(unfit("it ignores the condition that there is no object yet".into())),
            (false, _) => Err(unfit("it says that an object is there and overwrites it".into())),
        };
    }
    Err(unfit("it says of every name that it is taken".into()))
}

/// What the system or server answered, without who passed it on.
fn root_cause(error: &dyn std::error::Error) -> &dyn std::error::Error {
    error.source().map_or(error, root_cause)
}

#[cfg(test)]
mod tests {
    use crate::fixture::{Place, quirky};
    use crate::quirk::Quirk;
    use crate::registry::Registry;

    #[test]
    fn stores_that_lose_races_are_refused() {
        let cases = [
            (Quirk::IgnoresCondition, "ignores the condition"),
            (Quirk::OverwritesAndDenies, "overwrites it"),
            (Quirk::KnowsNoCondition, "on condition that there is none"),
            (Quirk::DeniesAll, "every name"),
        ];
        for (quirk, expected) in cases {
            let store = quirky(quirk);
            let message = Registry::on(store.clone()).unwrap_err().to_string();
            assert!(message.contains(expected) && message.starts_with("quirky: "), "{message}");
            let left = store.list("").unwrap();
            assert!(left.objects.is_empty() && left.folders.is_empty(), "{left:?}");
        }
    }

    #[test]
    fn a_registry_is_probed_without_a_trace() {
        for place in Place::all() {
            let store = place.store();
            // Left by a probe that was killed, which is no content either.
            store.put("probe-0", b"first".to_vec()).unwrap();
            let registry = Registry::on(store.clone()).unwrap();
            registry.probe().unwrap();
            assert_eq!(store.list("").unwrap().objects, ["probe-0", "registry.json"]);
        }
    }
}
