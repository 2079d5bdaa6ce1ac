//! Models named on the command line: references, checkpoint folders, and messages about versions.

use crate::error::bad_input;
use crate::output::note;
use anyhow::{Result, anyhow};
use registry::{Location, ModelRef, ModelVersion, Note, Registry, Selector};
use std::path::{Path, PathBuf};
use train::checkpoint::MODEL;

/// Parses a reference to a version.
pub(crate) fn reference(text: &str) -> Result<ModelRef> {
    text.parse().map_err(bad_input)
}

/// Returns the folder of a model, which is pulled if it is in the registry.
pub(crate) fn checkpoint(model: &str, registry: &Location) -> Result<PathBuf> {
    find(model, registry).map(|(folder, _)| folder)
}

/// Finds a model: a checkpoint folder, or a version in the registry. A version is pulled into the folder `pulled` in the registry,
/// or in the working directory if the registry is in a bucket.
pub(crate) fn find(model: &str, registry: &Location) -> Result<(PathBuf, Option<ModelVersion>)> {
    if is_folder(model) {
        return Ok((PathBuf::from(model), None));
    }
    let (opened, version) = look_up(model, registry)?;
    let name = format!("{}-{}", version.name, version.version);
    let target = match registry.folder() {
        Some(folder) => folder.join("pulled").join(name),
        // Different buckets may have versions of the same name.
        None => Path::new("pulled").join(format!("{name}-{}", &version.digest.hex()[..12])),
    };
    // Exactly this version: by now, an alias may name another one.
    let exact = ModelRef { name: version.name.clone(), selector: Selector::Version(version.version) };
    opened.pull(&exact, &target)?;
    Ok((target, Some(version)))
}

/// Returns whether `model` is a checkpoint folder. Other folders may have a model's name by chance.
pub(crate) fn is_folder(model: &str) -> bool {
    Path::new(model).join(MODEL).is_file()
}

/// Resolves a model that is not a checkpoint folder.
pub(crate) fn look_up(model: &str, registry: &Location) -> Result<(Registry, ModelVersion)> {
    let folder =
        if Path::new(model).is_dir() { "the folder has no model.json" } else { "not a checkpoint folder" };
    let unknown = |error: registry::Error| match error {
        // A damaged version was named correctly.
        registry::Error::Damaged(_) => error.into(),
        _ => bad_input(anyhow!("no model `{model}`: {folder}, and {error}")),
    };
    let reference: ModelRef = model.parse().map_err(unknown)?;
    let opened = Registry::open(registry).map_err(unknown)?;
    let version = opened.show(&reference).map_err(unknown)?;
    warn(&version);
    Ok((opened, version))
}

/// Warns if a version is yanked.
pub(crate) fn warn(version: &ModelVersion) {
    if let Some(note) = &version.yanked {
        note!("warning: {version} is yanked{}", describe(note));
    }
}

/// Formats author, time and reason of a change as the end of a sentence.
pub(crate) fn describe(note: &Note) -> String {
    let Note { who, reason, when } = note;
    let reason = reason.as_ref().map_or(String::new(), |reason| format!(": {reason}"));
    let source = [who, when].into_iter().flatten().map(String::as_str).collect::<Vec<_>>().join(", ");
    let text = if source.is_empty() { reason } else { format!("{reason} ({source})") };
    // The note comes from others, and control characters could manipulate the terminal.
    text.chars().filter(|c| !c.is_control()).collect()
}
