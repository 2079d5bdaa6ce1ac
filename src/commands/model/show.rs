//! `flowservo model show`: a version and its attachments.

use crate::commands::lookup::{describe, reference, warn};
use crate::output::{out, print_json};
use anyhow::Result;
use registry::{Attachment, Evaluation, Event, Lineage, Location, Metric, ModelVersion, Registry};
use serde::Serialize;
use std::collections::BTreeMap;

/// Output of `--json`.
#[derive(Serialize)]
struct Shown {
    #[serde(flatten)]
    version: ModelVersion,
    metrics: BTreeMap<String, Metric>,
    attachments: Vec<Listed>,
}

/// An attachment.
#[derive(Serialize)]
struct Listed {
    #[serde(flatten)]
    event: Event,
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
    for event in registry.attachments(&version)? {
        let mut listed = Listed { event, signature: None, evaluation: None };
        match registry.attachment(&version, &listed.event)? {
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
    if let Some(purpose) = manifest.interface.get("purpose").and_then(|purpose| purpose.as_str()) {
        out!("  {}", printable(purpose));
    }
    if let Some(time) = manifest.created() {
        out!("  published {}", printable(time));
    }
    for layer in &manifest.layers {
        out!("  {:32} {:>12} bytes  {}", layer.path().unwrap_or("?"), layer.size, layer.digest);
    }
    for (dataset, digest) in &manifest.lineage.datasets {
        out!("  trained on {}  {digest}", printable(dataset));
    }
    if let Some(parent) = &manifest.lineage.parent {
        out!("  started from {parent}");
    }
    if let Some(circumstances) = circumstances(&manifest.lineage) {
        out!("  trained {}", printable(&circumstances));
    }
    for (metric, Metric { value, attachment, .. }) in &shown.metrics {
        let source = attachment.map_or(String::new(), |number| format!("  (attachment {number})"));
        out!("  {} = {value:.4}{source}", printable(metric));
    }
    match shown.attachments.iter().filter(|listed| listed.signature.is_some()).count() {
        0 => out!("  not signed"),
        1 => out!("  1 signature"),
        signatures => out!("  {signatures} signatures"),
    }
    for Listed { event, signature, evaluation } in &shown.attachments {
        let what = match (signature, evaluation) {
            (Some(Signed { key_hint }), _) => {
                format!("signature by key {}", key_hint.as_deref().unwrap_or("without a hint"))
            }
            (None, Some(_)) => "evaluation".to_owned(),
            (None, None) => {
                let kind = event.attached.as_ref().map_or("", |attached| &attached.media_type);
                format!("of unknown type {}", printable(kind))
            }
        };
        out!("  attachment {}: {what}{}", event.number, describe(&event.note));
    }
}

/// Describes the training, as far as it is known.
fn circumstances(lineage: &Lineage) -> Option<String> {
    let Lineage { seed, device, software, code_revision, .. } = lineage;
    let seed = seed.map(|seed| format!("with seed {seed}"));
    let device = device.as_ref().map(|device| format!("on {device}"));
    let software = software.iter().map(|(name, version)| format!("{name} {version}"));
    let revision = code_revision.as_ref().map(|revision| format!("revision {revision}"));
    let known: Vec<_> = seed.into_iter().chain(device).chain(software).chain(revision).collect();
    (!known.is_empty()).then(|| known.join(", "))
}

/// Removes control characters, which could manipulate the terminal, from a text that others wrote.
fn printable(text: &str) -> String {
    text.chars().filter(|c| !c.is_control()).collect()
}
