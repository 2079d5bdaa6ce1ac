//! `flowservo model`: the registry of versioned checkpoints.

use super::{
    model_alias, model_attach, model_copy, model_diff, model_export, model_gc, model_show, model_sign,
    print_json, provenance,
};
use crate::cli;
use crate::config::bad_input;
use crate::output::{note, out};
use anyhow::{Result, anyhow, bail};
use registry::{
    Location, Model, ModelName, ModelRef, ModelVersion, Note, Outcome, Registry, Selector, Verification,
};
use std::path::{Path, PathBuf};
use train::checkpoint::MODEL;

/// Runs one of the commands.
pub(crate) fn run(command: &cli::Model, json: bool) -> Result<()> {
    match command {
        cli::Model::Publish { checkpoint, name, evaluation, registry } => {
            let evaluation = evaluation.as_deref();
            let published = publish(&Registry::init(&registry.registry)?, checkpoint, name, evaluation)?;
            print_json(json, published.value())
        }
        cli::Model::List { registry } => {
            let models = Registry::open(&registry.registry)?.list()?;
            for model in &models {
                list(model);
            }
            print_json(json, &models)
        }
        cli::Model::Show { model, registry } => model_show::run(model, &registry.registry, json),
        cli::Model::Pull { model, out, public_key, registry } => {
            let (opened, reference) = (Registry::open(&registry.registry)?, reference(model)?);
            let pulled = match public_key {
                None => opened.pull(&reference, out)?,
                Some(key) => opened.pull_signed(&reference, out, &model_sign::read_public_key(key)?)?,
            };
            warn(pulled.value());
            let signed = if public_key.is_some() { "; the signature is valid" } else { "" };
            let ModelVersion { name, version, .. } = pulled.value();
            match &pulled {
                Outcome::New(_) => out!("{}: {name}@{version}, every digest verified{signed}", out.display()),
                Outcome::AlreadyThere(_) => out!("{} already held {name}@{version}{signed}", out.display()),
            }
            print_json(json, pulled.value())
        }
        cli::Model::Verify { model: Some(model), public_key: Some(key), signature, registry } => {
            model_sign::verify(model, key, signature.as_deref(), &registry.registry, json)
        }
        cli::Model::Verify { model, registry, .. } => verify(model.as_deref(), &registry.registry, json),
        cli::Model::Alias(arguments) => model_alias::alias(arguments, json),
        cli::Model::Yank(arguments) => model_alias::yank(arguments, json),
        cli::Model::Copy(arguments) => model_copy::run(arguments, json),
        cli::Model::Gc(arguments) => model_gc::run(arguments, json),
        cli::Model::Diff { from, to, registry } => {
            model_diff::run(&Registry::open(&registry.registry)?, from, to, json)
        }
        cli::Model::Exchange(command) => model_export::run(command, json),
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
    let asked = model.map(reference).transpose()?;
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

/// Parses a reference to a version.
pub(crate) fn reference(text: &str) -> Result<ModelRef> {
    text.parse().map_err(bad_input)
}

/// Publishes a checkpoint as the next version of a name. If the version exists, the evaluation is attached to it.
pub(crate) fn publish(
    registry: &Registry,
    checkpoint: &Path,
    name: &str,
    evaluation: Option<&Path>,
) -> Result<Outcome<ModelVersion>> {
    let name: ModelName = name.parse().map_err(bad_input)?;
    let mut provenance = provenance::of(checkpoint)?;
    let evaluation = evaluation.map(|folder| model_attach::evaluation_of(checkpoint, folder)).transpose()?;
    if let Some(evaluation) = &evaluation {
        provenance.metrics.extend(evaluation.metrics.clone());
    }
    let published = registry.publish(&name, checkpoint, provenance)?;
    warn(published.value());
    let ModelVersion { name, version, .. } = published.value();
    match &published {
        Outcome::New(_) => out!("published {name}@{version}"),
        Outcome::AlreadyThere(_) => {
            out!("{name}@{version} already has this content; nothing was published");
            if let Some(evaluation) = evaluation {
                model_attach::attach_new_metrics(registry, published.value(), evaluation)?;
            }
        }
    }
    Ok(published)
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

/// Describes who recorded a change, when and why, as the end of a sentence.
pub(crate) fn describe(note: &Note) -> String {
    let Note { who, reason, when } = note;
    let reason = reason.as_ref().map_or(String::new(), |reason| format!(": {reason}"));
    let source = [who, when].into_iter().flatten().map(String::as_str).collect::<Vec<_>>().join(", ");
    let text = if source.is_empty() { reason } else { format!("{reason} ({source})") };
    // Others wrote it: control characters could manipulate the terminal.
    text.chars().filter(|c| !c.is_control()).collect()
}

fn list(model: &Model) {
    let Model { name, versions, yanked, aliases } = model;
    let version =
        |number: &u64| format!("{number}{}", if yanked.contains(number) { " (yanked)" } else { "" });
    let versions = versions.iter().map(version).collect::<Vec<_>>().join(", ");
    let aliases = aliases.iter().map(|(alias, number)| format!("; {alias} is {number}")).collect::<Vec<_>>();
    out!("{name}  versions {versions}{}", aliases.concat());
}
