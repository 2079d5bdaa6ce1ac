//! What two versions differ in: configuration, metrics, lineage, files.

use std::collections::{BTreeMap, BTreeSet};

use serde::Serialize;
use serde_json::Value;

use crate::digest::Digest;
use crate::error::{Error, Result};
use crate::manifest::{Descriptor, Manifest};
use crate::reference::ModelRef;
use crate::registry::{ModelVersion, Registry};
use crate::store::DOCUMENT_LIMIT;

/// The file of a checkpoint that says how it was trained.
const CONFIG: &str = "config.toml";

/// What two versions differ in. All lists are sorted by key.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[non_exhaustive]
pub struct Difference {
    /// The first version.
    pub from: ModelVersion,
    /// The second version.
    pub to: ModelVersion,
    /// Keys of the two `config.toml` whose values differ, as `phases.0.epochs`.
    pub configuration: Vec<Change<Value>>,
    /// All metrics of both, as [`Registry::metrics`] has them.
    pub metrics: Vec<Compared>,
    /// What of the lineage differs, as `datasets.b_2a`.
    pub lineage: Vec<Change<Value>>,
    /// The files that differ, by path.
    pub files: Vec<Change<Digest>>,
}

/// What has some value in one version and another, or none, in the other.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Change<T> {
    /// What it is.
    pub key: String,
    /// Its value in the first version, if it has it.
    pub from: Option<T>,
    /// Its value in the second version, if it has it.
    pub to: Option<T>,
}

/// A metric of two versions.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[non_exhaustive]
pub struct Compared {
    /// Its name.
    pub metric: String,
    /// Its value in the first version, if it has it.
    pub from: Option<f64>,
    /// Its value in the second version, if it has it.
    pub to: Option<f64>,
    /// How much greater the second value is.
    pub difference: Option<f64>,
}

impl From<Change<f64>> for Compared {
    fn from(Change { key, from, to }: Change<f64>) -> Self {
        Self { metric: key, from, to, difference: to.zip(from).map(|(to, from)| to - from) }
    }
}

impl Registry {
    /// What the version `to` differs in from the version `from`; they may be of different models.
    pub fn diff(&self, from: &ModelRef, to: &ModelRef) -> Result<Difference> {
        let (from, to) = (self.show(from)?, self.show(to)?);
        let configuration = changes(self.configuration(&from)?, self.configuration(&to)?);
        let (a, b) = (&from.manifest, &to.manifest);
        let metrics = side_by_side(self.values(&from)?, self.values(&to)?);
        let metrics = metrics.into_iter().map(Compared::from).collect();
        let lineage = changes(lineage(&from)?, lineage(&to)?);
        let files = changes(files(a), files(b));
        Ok(Difference { from, to, configuration, metrics, lineage, files })
    }

    /// The configuration of a version by key; none if the checkpoint has no such file.
    fn configuration(&self, version: &ModelVersion) -> Result<BTreeMap<String, Value>> {
        let config = version.manifest.layers.iter().find(|layer| layer.path() == Some(CONFIG));
        let Some(layer) = config else { return Ok(BTreeMap::new()) };
        let refuse = |reason| Error::Configuration { model: version.to_string(), file: CONFIG, reason };
        if layer.size > DOCUMENT_LIMIT {
            return Err(refuse(format!("it has {} bytes, more than {DOCUMENT_LIMIT}", layer.size)));
        }
        let bytes = self.document(&version.to_string(), layer)?;
        let text = String::from_utf8(bytes).map_err(|error| refuse(error.to_string()))?;
        let document = toml::from_str(&text).map_err(|error| refuse(error.to_string()))?;
        Ok(flattened(document))
    }
}

fn lineage(version: &ModelVersion) -> Result<BTreeMap<String, Value>> {
    let document = serde_json::to_value(&version.manifest.lineage);
    let unwritable =
        |error: serde_json::Error| Error::Version { model: version.to_string(), reason: error.to_string() };
    document.map(flattened).map_err(unwritable)
}

fn files(manifest: &Manifest) -> BTreeMap<String, Digest> {
    let file = |layer: &Descriptor| (layer.path().unwrap_or_default().to_owned(), layer.digest);
    manifest.layers.iter().map(file).collect()
}

/// The values of a document by path, `phases.0.epochs`. Lists of plain values are values.
fn flattened(document: Value) -> BTreeMap<String, Value> {
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

/// What differs.
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
    use crate::manifest::{Lineage, Provenance};
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

    fn compared(metric: &str, [from, to, difference]: [Option<f64>; 3]) -> Compared {
        Compared { metric: metric.into(), from, to, difference }
    }

    #[test]
    fn everything_that_differs_is_told() {
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
    fn metrics_that_only_one_has() {
        let place = Place::local();
        let registry = place.registry();
        publish(&place, &registry, "", "one", ("skill", 0.5));
        publish(&place, &registry, "", "two", ("error_mm", 0.5));
        let found = diff(&registry, "approach@1", "approach@2").unwrap().metrics;
        assert_eq!(found[0], compared("error_mm", [None, Some(0.5), None]));
        assert_eq!(found[2], compared("skill", [Some(0.5), None, None]));
    }

    #[test]
    fn what_cannot_be_compared_is_refused() {
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
