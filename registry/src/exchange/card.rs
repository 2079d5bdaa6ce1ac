//! Model cards: the `README.md` of an exported model, with front matter for the Hugging Face Hub.

use std::collections::BTreeMap;
use std::fmt::Write as _;

use serde_json::Value;

use crate::model::ModelVersion;

/// Name of the file.
pub(super) const FILE: &str = "README.md";

/// Writes the card of a version. `values` are those of its metrics, and `license` is one of the Hub's list (`apache-2.0`).
pub(super) fn text(version: &ModelVersion, values: &BTreeMap<String, f64>, license: Option<&str>) -> String {
    let ModelVersion { name, version: number, digest, manifest, .. } = version;
    let created = manifest.created().map(|time| format!(", created {time}")).unwrap_or_default();
    let metrics = values.iter().map(|(name, value)| [code(name), value.to_string()]).collect();
    let mut interface = Vec::new();
    for (key, value) in &manifest.interface {
        leaves(key, value, &mut interface);
    }
    let metrics = table("Metrics", ["metric", "value"], metrics);
    let lineage = table("Lineage", ["", ""], lineage(version));
    let interface = table("Inputs and outputs", ["", ""], interface);
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
    let names: Vec<String> = version.manifest.lineage.datasets.keys().map(|name| quoted(name)).collect();
    let (mut datasets, mut results) = (String::new(), String::new());
    if !names.is_empty() {
        datasets = format!("datasets:\n- {}\n", names.join("\n- "));
    }
    if !values.is_empty() {
        let metric = |(metric, value): (&String, &f64)| {
            let name = metric.replace('_', " ");
            format!("    - type: {metric}\n      name: {name}\n      value: {value:?}\n")
        };
        let metrics: Vec<_> = values.iter().map(metric).collect();
        let (name, dataset) = (&version.name, quoted(&names.join(", ").replace('"', "")));
        results = format!(
            "model-index:\n- name: {name}\n  results:\n  - task:\n      type: robotics\n      name: visual servoing\n    \
             dataset:\n      type: flowservo\n      name: {dataset}\n    metrics:\n{}",
            metrics.concat()
        );
    }
    format!(
        "---\n{license}library_name: flowservo\npipeline_tag: robotics\ntags:\n- visual-servoing\n- robotics\n{datasets}{results}\
         ---\n\n"
    )
}

fn lineage(version: &ModelVersion) -> Vec<[String; 2]> {
    let lineage = &version.manifest.lineage;
    let datasets =
        lineage.datasets.iter().map(|(name, digest)| (format!("dataset {name}"), digest.to_string()));
    let facts = [
        ("configuration", lineage.config.map(|digest| digest.to_string())),
        ("parent", lineage.parent.map(|digest| digest.to_string())),
        ("code revision", lineage.code_revision.clone()),
        ("seed", lineage.seed.map(|seed| seed.to_string())),
        ("device", lineage.device.clone()),
    ];
    let facts = facts.into_iter().filter_map(|(what, value)| Some((what.to_owned(), value?)));
    let software = lineage.software.iter().map(|(name, version)| (name.clone(), version.clone()));
    datasets.chain(facts).chain(software).map(|(what, value)| [what, code(&value)]).collect()
}

/// Collects the scalars below `value`, with their keys joined by dots. A list is one scalar.
fn leaves(key: &str, value: &Value, rows: &mut Vec<[String; 2]>) {
    match value {
        Value::Object(object) => {
            for (inner, value) in object {
                leaves(&format!("{key}.{inner}"), value, rows);
            }
        }
        Value::String(text) => rows.push([code(key), cell(text)]),
        other => rows.push([code(key), cell(&other.to_string())]),
    }
}

/// Writes a section with a table, or nothing if there are no rows.
fn table(title: &str, header: [&str; 2], rows: Vec<[String; 2]>) -> String {
    if rows.is_empty() {
        return String::new();
    }
    let mut text = format!("## {title}\n\n| {} | {} |\n|---|---|\n", header[0], header[1]);
    for [left, right] in rows {
        // Writing to a string cannot fail.
        let _ = writeln!(text, "| {left} | {right} |");
    }
    text.push('\n');
    text
}

/// Quotes a string for YAML, of which JSON is a part.
fn quoted(text: &str) -> String {
    Value::from(text).to_string()
}

fn cell(text: &str) -> String {
    text.replace('|', "\\|").replace('\n', " ")
}

fn code(text: &str) -> String {
    format!("`{}`", cell(text))
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
            "| seed | `7` |",
            "| burn | `0.22.1` |",
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
