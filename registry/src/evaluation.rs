//! Evaluations: how good a version is, measured after it was published.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};
use serde_json::Value;

use crate::attachment::{Attachment, EVALUATION, of_kind};
use crate::error::{Error, Result};
use crate::registry::{ModelVersion, Registry};

/// How good a version is, and how that was measured: a JSON document that is attached to the version.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct Evaluation {
    /// Name, with its unit as the last part, and finite value.
    pub metrics: BTreeMap<String, f64>,
    /// With what it was measured, in the evaluator's words: enough to measure it again.
    pub configuration: BTreeMap<String, Value>,
}

/// One number that says how good a version is.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
#[non_exhaustive]
pub struct Metric {
    /// The number.
    pub value: f64,
    /// Number of the attachment that says so; none if the version's own manifest does.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub attachment: Option<u64>,
}

impl Evaluation {
    /// Refuses what says nothing, and what JSON cannot hold.
    pub(crate) fn check(&self, version: &ModelVersion) -> Result<()> {
        if self.metrics.is_empty() {
            let reason = "the evaluation has no metrics".to_owned();
            return Err(Error::Attachment { model: version.to_string(), reason });
        }
        match self.metrics.iter().find(|(_, value)| !value.is_finite()) {
            Some((name, &value)) => Err(Error::Metric { name: name.clone(), value }),
            None => Ok(()),
        }
    }
}

impl Registry {
    /// How good `version` is: what its manifest says and, in the place of that, what the evaluation says that was attached last.
    pub fn metrics(&self, version: &ModelVersion) -> Result<BTreeMap<String, Metric>> {
        let metric = |attachment| move |(name, value)| (name, Metric { value, attachment });
        let mut metrics: BTreeMap<_, _> =
            version.manifest.metrics.clone().into_iter().map(metric(None)).collect();
        let entries = self.attachments(version)?;
        if let Some(newest) = of_kind(&entries, EVALUATION).next_back()
            && let Some(Attachment::Evaluation(evaluation)) = self.attachment(version, newest)?
        {
            metrics.extend(evaluation.metrics.into_iter().map(metric(Some(newest.number))));
        }
        Ok(metrics)
    }

    /// The values of [`metrics`](Self::metrics).
    pub(crate) fn values(&self, version: &ModelVersion) -> Result<BTreeMap<String, f64>> {
        Ok(self.metrics(version)?.into_iter().map(|(name, metric)| (name, metric.value)).collect())
    }
}

#[cfg(test)]
mod tests {
    use std::fs;

    use super::*;
    use crate::fixture::{Place, evaluation, flip, model};
    use crate::log::Remark;
    use crate::manifest::Provenance;
    use crate::store::blob_key;

    #[test]
    fn the_newest_goes_before_the_manifest() {
        for place in Place::all() {
            let registry = place.registry();
            let metrics = BTreeMap::from([("loss".to_owned(), 0.5), ("error_mm".to_owned(), 4.0)]);
            let provenance = Provenance { metrics, ..Provenance::default() };
            let checkpoint = place.checkpoint("run", b"weights");
            let published = registry.publish(&model("approach"), &checkpoint, provenance).unwrap();
            let version = published.version();
            let told = || {
                let metrics = registry.metrics(version).unwrap();
                metrics.into_iter().map(|(name, m)| (name, m.value, m.attachment)).collect::<Vec<_>>()
            };
            let manifest = ("loss".to_owned(), 0.5, None);
            assert_eq!(told(), [("error_mm".to_owned(), 4.0, None), manifest.clone()]);
            for (number, value) in [(1, 3.0), (2, 2.0)] {
                registry.attach(version, &evaluation("error_mm", value), &Remark::default()).unwrap();
                assert_eq!(told(), [("error_mm".to_owned(), value, Some(number)), manifest.clone()]);
            }
            // Of what only an older evaluation says nothing is told: it was another measurement.
            registry.attach(version, &evaluation("skill", 0.75), &Remark::default()).unwrap();
            let expected =
                [("error_mm".to_owned(), 4.0, None), manifest, ("skill".to_owned(), 0.75, Some(3))];
            assert_eq!(told(), expected);
        }
    }

    #[test]
    fn card_and_difference_have_it() {
        let place = Place::local();
        let registry = place.registry();
        let version = place.publish(&registry, "approach", b"one");
        place.publish(&registry, "approach", b"two");
        registry.attach(&version, &evaluation("error_mm", 2.5), &Remark::default()).unwrap();
        let (one, two) = ("approach@1".parse().unwrap(), "approach@2".parse().unwrap());
        let compared = registry.diff(&one, &two).unwrap().metrics;
        assert_eq!(
            (compared[0].metric.as_str(), compared[0].from, compared[0].to),
            ("error_mm", Some(2.5), None)
        );
        registry.export_huggingface(&one, &place.path("hub"), None).unwrap();
        let card = fs::read_to_string(place.path("hub/README.md")).unwrap();
        assert!(card.contains("type: error_mm") && card.contains("| `error_mm` | 2.5 |"), "{card}");
    }

    /// A damaged evaluation is told, and the version is delivered all the same: its files are intact.
    #[test]
    fn a_damaged_evaluation_keeps_nobody_from_the_files() {
        let place = Place::local();
        let registry = place.registry();
        let version = place.publish(&registry, "approach", b"one");
        let attached = registry.attach(&version, &evaluation("x", 1.0), &Remark::default()).unwrap();
        let digest = attached.entry().attached.as_ref().unwrap().digest;
        flip(&place.path("registry"), &blob_key(digest));
        assert!(matches!(registry.metrics(&version), Err(Error::Damaged(_))));
        registry.pull(&"approach".parse().unwrap(), &place.path("pulled")).unwrap();
    }
}
