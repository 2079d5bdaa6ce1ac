//! `flowservo train --from MODEL`: the model that a training run starts from.

use crate::commands::lookup;
use anyhow::Result;
use registry::{Location, ModelRef, Selector};
use std::path::Path;
use train::checkpoint::Version;
use train::{ModelInfo, Task, TrainConfig, WarmStart};

/// Finds and verifies the model that a configuration names. Replaces the name with that of the exact version.
pub(crate) fn find(config: &mut TrainConfig, task: &Task, registry: &Location) -> Result<Option<WarmStart>> {
    let Some(parent) = &mut config.parent else { return Ok(None) };
    let (folder, found) = lookup::find(parent, registry)?;
    let version = found.map(|found| {
        let name = found.to_string();
        let manifest_sha256 = found.digest.hex();
        *parent = ModelRef { name: found.name, selector: Selector::Digest(found.digest) }.to_string();
        Version { name, manifest_sha256 }
    });
    Ok(Some(WarmStart::open(&folder, version, task)?))
}

/// Replaces the name of the parent in a configuration with the exact version that the run in a folder started from, if the name
/// may refer to it. A resumed run does not need its parent, nor the aliases as they were.
pub(crate) fn recall(config: &mut TrainConfig, run: &Path) {
    if let Some(parent) = &mut config.parent
        && let Some(exact) = recorded(run).and_then(|version| meant(parent, &version))
    {
        *parent = exact;
    }
}

/// Returns the version that a run started from.
fn recorded(run: &Path) -> Option<Version> {
    // A missing or unreadable run is reported when it is resumed.
    if !train::can_resume(run) {
        return None;
    }
    ModelInfo::read(&run.join("last")).ok()?.parent?.version
}

/// Returns the exact name of a version if `reference` may refer to it. Aliases, and the newest version, may have changed since.
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
    fn references_resolve_to_the_recorded_version() {
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
