//! Metrics of an evaluated system for programs, as JSON and CSV. Keys are flat and end in their unit.

use super::distribution::Distribution;
use super::pose_variable::{DEGREES, MILLIMETERS, POSE_VARIABLES, Unit};
use super::published::{Published, definet, proposed_method};
use super::system::System;
use crate::session::timing::StageSeconds;
use serde_json::{Map, Value, json};
use std::fmt::Write;

const MS_PER_STEP: &str = "ms_per_step";

/// Converts seconds to milliseconds.
pub(super) fn to_ms(seconds: f64) -> f64 {
    seconds * 1e3
}

/// Returns mean, RMS, median, 95th percentile and maximum in a unit.
pub(super) fn statistics(d: &Distribution, unit: Unit) -> [f64; 5] {
    [d.mean, d.root_mean_square, d.median, d.percentile_95, d.maximum].map(unit.from_si)
}

/// Returns the paper's two norms with their keys.
fn norm_values(position: f64, orientation: f64) -> Vec<(String, f64)> {
    [("position", MILLIMETERS, position), ("orientation", DEGREES, orientation)]
        .map(|(name, Unit { name: unit, from_si }, norm)| (format!("{name}_norm_{unit}"), from_si(norm)))
        .to_vec()
}

/// Returns one statistic of the six pose variables with their keys.
fn axis_values(statistic: &str, values: [f64; 6]) -> Vec<(String, f64)> {
    let axes = POSE_VARIABLES.iter().zip(values);
    axes.map(|(v, value)| (format!("{}_{statistic}_{}", v.key, v.unit.name), (v.unit.from_si)(value)))
        .collect()
}

/// Returns all metrics of a system with their keys, in a fixed order.
fn values(System { accuracy: a, outcomes: c, .. }: &System) -> Vec<(String, f64)> {
    let mut values = vec![("sessions".into(), c.sessions as f64)];
    values.extend(norm_values(a.position_norm(), a.orientation_norm()));
    values.extend(axis_values("mean", a.axes.map(|d| d.mean)));
    values.extend(axis_values("std", a.axes.map(|d| d.standard_deviation)));
    for (name, d, [low, high], in_unit) in [
        ("position", &a.position, a.position_norm_interval, MILLIMETERS),
        ("orientation", &a.orientation, a.orientation_norm_interval, DEGREES),
    ] {
        let Unit { name: unit, from_si } = in_unit;
        values.push((format!("{name}_norm_low_{unit}"), from_si(low)));
        values.push((format!("{name}_norm_high_{unit}"), from_si(high)));
        let names = ["mean", "rms", "median", "p95", "max"];
        let pairs = names.iter().zip(statistics(d, in_unit));
        values.extend(pairs.map(|(statistic, value)| (format!("{name}_{statistic}_{unit}"), value)));
    }
    values.extend(c.counts().into_iter().map(|(name, count)| (format!("{name}_rate"), c.share(count))));
    for (statistic, value) in
        [("mean", c.iterations.mean), ("median", c.iterations.median), ("max", c.iterations.maximum)]
    {
        values.push((format!("iterations_{statistic}"), value));
    }
    for (stage, seconds) in StageSeconds::NAMES.iter().zip(c.seconds_per_step) {
        values.push((format!("{MS_PER_STEP}_{stage}"), to_ms(seconds)));
    }
    values.push((format!("{MS_PER_STEP}_total"), to_ms(c.seconds_per_step.iter().sum())));
    rounded(values)
}

/// Returns the metrics that the paper publishes, with their keys.
fn published_values(paper: &Published) -> Vec<(String, f64)> {
    let mut values = norm_values(paper.position_norm, paper.orientation_norm);
    values.extend(paper.sessions.map(|n| ("sessions".into(), n as f64)));
    values.extend(paper.mean.into_iter().flat_map(|axes| axis_values("mean", axes)));
    values.extend(paper.standard_deviation.into_iter().flat_map(|axes| axis_values("std", axes)));
    values.extend(paper.seconds_per_step.map(|s| (format!("{MS_PER_STEP}_total"), to_ms(s))));
    rounded(values)
}

/// Rounds to nine decimals, so that 4.5 mm in meters does not become 4.500000000000001 mm.
fn rounded(values: Vec<(String, f64)>) -> Vec<(String, f64)> {
    values.into_iter().map(|(key, value)| (key, (value * 1e9).round() / 1e9)).collect()
}

/// Returns the metrics of a system as one JSON object with its name under `system`. `ms_per_step` is an object by stage. An
/// undefined statistic, such as the standard deviation of a single session, is `null`.
pub fn to_json(system: &System) -> Value {
    object(&system.name, &values(system))
}

fn object(name: &str, values: &[(String, f64)]) -> Value {
    let mut object = Map::from_iter([("system".to_owned(), json!(name))]);
    let mut times = Map::new();
    for (key, value) in values {
        match key.strip_prefix(MS_PER_STEP) {
            Some(stage) => times.insert(stage.trim_start_matches('_').to_owned(), json!(value)),
            None if key == "sessions" => object.insert(key.clone(), json!(*value as usize)),
            None => object.insert(key.clone(), json!(value)),
        };
    }
    object.insert(MS_PER_STEP.to_owned(), Value::Object(times));
    Value::Object(object)
}

/// Returns the metrics of all systems and of the paper: `{"systems": [...], "published": [...]}`.
pub fn all_to_json(systems: &[System]) -> Value {
    let published = [proposed_method(), definet()];
    json!({
        "systems": systems.iter().map(to_json).collect::<Vec<_>>(),
        "published": published.iter().map(|p| object(p.name, &published_values(p))).collect::<Vec<_>>(),
    })
}

/// Returns a CSV table with one row per system, followed by the paper's. Undefined and unpublished metrics are empty cells.
pub fn to_csv(systems: &[System]) -> String {
    let published = [proposed_method(), definet()];
    let rows: Vec<(&str, Vec<(String, f64)>)> = systems
        .iter()
        .map(|s| (s.name.as_str(), values(s)))
        .chain(published.iter().map(|p| (p.name, published_values(p))))
        .collect();
    let mut header: Vec<&String> = Vec::new();
    for (key, _) in rows.iter().flat_map(|(_, values)| values) {
        if !header.contains(&key) {
            header.push(key);
        }
    }
    let mut text =
        format!("system,{}\n", header.iter().map(|key| key.as_str()).collect::<Vec<_>>().join(","));
    for (name, values) in &rows {
        let _ = write!(text, "\"{}\"", name.replace('"', "\"\""));
        for key in &header {
            let value = values.iter().find(|(k, v)| k == *key && v.is_finite());
            text.push(',');
            text += &value.map_or_else(String::new, |(_, v)| v.to_string());
        }
        text.push('\n');
    }
    text
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;
    use crate::fixture::session;

    /// A system with four sessions, whose final errors in x are 0.2, 0.4, 0.6 and 0.8 mm.
    pub(crate) fn system(name: &str) -> System {
        System::of(name, &(0..4).map(session).collect::<Vec<_>>())
    }

    fn number(object: &Value, key: &str) -> f64 {
        object[key].as_f64().unwrap_or(f64::NAN)
    }

    #[test]
    fn keys_carry_their_units() {
        let object = to_json(&system("s"));
        let close = |key: &str, expected: f64| {
            assert!((number(&object, key) - expected).abs() < 1e-9, "{key}: {}", number(&object, key));
        };
        close("sessions", 4.0);
        close("position_norm_mm", 0.5);
        close("x_mean_mm", 0.5);
        close("x_std_mm", (0.2f64 / 3.0).sqrt());
        close("position_median_mm", 0.5);
        close("position_max_mm", 0.8);
        close("orientation_norm_deg", 0.0);
        close("converged_rate", 1.0);
        close("iterations_mean", 13.5);
        assert!((number(&object["ms_per_step"], "approach") - 20.0).abs() < 1e-9);
        assert!((number(&object["ms_per_step"], "total") - 35.21).abs() < 1e-9);
    }

    #[test]
    fn csv_and_json_agree() {
        let system = system("a \"quoted\", name");
        let csv = to_csv(std::slice::from_ref(&system));
        let mut lines = csv.lines();
        let keys: Vec<&str> = lines.next().unwrap().split(',').skip(1).collect();
        let row = lines.next().unwrap().strip_prefix("\"a \"\"quoted\"\", name\",").unwrap();
        let object = to_json(&system);
        assert_eq!(row.split(',').count(), keys.len());
        for (key, cell) in keys.iter().zip(row.split(',')) {
            let value = match key.strip_prefix("ms_per_step_") {
                Some(stage) => number(&object["ms_per_step"], stage),
                None => number(&object, key),
            };
            assert_eq!(cell, value.to_string(), "{key}");
        }
        let paper = lines.next().unwrap();
        assert!(paper.starts_with("\"the paper\",40,4.5,1.6,1.72,3.21,2.61,1.42,0.72,0.33,1.35,"), "{paper}");
        assert!(lines.next().unwrap().starts_with("\"the paper's DEFINet\",,12.4,3.8,,"));
    }

    #[test]
    fn a_single_session_has_no_deviation() {
        let single = System::of("s", &[session(0)]);
        assert!(to_json(&single)["x_std_mm"].is_null());
        assert!(to_csv(&[single]).lines().nth(1).unwrap().contains(",,"));
    }
}
