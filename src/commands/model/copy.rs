//! `flowservo model copy`: versions from one registry to another.

use super::alias::note;
use crate::cli::{Copy, NoteArgs};
use crate::commands::lookup::{reference, warn};
use crate::error::bad_input;
use crate::output::{out, print_json};
use anyhow::Result;
use registry::{Copied, ModelName, ModelRef, ModelVersion, Precondition, Registry, Selector};
use serde_json::json;

/// Runs the command.
pub(crate) fn run(arguments: &Copy, json: bool) -> Result<()> {
    let from = Registry::open(&arguments.registry.registry)?;
    // Found before the other registry is created.
    let mut versions = Vec::new();
    for model in &arguments.models {
        if arguments.all {
            versions.extend(all_versions(&from, model)?);
        } else {
            versions.push(from.show(&reference(model)?)?);
        }
    }
    // In ascending order, so that numbers stay the same where they can.
    versions.sort_by(|a, b| (&a.name, a.version).cmp(&(&b.name, b.version)));
    versions.dedup();
    let to = Registry::init(&arguments.to)?;
    let mut results = Vec::new();
    for version in &versions {
        let copied = from.copy(version, &to)?;
        report(version, &copied);
        let aliases = if arguments.aliases { set_aliases(&from, version, &to, &copied)? } else { Vec::new() };
        results.push(json!({ "from": version.version, "copied": copied, "aliases": aliases }));
    }
    print_json(json, &results)
}

/// Returns all versions of a model.
fn all_versions(registry: &Registry, name: &str) -> Result<Vec<ModelVersion>> {
    let name: ModelName = name.parse().map_err(bad_input)?;
    let exact = |number| ModelRef { name: name.clone(), selector: Selector::Version(number) };
    let Some(model) = registry.list()?.into_iter().find(|model| model.name == name) else {
        // Fails with an error that lists the existing models.
        return Ok(vec![registry.show(&exact(1))?]);
    };
    model.versions.into_iter().map(|number| Ok(registry.show(&exact(number))?)).collect()
}

fn report(version: &ModelVersion, Copied { version: copied, is_new, attachments, yanked, .. }: &Copied) {
    warn(copied);
    match (is_new, copied.version == version.version) {
        (true, true) => out!("{version}: copied"),
        (true, false) => out!("{version}: copied as {copied}, because numbers are given in order"),
        (false, _) => out!("{version}: already exists as {copied}"),
    }
    if *attachments > 0 {
        out!("{copied}: {attachments} attachments added");
    }
    if *yanked {
        out!("{copied}: yanked, as in the source");
    }
}

/// Sets the aliases that name `version` to its copy, and returns them.
fn set_aliases(
    from: &Registry,
    version: &ModelVersion,
    to: &Registry,
    copied: &Copied,
) -> Result<Vec<String>> {
    let mut set = Vec::new();
    for (alias, number) in from.aliases(&version.name)? {
        if number == version.version {
            let note = note(&NoteArgs::default());
            if to.set_alias(&alias, &copied.version, Precondition::Any, &note)?.is_some() {
                out!("{}:{alias} now names {}", version.name, copied.version);
            }
            set.push(alias.to_string());
        }
    }
    Ok(set)
}
