//! `flowservo model`: the commands on the registry of versioned checkpoints.

mod alias;
pub(crate) mod attach;
mod copy;
mod diff;
mod export;
mod gc;
mod predict;
mod provenance;
pub(crate) mod publish;
mod show;
mod sign;

use super::lookup;
use crate::cli;
use crate::output::{out, print_json};
use anyhow::{Result, bail};
use registry::{Location, Model, ModelVersion, Outcome, Registry, Verification};

/// Runs one of the commands.
pub(crate) fn run(command: &cli::Model, json: bool) -> Result<()> {
    match command {
        cli::Model::Publish { checkpoint, name, evaluation, registry } => {
            let evaluation = evaluation.as_deref();
            let published =
                publish::publish(&Registry::init(&registry.registry)?, checkpoint, name, evaluation)?;
            print_json(json, published.value())
        }
        cli::Model::List { registry } => {
            let models = Registry::open(&registry.registry)?.list()?;
            for model in &models {
                list(model);
            }
            print_json(json, &models)
        }
        cli::Model::Show { model, registry } => show::run(model, &registry.registry, json),
        cli::Model::Pull { model, out, public_key, registry } => {
            let (opened, reference) = (Registry::open(&registry.registry)?, lookup::reference(model)?);
            let pulled = match public_key {
                None => opened.pull(&reference, out)?,
                Some(key) => opened.pull_signed(&reference, out, &sign::read_public_key(key)?)?,
            };
            lookup::warn(pulled.value());
            let signed = if public_key.is_some() { "; the signature is valid" } else { "" };
            let ModelVersion { name, version, .. } = pulled.value();
            match &pulled {
                Outcome::New(_) => out!("{}: {name}@{version}, every digest verified{signed}", out.display()),
                Outcome::AlreadyThere(_) => out!("{} already held {name}@{version}{signed}", out.display()),
            }
            print_json(json, pulled.value())
        }
        cli::Model::Verify { model: Some(model), public_key: Some(key), signature, registry } => {
            sign::verify(model, key, signature.as_deref(), &registry.registry, json)
        }
        cli::Model::Verify { model, registry, .. } => verify(model.as_deref(), &registry.registry, json),
        cli::Model::Alias(arguments) => alias::alias(arguments, json),
        cli::Model::Yank(arguments) => alias::yank(arguments, json),
        cli::Model::Copy(arguments) => copy::run(arguments, json),
        cli::Model::Gc(arguments) => gc::run(arguments, json),
        cli::Model::Diff { from, to, registry } => {
            diff::run(&Registry::open(&registry.registry)?, from, to, json)
        }
        cli::Model::Exchange(command) => export::run(command, json),
        cli::Model::Init { registry } => {
            let created = init(&registry.registry)?;
            print_json(
                json,
                &serde_json::json!({ "registry": registry.registry.to_string(), "created": created }),
            )
        }
    }
}

/// Verifies a version, or the whole registry.
fn verify(model: Option<&str>, location: &Location, json: bool) -> Result<()> {
    let asked = model.map(lookup::reference).transpose()?;
    let found = Registry::open(location)?.verify(asked.as_ref())?;
    for problem in &found.problems {
        out!("{problem}");
    }
    let Verification { versions, blobs, events, problems, .. } = &found;
    out!("{versions} versions, {blobs} files and attachments, {events} events, {} problems", problems.len());
    print_json(json, &found)?;
    if !found.problems.is_empty() {
        bail!("{location}: the registry is damaged; publish the affected checkpoints again");
    }
    Ok(())
}

/// Creates a registry, or probes the existing one. Returns whether it was created.
fn init(location: &Location) -> Result<bool> {
    match Registry::open(location) {
        Ok(registry) => {
            registry.probe()?;
            out!("{location}: this registry is safe to publish to");
            Ok(false)
        }
        Err(registry::Error::NoRegistry { .. }) => {
            Registry::init(location)?;
            out!("{location}: created; the store never overwrites an existing object");
            Ok(true)
        }
        Err(error) => Err(error.into()),
    }
}

fn list(model: &Model) {
    let Model { name, versions, yanked, aliases } = model;
    let version =
        |number: &u64| format!("{number}{}", if yanked.contains(number) { " (yanked)" } else { "" });
    let versions = versions.iter().map(version).collect::<Vec<_>>().join(", ");
    let aliases = aliases.iter().map(|(alias, number)| format!("; {alias} is {number}")).collect::<Vec<_>>();
    out!("{name}  versions {versions}{}", aliases.concat());
}
