//! `README.md` of a published model: a card whose front matter the Hugging Face Hub understands.

use std::collections::BTreeMap;
use std::fmt::Write as _;

use serde_json::Value;

use crate::registry::ModelVersion;

/// Name of the file.
pub(crate) const FILE: &str = "README.md";

/// The card of a version whose metrics have these values, under a license of the Hub's list (`apache-2.0`), if there is one.
pub(crate) fn text(version: &ModelVersion, values: &BTreeMap<String, f64>, license: Option<&str>) -> String {
    let mut text = front_matter(version, values, license);
    text += &introduction(version);
    text += &table("Metrics", ["metric", "value"], metrics(values));
    text += &table("Where it comes from", ["", ""], lineage(version));
    let mut interface = Vec::new();
    for (key, value) in &version.manifest.interface {
        leaves(key, value, &mut interface);
    }
    text + &table("What goes in and what comes out", ["", ""], interface)
}

fn front_matter(version: &ModelVersion, values: &BTreeMap<String, f64>, license: Option<&str>) -> String {
    let (name, manifest) = (&version.name, &version.manifest);
    let mut text = "---\n".to_owned();
    let mut line = |line: String| {
        text += &line;
        text.push('\n');
    };
    if let Some(license) = license {
        line(format!("license: {}", quoted(license)));
    }
    line("library_name: flowservo\npipeline_tag: robotics\ntags:\n- visual-servoing\n- robotics".to_owned());
    let datasets: Vec<String> = manifest.lineage.datasets.keys().map(|name| quoted(name)).collect();
    if !datasets.is_empty() {
        line(format!("datasets:\n- {}", datasets.join("\n- ")));
    }
    if !values.is_empty() {
        line(format!(
            "model-index:\n- name: {name}\n  results:\n  - task:\n      type: robotics\n      name: visual servoing"
        ));
        let dataset = quoted(&datasets.join(", ").replace('"', ""));
        line(format!("    dataset:\n      type: flowservo\n      name: {dataset}\n    metrics:"));
        for (metric, value) in values {
            line(format!(
                "    - type: {metric}\n      name: {}\n      value: {value:?}",
                metric.replace('_', " ")
            ));
        }
    }
    line("---\n".to_owned());
    text
}

fn introduction(version: &ModelVersion) -> String {
    let ModelVersion { name, version: number, digest, manifest, .. } = version;
    let created = manifest.created().map(|time| format!(", created {time}")).unwrap_or_default();
    format!(
        "# {name}\n\nVersion {number} of `{name}`{created}, with the manifest `{digest}`.\n\n\
         `config.json` says all that is needed to build the network; the weights are safetensors. With flowservo:\n\n\
         ```\n\
         flowservo model import FOLDER {name}      # every file is compared with its digest\n\
         flowservo model predict {name} IMAGE...\n\
         ```\n\n"
    )
}

fn metrics(values: &BTreeMap<String, f64>) -> Vec<[String; 2]> {
    values.iter().map(|(name, value)| [code(name), value.to_string()]).collect()
}

fn lineage(version: &ModelVersion) -> Vec<[String; 2]> {
    let lineage = &version.manifest.lineage;
    let mut rows = Vec::new();
    let mut row = |what: String, value: String| rows.push([what, code(&value)]);
    for (name, digest) in &lineage.datasets {
        row(format!("dataset {name}"), digest.to_string());
    }
    for (what, digest) in [("configuration", lineage.config), ("parent", lineage.parent)] {
        if let Some(digest) = digest {
            row(what.to_owned(), digest.to_string());
        }
    }
    let seed = lineage.seed.map(|seed| seed.to_string());
    let texts = [
        ("code revision", lineage.code_revision.clone()),
        ("seed", seed),
        ("device", lineage.device.clone()),
    ];
    for (what, value) in texts {
        if let Some(value) = value {
            row(what.to_owned(), value);
        }
    }
    for (name, version) in &lineage.software {
        row(name.clone(), version.clone());
    }
    rows
}

/// The single values below `value`, with their keys joined by dots; lists in a line.
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

/// A section with a table; nothing without rows.
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

/// A string that YAML reads as this string: JSON is a part of YAML.
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
    use crate::manifest::{Lineage, Provenance};

    #[test]
    fn says_what_the_manifest_says() {
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
        let card = text(published.version(), &published.version().manifest.metrics, Some("apache-2.0"));
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
            &published.version().digest.to_string(),
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
