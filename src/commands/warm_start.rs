//! `flowservo train --from MODEL`: the model that a training run begins from.

use super::model;
use anyhow::Result;
use registry::{Location, ModelRef, Selector};
use std::path::Path;
use train::checkpoint::ModelInfo;
use train::config::{Task, TrainConfig};
use train::fit;
use train::warm_start::{Version, WarmStart};

/// Finds the model that a configuration names, verified, and lets the configuration name its version exactly.
pub(crate) fn find(config: &mut TrainConfig, task: &Task, registry: &Location) -> Result<Option<WarmStart>> {
    let Some(parent) = &mut config.parent else { return Ok(None) };
    let (folder, found) = model::find(parent, registry)?;
    let version = found.map(|found| {
        let name = found.to_string();
        let manifest_sha256 = found.digest.hex();
        *parent = ModelRef { name: found.name, selector: Selector::Digest(found.digest) }.to_string();
        Version { name, manifest_sha256 }
    });
    Ok(Some(WarmStart::open(&folder, version, task)?))
}

/// Lets the configuration name the version that the run in a folder began from, if it may mean that one. A run goes on without
/// its parent, wherever that and its aliases are by now.
pub(crate) fn recall(config: &mut TrainConfig, run: &Path) {
    if let Some(parent) = &mut config.parent
        && let Some(exact) = recorded(run).and_then(|version| meant(parent, &version))
    {
        *parent = exact;
    }
}

/// The version that a run began from.
fn recorded(run: &Path) -> Option<Version> {
    // A run that is not there, or cannot be read, is the business of who goes on with it.
    if !fit::can_resume(run) {
        return None;
    }
    ModelInfo::read(&run.join("last")).ok()?.parent?.version
}

/// The exact name of a version, if `reference` may mean it: an alias, or the newest, may have been another one then.
fn meant(reference: &str, version: &Version) -> Option<String> {
    let reference: ModelRef = reference.parse().ok()?;
    let numbered: ModelRef = version.name.parse().ok()?;
    let digest = format!("sha256:{}", version.manifest_sha256).parse().ok()?;
    let exact = ModelRef { name: numbered.name.clone(), selector: Selector::Digest(digest) };
    let meant = match reference.selector {
        Selector::Version(_) | Selector::Digest(_) => reference == numbered || reference == exact,
        _ => reference.name == exact.name,
    };
    meant.then(|| exact.to_string())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_was_meant_then_is_meant_now() {
        let manifest_sha256 = "ab".repeat(32);
        let exact = format!("approach@sha256:{manifest_sha256}");
        let version = Version { name: "approach@3".to_owned(), manifest_sha256 };
        for same in ["approach", "approach:champion", "approach@3", &exact] {
            assert_eq!(meant(same, &version).as_ref(), Some(&exact), "{same}");
        }
        let other = format!("approach@sha256:{}", "cd".repeat(32));
        for other in ["avoid", "avoid:champion", "approach@2", "avoid@3", &other, "runs/approach/best"] {
            assert_eq!(meant(other, &version), None, "{other}");
        }
    }
}
