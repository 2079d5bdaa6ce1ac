//! `flowservo model show`: a version, and what is attached to it.

use super::model::{reference, told, warn};
use super::print_json;
use crate::output::out;
use anyhow::Result;
use registry::{Attachment, Entry, Evaluation, Location, Metric, ModelVersion, Registry};
use serde::Serialize;
use std::collections::BTreeMap;

/// What `--json` tells.
#[derive(Serialize)]
struct Shown {
    #[serde(flatten)]
    version: ModelVersion,
    metrics: BTreeMap<String, Metric>,
    attachments: Vec<Listed>,
}

/// Something that is attached.
#[derive(Serialize)]
struct Listed {
    #[serde(flatten)]
    entry: Entry,
    #[serde(skip_serializing_if = "Option::is_none")]
    signature: Option<Signed>,
    #[serde(skip_serializing_if = "Option::is_none")]
    evaluation: Option<Evaluation>,
}

#[derive(Serialize)]
struct Signed {
    key_hint: Option<String>,
}

/// Runs the command.
pub(crate) fn run(model: &str, location: &Location, json: bool) -> Result<()> {
    let registry = Registry::open(location)?;
    let version = registry.show(&reference(model)?)?;
    warn(&version);
    let metrics = registry.metrics(&version)?;
    let mut attachments = Vec::new();
    for entry in registry.attachments(&version)? {
        let mut listed = Listed { entry, signature: None, evaluation: None };
        match registry.attachment(&version, &listed.entry)? {
            Some(Attachment::Signature(signature)) => {
                listed.signature = Some(Signed { key_hint: signature.key_hint() });
            }
            Some(Attachment::Evaluation(evaluation)) => listed.evaluation = Some(evaluation),
            _ => {}
        }
        attachments.push(listed);
    }
    let shown = Shown { version, metrics, attachments };
    print(&shown);
    print_json(json, &shown)
}

fn print(shown: &Shown) {
    let ModelVersion { name, version: number, digest, manifest, .. } = &shown.version;
    out!("{name}@{number}  {digest}");
    if let Some(time) = manifest.created() {
        out!("  published {}", printable(time));
    }
    for layer in &manifest.layers {
        out!("  {:32} {:>12} bytes  {}", layer.path().unwrap_or("?"), layer.size, layer.digest);
    }
    for (dataset, digest) in &manifest.lineage.datasets {
        out!("  trained on {dataset}  {digest}");
    }
    if let Some(parent) = &manifest.lineage.parent {
        out!("  begun from {parent}");
    }
    for (metric, Metric { value, attachment, .. }) in &shown.metrics {
        let source = attachment.map_or(String::new(), |number| format!("  (attachment {number})"));
        out!("  {metric} = {value:.4}{source}");
    }
    let signatures = shown.attachments.iter().filter(|listed| listed.signature.is_some()).count();
    out!("  {signatures} {}", if signatures == 1 { "signature" } else { "signatures" });
    for Listed { entry, signature, evaluation } in &shown.attachments {
        let what = match (signature, evaluation) {
            (Some(Signed { key_hint }), _) => {
                format!("signature by key {}", key_hint.as_deref().unwrap_or("without a name"))
            }
            (None, Some(_)) => "evaluation".to_owned(),
            (None, None) => {
                let kind = entry.attached.as_ref().map_or("", |attached| &attached.media_type);
                format!("of a kind that this program does not know, {}", printable(kind))
            }
        };
        out!("  attachment {}: {what}{}", entry.number, told(&entry.remark));
    }
}

/// What others wrote, without what would steer the terminal.
fn printable(text: &str) -> String {
    text.chars().filter(|c| !c.is_control()).collect()
}
