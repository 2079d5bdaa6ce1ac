//! Differences between two versions: configuration, metrics, lineage, files.

use std::collections::{BTreeMap, BTreeSet};

use serde::Serialize;
use serde_json::{Value, json};

use crate::digest::Digest;
use crate::error::{Error, Result};
use crate::model::{ModelRef, ModelVersion};
use crate::registry::Registry;

/// Training configuration of a checkpoint.
const CONFIG: &str = "config.toml";

/// The differences between two versions. All lists are sorted by key.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[non_exhaustive]
pub struct Difference {
    /// The first version.
    pub from: ModelVersion,
    /// The second version.
    pub to: ModelVersion,
    /// Keys of `config.toml` whose values differ, as `phases.0.epochs`.
    pub configuration: Vec<Change<Value>>,
    /// All metrics of both versions, see [`Registry::metrics`].
    pub metrics: Vec<MetricChange>,
    /// Parts of the lineage that differ, as `datasets.b_2a`.
    pub lineage: Vec<Change<Value>>,
    /// Files that differ, by path.
    pub files: Vec<Change<Digest>>,
}

/// A value that differs, or that only one version has.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Change<T> {
    /// Its key.
    pub key: String,
    /// Its value in the first version.
    pub from: Option<T>,
    /// Its value in the second version.
    pub to: Option<T>,
}

/// A metric of two versions.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[non_exhaustive]
pub struct MetricChange {
    /// Its name.
    pub metric: String,
    /// Its value in the first version.
    pub from: Option<f64>,
    /// Its value in the second version.
    pub to: Option<f64>,
    /// The second value minus the first.
    pub difference: Option<f64>,
}

impl Registry {
    /// Compares two versions, which may be of different models.
    pub fn diff(&self, from: &ModelRef, to: &ModelRef) -> Result<Difference> {
        let (from, to) = (self.show(from)?, self.show(to)?);
        let configuration = changes(self.configuration(&from)?, self.configuration(&to)?);
        let metrics = side_by_side(self.values(&from)?, self.values(&to)?).into_iter();
        let metrics = metrics.map(|Change { key: metric, from, to }| {
            let difference = to.zip(from).map(|(to, from)| to - from);
            MetricChange { metric, from, to, difference }
        });
        let metrics = metrics.collect();
        let lineage = |version: &ModelVersion| flattened(json!(version.manifest.lineage));
        let lineage = changes(lineage(&from), lineage(&to));
        let files = changes(from.manifest.files(), to.manifest.files());
        Ok(Difference { from, to, configuration, metrics, lineage, files })
    }

    /// Returns the values of a version's configuration by key. They are empty if the checkpoint has no such file.
    fn configuration(&self, version: &ModelVersion) -> Result<BTreeMap<String, Value>> {
        let config = version.manifest.layers.iter().find(|layer| layer.path() == Some(CONFIG));
        let Some(layer) = config else { return Ok(BTreeMap::new()) };
        let bytes = self.store.document(&version.to_string(), layer.digest)?;
        let document = toml::from_slice(&bytes);
        let refuse = |error| Error::refused(version, format!("{CONFIG} is not TOML: {error}"));
        Ok(flattened(document.map_err(refuse)?))
    }
}

/// Returns the values of a document by path, as `phases.0.epochs`. A list of scalars is one value.
pub(crate) fn flattened(document: Value) -> BTreeMap<String, Value> {
    fn flatten(path: &str, value: Value, found: &mut BTreeMap<String, Value>) {
        let below = |key: &str| if path.is_empty() { key.to_owned() } else { format!("{path}.{key}") };
        match value {
            Value::Object(table) => {
                table.into_iter().for_each(|(key, value)| flatten(&below(&key), value, found));
            }
            Value::Array(list) if list.iter().any(|value| value.is_object() || value.is_array()) => {
                let items = list.into_iter().enumerate();
                items.for_each(|(index, value)| flatten(&below(&index.to_string()), value, found));
            }
            value => drop(found.insert(path.to_owned(), value)),
        }
    }
    let mut found = BTreeMap::new();
    flatten("", document, &mut found);
    found
}

/// Returns the values that differ.
fn changes<T: PartialEq>(from: BTreeMap<String, T>, to: BTreeMap<String, T>) -> Vec<Change<T>> {
    side_by_side(from, to).into_iter().filter(|change| change.from != change.to).collect()
}

fn side_by_side<T>(mut from: BTreeMap<String, T>, mut to: BTreeMap<String, T>) -> Vec<Change<T>> {
    let keys: BTreeSet<_> = from.keys().chain(to.keys()).cloned().collect();
    let change = |key: String| Change { from: from.remove(&key), to: to.remove(&key), key };
    keys.into_iter().map(change).collect()
}

#[cfg(test)]
mod tests {
    use std::fs;

    use serde_json::json;

    use super::*;
    use crate::fixture::{Place, flip, model};
    use crate::model::{Lineage, Provenance};
    use crate::store::blob_key;

    /// Publishes a checkpoint with this configuration, weights and metric.
    fn publish(place: &Place, registry: &Registry, config: &str, weights: &str, metric: (&str, f64)) {
        let checkpoint = place.checkpoint(weights, weights.as_bytes());
        fs::write(checkpoint.join(CONFIG), config).unwrap();
        let lineage = Lineage {
            datasets: [("a".to_owned(), Digest::of(b"a"))].into(),
            seed: (weights == "one").then_some(u64::MAX),
            device: Some("cpu".into()),
            ..Lineage::default()
        };
        let metrics = BTreeMap::from([("loss".to_owned(), 0.25), (metric.0.to_owned(), metric.1)]);
        let provenance = Provenance { lineage, metrics, ..Provenance::default() };
        registry.publish(&model("approach"), &checkpoint, provenance).unwrap();
    }

    fn diff(registry: &Registry, from: &str, to: &str) -> Result<Difference> {
        registry.diff(&from.parse().unwrap(), &to.parse().unwrap())
    }

    fn change<T>(key: &str, from: Option<T>, to: Option<T>) -> Change<T> {
        Change { key: key.into(), from, to }
    }

    fn compared(metric: &str, [from, to, difference]: [Option<f64>; 3]) -> MetricChange {
        MetricChange { metric: metric.into(), from, to, difference }
    }

    #[test]
    fn all_differences_are_reported() {
        for place in Place::all() {
            let registry = place.registry();
            let one = "seed = 5\nsize = [32, 24]\n[net]\nwidth = 0.25\n[[phases]]\nepochs = 2\n";
            let two =
                "size = [32, 32]\n[net]\nwidth = 0.25\n[[phases]]\nepochs = 2\n[[phases]]\nrate = 1e-3\n";
            publish(&place, &registry, one, "one", ("error_mm", 0.5));
            publish(&place, &registry, two, "two", ("error_mm", 0.75));
            let found = diff(&registry, "approach@1", "approach").unwrap();
            let configuration = [
                change("phases.1.rate", None, Some(json!(1e-3))),
                change("seed", Some(json!(5)), None),
                change("size", Some(json!([32, 24])), Some(json!([32, 32]))),
            ];
            assert_eq!(found.configuration, configuration);
            let metrics = [
                compared("error_mm", [Some(0.5), Some(0.75), Some(0.25)]),
                compared("loss", [Some(0.25), Some(0.25), Some(0.0)]),
            ];
            assert_eq!(found.metrics, metrics);
            assert_eq!(found.lineage, [change("seed", Some(json!(u64::MAX)), None)]);
            let digest = |bytes: &[u8]| Some(Digest::of(bytes));
            let files = [
                change(CONFIG, digest(one.as_bytes()), digest(two.as_bytes())),
                change("weights.bin", digest(b"one"), digest(b"two")),
            ];
            assert_eq!(found.files, files);

            let same = diff(&registry, "approach@1", "approach@1").unwrap();
            assert!(same.configuration.is_empty() && same.lineage.is_empty() && same.files.is_empty());
            assert_eq!(same.metrics.len(), 2);
        }
    }

    #[test]
    fn metrics_of_only_one_version() {
        let place = Place::local();
        let registry = place.registry();
        publish(&place, &registry, "", "one", ("skill", 0.5));
        publish(&place, &registry, "", "two", ("error_mm", 0.5));
        let found = diff(&registry, "approach@1", "approach@2").unwrap().metrics;
        assert_eq!(found[0], compared("error_mm", [None, Some(0.5), None]));
        assert_eq!(found[2], compared("skill", [Some(0.5), None, None]));
    }

    #[test]
    fn malformed_and_damaged_configurations_are_refused() {
        let place = Place::local();
        let registry = place.registry();
        publish(&place, &registry, "seed = 5", "one", ("x", 0.0));
        publish(&place, &registry, "seed = ", "two", ("x", 0.0));
        let refused = diff(&registry, "approach@1", "approach@2").unwrap_err().to_string();
        assert!(refused.contains("approach@2: config.toml is not TOML"), "{refused}");
        flip(&place.path("registry"), &blob_key(Digest::of(b"seed = 5")));
        let damaged = diff(&registry, "approach@1", "approach@1").unwrap_err();
        assert!(matches!(damaged, Error::Damaged(_)), "{damaged}");
    }
}
