//! `flowservo model predict`: the output of a network for image files.

use crate::device::{self, DeviceChoice};
use crate::error::bad_input;
use crate::output::{out, print_json};
use anyhow::{Context, Result, anyhow};
use image::RgbImage;
use std::path::{Path, PathBuf};
use train::{ApproachModel, AvoidModel, ModelInfo, Task};
use world::units::{to_deg, to_mm};

/// Runs the command.
pub(crate) fn run(model: &Path, images: &[PathBuf], json: bool) -> Result<()> {
    let device = device::open(DeviceChoice::Cpu)?.device;
    let pictures = images.iter().map(|path| read(path)).collect::<Result<Vec<_>>>()?;
    match (&ModelInfo::read(model)?.task, pictures.as_slice()) {
        (Task::Approach { label, .. }, [current, goal]) => {
            let change = ApproachModel::load(model, &device)?.pose_change(current, goal)?;
            let [x, y, z, phi, theta, psi] = change.to_array();
            let [x, y, z] = [x, y, z].map(to_mm);
            let [phi, theta, psi] = [phi, theta, psi].map(to_deg);
            out!("translation  {x:9.3} {y:9.3} {z:9.3} mm");
            out!("rotation     {phi:9.3} {theta:9.3} {psi:9.3} degrees");
            print_json(json, &serde_json::json!({ "label": label, "pose_change": change.to_array() }))
        }
        (Task::Avoidance { .. }, [current]) => {
            let map = AvoidModel::load(model, &device)?.avoidance_map(current)?;
            let risk = map.values.iter().sum::<f64>() / map.values.len() as f64;
            let greatest = map.values.iter().copied().fold(0.0, f64::max);
            out!("{} directions, risk {risk:.3} on average, {greatest:.3} at most", map.values.len());
            print_json(json, &serde_json::json!({ "avoidance_map": map.values }))
        }
        (task, _) => {
            let needed = match task {
                Task::Approach { .. } => "CNN_approach, which needs two images: current and goal",
                Task::Avoidance { .. } => "CNN_avoid, which needs one image",
            };
            Err(bad_input(anyhow!("{} is a {needed}; {} given", model.display(), images.len())))
        }
    }
}

fn read(path: &Path) -> Result<RgbImage> {
    let image = image::open(path).with_context(|| format!("cannot read {}", path.display()));
    Ok(image.map_err(bad_input)?.into_rgb8())
}
