//! `report.html`: the results of `reproduce` on one page.

use super::config::SystemConfig;
use super::results::ExperimentResults;
use crate::commands::train;
use crate::file::write_file;
use ::eval::results::published::proposed_method;
use ::eval::results::system::System;
use ::eval::{Outcome, SessionRecord};
use ::report::drawing::figure::Figure;
use ::report::figures::avoidance_maps::{AvoidanceExample, figure_6};
use ::report::figures::final_poses::figure_9;
use ::report::figures::pose_error::figure_8;
use ::report::figures::snapshots::{self, figure_7};
use ::report::page::Report;
use ::report::page::sessions::SessionGroup;
use ::report::training_curves::training_curves;
use ::train::AvoidModel;
use anyhow::Result;
use burn::prelude::Device;
use datagen::Kind;
use std::path::Path;
use world::units::{to_deg, to_mm};
use world::{AvoidanceMap, Environment};

/// Writes the page.
pub(crate) fn write(preset: &str, reproduced: &ExperimentResults, device: &Device, out: &Path) -> Result<()> {
    let report = Report {
        title: "Visual servoing in a virtual environment: a reproduction".to_owned(),
        summary: summary(preset, reproduced),
        facts: facts(preset, reproduced),
        stages: reproduced.stages.clone(),
        systems: reproduced.systems.iter().map(|(system, _)| system.clone()).collect(),
        figures: figures(reproduced, device)?,
        sessions: reproduced.systems.iter().map(|(s, records)| SessionGroup::of(&s.name, records)).collect(),
        settings: vec![("config.toml".to_owned(), toml::to_string(&reproduced.config)?)],
    };
    write_file(&out.join("report.html"), report.to_html())
}

fn summary(preset: &str, reproduced: &ExperimentResults) -> Vec<String> {
    let rows: u64 = reproduced.datasets.iter().map(|dataset| dataset.rows).sum();
    let mut paragraphs = vec![format!(
        "The preset {preset} generated {} datasets with {rows} examples, trained {} networks, and ran the servo sessions of \
         Section 6.4, with random targets, up to {} obstacles, the start in Range 1, and the goal near the reference 80 mm above \
         the target. The tables show the paper's results beside those of this run. The means include all sessions.",
        reproduced.datasets.len(),
        reproduced.trained.len(),
        reproduced.config.evaluation.obstacles.count[1]
    )];
    if let Some((System { name, accuracy, outcomes }, _)) = reproduced.systems.first() {
        let paper = proposed_method();
        paragraphs.push(format!(
            "In {} sessions, {name} ended {:.2} mm and {:.2} degrees from the goal. These are norms of the mean errors, as in the \
             paper, which reports {:.1} mm and {:.1} degrees. The median distance is {:.2} mm. Sessions that ended in a \
             collision: {}.",
            outcomes.sessions,
            to_mm(accuracy.position_norm()),
            to_deg(accuracy.orientation_norm()),
            to_mm(paper.position_norm),
            to_deg(paper.orientation_norm),
            to_mm(accuracy.position.median),
            outcomes.count(Outcome::Collided)
        ));
    }
    paragraphs
}

fn facts(preset: &str, reproduced: &ExperimentResults) -> Vec<(String, String)> {
    let camera = &reproduced.config.evaluation.world.camera;
    let facts = [
        ("preset", preset.to_owned()),
        ("flowservo", env!("CARGO_PKG_VERSION").to_owned()),
        ("device", reproduced.device.clone()),
        ("images", format!("{} x {} pixels", camera.width, camera.height)),
        ("seed of the sessions", reproduced.config.evaluation.seed.to_string()),
    ];
    facts.into_iter().map(|(name, value)| (name.to_owned(), value)).collect()
}

fn figures(reproduced: &ExperimentResults, device: &Device) -> Result<Vec<Figure>> {
    let mut drawn = training_figures(reproduced)?;
    let environment = Environment::new(&reproduced.config.evaluation.world)?;
    let (Some(system), Some((_, records))) = (reproduced.config.systems.first(), reproduced.systems.first())
    else {
        return Ok(drawn);
    };
    let examples = avoidance_examples(reproduced, system, &environment, records, device)?;
    if !examples.is_empty() {
        drawn.push(figure_6(&examples, &environment.measuring_points)?);
    }
    if let Some(record) = snapshots::example(records) {
        drawn.push(figure_7(&environment, record)?);
        drawn.push(figure_8(record));
    }
    drawn.push(figure_9(&environment, &records[..records.len().min(5)])?);
    Ok(drawn)
}

/// Draws one figure per kind of network, since their losses are not comparable.
fn training_figures(reproduced: &ExperimentResults) -> Result<Vec<Figure>> {
    let mut drawn = Vec::new();
    for (kind, label) in
        [(Kind::Approach, "Training of CNN_approach"), (Kind::Avoidance, "Training of CNN_avoid")]
    {
        let mut curves = Vec::new();
        for (name, (folder, trained)) in &reproduced.trained {
            if reproduced.config.training[name].kind == kind {
                curves.push(train::curve(name, folder, trained)?);
            }
        }
        if !curves.is_empty() {
            drawn.push(training_curves(label, &curves));
        }
    }
    Ok(drawn)
}

/// Returns the predictions of `CNN_avoid` at the start of the first sessions with obstacles, with ground truth.
fn avoidance_examples(
    reproduced: &ExperimentResults,
    system: &SystemConfig,
    environment: &Environment,
    records: &[SessionRecord],
    device: &Device,
) -> Result<Vec<AvoidanceExample>> {
    let Some((_, trained)) = reproduced.trained.get(&system.avoid) else { return Ok(Vec::new()) };
    let model = AvoidModel::load(&trained.checkpoint, device)?;
    let with_obstacles = records.iter().filter(|record| !record.scene.obstacles.is_empty());
    let example = |record: &SessionRecord| -> Result<AvoidanceExample> {
        let robot_from_hand = record.robot_from_start;
        let image = environment.wrist_image(&record.scene, &robot_from_hand);
        let predicted: AvoidanceMap = model.avoidance_map(&image)?;
        let truth = environment.avoidance_map(&record.scene, &robot_from_hand);
        Ok(AvoidanceExample { image, robot_from_hand, predicted, truth })
    };
    with_obstacles.take(3).map(example).collect()
}
