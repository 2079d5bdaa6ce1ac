//! `flowservo model alias` and `yank`: aliases of versions, and withdrawn versions.

use crate::cli::{AliasArgs, NoteArgs, Yank};
use crate::clock;
use crate::commands::lookup::{describe, warn};
use crate::error::bad_input;
use crate::output::{out, print_json};
use anyhow::{Result, anyhow};
use registry::{AliasName, Event, ModelName, ModelRef, Note, Precondition, Registry, Selector};
use serde_json::json;

/// `model alias`: lists, shows, sets or removes aliases.
pub(crate) fn alias(arguments: &AliasArgs, json: bool) -> Result<()> {
    let name: ModelName = arguments.name.parse().map_err(bad_input)?;
    let alias: Option<AliasName> =
        arguments.alias.as_deref().map(str::parse).transpose().map_err(bad_input)?;
    let registry = Registry::open(&arguments.registry.registry)?;
    match (&alias, &arguments.version) {
        (None, _) => list(&registry, &name, json),
        (Some(alias), Some(version)) => set(&registry, &name, alias, version, (arguments, json)),
        (Some(alias), None) if arguments.remove => {
            let event =
                registry.remove_alias(&name, alias, precondition(arguments)?, &note(&arguments.note))?;
            out!("removed {}", event.subject);
            print_json(json, &json!({ "changed": true, "subject": event.subject, "version": null }))
        }
        (Some(alias), None) => {
            let events = registry.alias_history(&name, alias)?;
            events.iter().for_each(show);
            print_json(json, &events)
        }
    }
}

/// `model yank`: yanks a version, or takes the yank back.
pub(crate) fn yank(arguments: &Yank, json: bool) -> Result<()> {
    let reference: ModelRef = arguments.model.parse().map_err(bad_input)?;
    if !matches!(reference.selector, Selector::Version(_) | Selector::Digest(_)) {
        return Err(bad_input(anyhow!(
            "{reference}: specify which version to yank, such as {}@3",
            reference.name
        )));
    }
    if arguments.note.reason.is_none() && !arguments.undo {
        return Err(bad_input(anyhow!("{reference}: give a reason with --reason")));
    }
    let registry = Registry::open(&arguments.registry.registry)?;
    let version = registry.show(&reference)?;
    let note = note(&arguments.note);
    let changed = if arguments.undo {
        let changed = registry.unyank(&version, &note)?.is_some();
        out!("{version} {}", if changed { "is no longer yanked" } else { "is not yanked" });
        changed
    } else if let Some(before) = &version.yanked {
        out!("{version} is already yanked{}", describe(before));
        false
    } else {
        let changed = registry.yank(&version, &note)?.is_some();
        out!("yanked {version}{}", describe(&note));
        changed
    };
    let subject = version.to_string();
    print_json(json, &json!({ "changed": changed, "subject": subject, "yanked": !arguments.undo }))
}

fn list(registry: &Registry, name: &ModelName, json: bool) -> Result<()> {
    let aliases = registry.aliases(name)?;
    for (alias, version) in &aliases {
        out!("{name}:{alias} names {name}@{version}");
    }
    if aliases.is_empty() {
        out!("{name} has no aliases");
    }
    print_json(json, &aliases)
}

fn set(
    registry: &Registry,
    name: &ModelName,
    alias: &AliasName,
    version: &str,
    (arguments, json): (&AliasArgs, bool),
) -> Result<()> {
    let reference: ModelRef = format!("{name}@{version}").parse().map_err(bad_input)?;
    let version = registry.show(&reference)?;
    warn(&version);
    let event = registry.set_alias(alias, &version, precondition(arguments)?, &note(&arguments.note))?;
    match &event {
        Some(_) => out!("{name}:{alias} now names {version}"),
        None => out!("{name}:{alias} already names {version}"),
    }
    let (changed, subject) = (event.is_some(), format!("{name}:{alias}"));
    print_json(json, &json!({ "changed": changed, "subject": subject, "version": version.version }))
}

/// Prints an event of an alias.
fn show(event: &Event) {
    let version = event.target.map_or("no version".into(), |target| format!("version {}", target.version));
    out!("{:>5}  {version}{}", event.number, describe(&event.note));
}

fn precondition(arguments: &AliasArgs) -> Result<Precondition> {
    match arguments.expect.as_deref() {
        None => Ok(Precondition::Any),
        Some("none") => Ok(Precondition::Unset),
        Some(text) => text
            .parse()
            .map(Precondition::Version)
            .map_err(|_| bad_input(anyhow!("--expect {text}: expected a version number or none"))),
    }
}

/// Returns the note to record with a change, with the current time.
pub(crate) fn note(arguments: &NoteArgs) -> Note {
    Note {
        who: arguments.by.clone(),
        reason: arguments.reason.clone(),
        when: Some(clock::rfc3339(clock::now())),
    }
}
