//! `flowservo model alias` and `yank`: what is said about versions, and may change.

use super::model::{told, warn};
use crate::cli::{AliasArgs, RemarkArgs, Yank};
use crate::clock;
use crate::error::bad_input;
use crate::output::{out, print_json};
use anyhow::{Result, anyhow};
use registry::{AliasName, Entry, Expect, ModelName, ModelRef, Registry, Remark, Selector};
use serde_json::json;

/// `model alias`: lists, shows, sets or ends.
pub(crate) fn alias(arguments: &AliasArgs, json: bool) -> Result<()> {
    let name: ModelName = arguments.name.parse().map_err(bad_input)?;
    let alias: Option<AliasName> =
        arguments.alias.as_deref().map(str::parse).transpose().map_err(bad_input)?;
    let registry = Registry::open(&arguments.registry.registry)?;
    match (&alias, &arguments.version) {
        (None, _) => list(&registry, &name, json),
        (Some(alias), Some(version)) => set(&registry, &name, alias, version, (arguments, json)),
        (Some(alias), None) if arguments.remove => {
            let entry =
                registry.remove_alias(&name, alias, expect(arguments)?, &remark(&arguments.remark))?;
            out!("{} means no version from now on", entry.subject);
            print_json(json, &json!({ "changed": true, "subject": entry.subject, "version": null }))
        }
        (Some(alias), None) => {
            let entries = registry.alias_history(&name, alias)?;
            entries.iter().for_each(show);
            print_json(json, &entries)
        }
    }
}

/// `model yank`: yanks a version, or takes it back.
pub(crate) fn yank(arguments: &Yank, json: bool) -> Result<()> {
    let reference: ModelRef = arguments.model.parse().map_err(bad_input)?;
    if !matches!(reference.selector, Selector::Version(_) | Selector::Digest(_)) {
        return Err(bad_input(anyhow!("{reference}: say which version to yank, as {}@3", reference.name)));
    }
    if arguments.remark.reason.is_none() && !arguments.undo {
        return Err(bad_input(anyhow!("{reference}: say why it is yanked, with --reason")));
    }
    let registry = Registry::open(&arguments.registry.registry)?;
    let version = registry.show(&reference)?;
    let remark = remark(&arguments.remark);
    let changed = if arguments.undo {
        let changed = registry.unyank(&version, &remark)?.is_some();
        out!("{version} {}", if changed { "is no longer yanked" } else { "is not yanked" });
        changed
    } else if let Some(before) = &version.yanked {
        out!("{version} is yanked already{}", told(before));
        false
    } else {
        let changed = registry.yank(&version, &remark)?.is_some();
        out!("yanked {version}{}", told(&remark));
        changed
    };
    let subject = version.to_string();
    print_json(json, &json!({ "changed": changed, "subject": subject, "yanked": !arguments.undo }))
}

fn list(registry: &Registry, name: &ModelName, json: bool) -> Result<()> {
    let aliases = registry.aliases(name)?;
    for (alias, version) in &aliases {
        out!("{name}:{alias} is {name}@{version}");
    }
    if aliases.is_empty() {
        out!("{name} has no alias");
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
    let entry = registry.set_alias(alias, &version, expect(arguments)?, &remark(&arguments.remark))?;
    match &entry {
        Some(_) => out!("{name}:{alias} is {version} from now on"),
        None => out!("{name}:{alias} is {version} already"),
    }
    let (changed, subject) = (entry.is_some(), format!("{name}:{alias}"));
    print_json(json, &json!({ "changed": changed, "subject": subject, "version": version.version }))
}

/// Prints an entry of an alias's history.
fn show(entry: &Entry) {
    let version = entry.target.map_or("no version".into(), |target| format!("version {}", target.version));
    out!("{:>5}  {version}{}", entry.number, told(&entry.remark));
}

fn expect(arguments: &AliasArgs) -> Result<Expect> {
    match arguments.expect.as_deref() {
        None => Ok(Expect::Anything),
        Some("none") => Ok(Expect::Nothing),
        Some(text) => text
            .parse()
            .map(Expect::Version)
            .map_err(|_| bad_input(anyhow!("--expect {text}: write the number of a version, or none"))),
    }
}

/// What is written into the registry with a change, now.
pub(crate) fn remark(arguments: &RemarkArgs) -> Remark {
    Remark {
        who: arguments.by.clone(),
        reason: arguments.reason.clone(),
        when: Some(clock::rfc3339(clock::now())),
    }
}
