//! `flowservo model diff`: the differences between two versions.

use crate::commands::lookup::{reference, warn};
use crate::output::{out, print_json};
use anyhow::Result;
use registry::{Change, MetricChange, Registry};
use std::fmt::Display;

/// Runs the command.
pub(crate) fn run(registry: &Registry, from: &str, to: &str, json: bool) -> Result<()> {
    let found = registry.diff(&reference(from)?, &reference(to)?)?;
    for (mark, version) in [("-", &found.from), ("+", &found.to)] {
        warn(version);
        out!("{mark} {version}  {}", version.digest);
    }
    section("configuration", &found.configuration);
    out!("metrics");
    for MetricChange { metric, from, to, difference, .. } in &found.metrics {
        let value = |value: &Option<f64>| value.map_or("-".into(), |value| format!("{value:.4}"));
        let difference = difference.map_or(String::new(), |value| format!("{value:+.4}"));
        out!("  {metric:40} {:>12} {:>12} {difference:>12}", value(from), value(to));
    }
    section("lineage", &found.lineage);
    section("files", &found.files);
    print_json(json, &found)
}

fn section<T: Display>(title: &str, changes: &[Change<T>]) {
    if changes.is_empty() {
        out!("{title}: the same");
        return;
    }
    out!("{title}");
    for Change { key, from, to } in changes {
        for (mark, value) in [("-", from), ("+", to)] {
            if let Some(value) = value {
                out!("  {mark} {key:40} {value}");
            }
        }
    }
}
