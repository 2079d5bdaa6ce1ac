//! Model cards: the `README.md` of an exported model, with front matter for the Hugging Face Hub.

use std::collections::BTreeMap;

use serde_json::{Value, json};

use crate::model::ModelVersion;
use crate::operations::diff::flattened;

/// Name of the file.
pub(super) const FILE: &str = "README.md";

/// Writes the card of a version. `values` are those of its metrics, and `license` is one of the Hub's list (`apache-2.0`).
pub(super) fn text(version: &ModelVersion, values: &BTreeMap<String, f64>, license: Option<&str>) -> String {
    let ModelVersion { name, version: number, digest, manifest, .. } = version;
    let created = manifest.created().map(|time| format!(", created {time}")).unwrap_or_default();
    let metrics = table("Metrics", ["metric", "value"], json!(values));
    let lineage = table("Lineage", ["", ""], json!(manifest.lineage));
    let interface = table("Inputs and outputs", ["", ""], json!(manifest.interface));
    let front_matter = front_matter(version, values, license);
    format!(
        "{front_matter}# {name}\n\nVersion {number} of `{name}`{created}, with the manifest `{digest}`.\n\n\
         `config.json` has everything that is needed to build the network. The weights are safetensors. With flowservo:\n\n\
         ```\n\
         flowservo model import FOLDER {name}      # verifies every file\n\
         flowservo model predict {name} IMAGE...\n\
         ```\n\n\
         {metrics}{lineage}{interface}"
    )
}

fn front_matter(version: &ModelVersion, values: &BTreeMap<String, f64>, license: Option<&str>) -> String {
    let license = license.map(|license| format!("license: {}\n", quoted(license))).unwrap_or_default();
    let names: Vec<_> = version.manifest.lineage.datasets.keys().map(|name| quoted(name)).collect();
    let datasets =
        if names.is_empty() { String::new() } else { format!("datasets:\n- {}\n", names.join("\n- ")) };
    let metric = |(metric, value): (&String, &f64)| {
        let name = metric.replace('_', " ");
        format!("    - type: {metric}\n      name: {name}\n      value: {value:?}\n")
    };
    let mut results: String = values.iter().map(metric).collect();
    if !values.is_empty() {
        let (name, dataset) = (&version.name, quoted(&names.join(", ").replace('"', "")));
        results = format!(
            "model-index:\n- name: {name}\n  results:\n  - task:\n      type: robotics\n      name: visual servoing\n    \
             dataset:\n      type: flowservo\n      name: {dataset}\n    metrics:\n{results}"
        );
    }
    format!(
        "---\n{license}library_name: flowservo\npipeline_tag: robotics\ntags:\n- visual-servoing\n- robotics\n{datasets}{results}\
         ---\n\n"
    )
}

/// Writes a section with the values of a document, or nothing if it is empty.
fn table(title: &str, [left, right]: [&str; 2], document: Value) -> String {
    let cell = |text: &str| text.replace('|', "\\|").replace('\n', " ");
    let row = |(key, value): (String, Value)| {
        let value = value.as_str().map_or_else(|| value.to_string(), str::to_owned);
        format!("| `{}` | {} |\n", cell(&key), cell(&value))
    };
    let rows: String = flattened(document).into_iter().map(row).collect();
    if rows.is_empty() { rows } else { format!("## {title}\n\n| {left} | {right} |\n|---|---|\n{rows}\n") }
}

/// Quotes a string for YAML, of which JSON is a part.
fn quoted(text: &str) -> String {
    Value::from(text).to_string()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::digest::Digest;
    use crate::fixture::Place;
    use crate::model::{Lineage, Provenance};

    #[test]
    fn includes_what_the_manifest_states() {
        let place = Place::local();
        let provenance = Provenance {
            lineage: Lineage {
                datasets: BTreeMap::from([("a: 1".into(), Digest::of(b"a"))]),
                seed: Some(7),
                software: BTreeMap::from([("burn".into(), "0.22.1".into())]),
                ..Lineage::default()
            },
            metrics: BTreeMap::from([("table1_position_norm_mm".into(), 4.5), ("whole".into(), 2.0)]),
            interface: BTreeMap::from([(
                "input".into(),
                serde_json::json!({ "width": 128, "images": ["a|b"] }),
            )]),
            created: Some("2026-11-22T10:00:00Z".into()),
            ..Provenance::default()
        };
        let name = "approach".parse().unwrap();
        let registry = place.registry();
        let published = registry.publish(&name, &place.checkpoint("checkpoint", b"w"), provenance).unwrap();
        let card = text(published.value(), &published.value().manifest.metrics, Some("apache-2.0"));
        let (front, body) = card.strip_prefix("---\n").unwrap().split_once("\n---\n").unwrap();
        for line in [
            "license: \"apache-2.0\"",
            "library_name: flowservo",
            "- \"a: 1\"",
            "    - type: table1_position_norm_mm",
            "      value: 4.5",
            "      value: 2.0",
        ] {
            assert!(front.lines().any(|found| found == line), "{line} in\n{front}");
        }
        for part in [
            "# approach\n",
            &published.value().digest.to_string(),
            "| `table1_position_norm_mm` | 4.5 |",
            "| `seed` | 7 |",
            "| `software.burn` | 0.22.1 |",
            "| `input.width` | 128 |",
            "| `input.images` | [\"a\\|b\"] |",
            "2026-11-22T10:00:00Z",
        ] {
            assert!(body.contains(part), "{part} in\n{body}");
        }
        let bare = text(&place.publish(&registry, "bare", b"w"), &BTreeMap::new(), None);
        assert!(
            !bare.contains("license") && !bare.contains("model-index") && !bare.contains("## Metrics"),
            "{bare}"
        );
    }
}
