//! `flowservo model`: the registry of versioned checkpoints.

use super::{
    model_alias, model_attach, model_diff, model_export, model_gc, model_show, model_sign, provenance,
};
use crate::cli;
use crate::error::bad_input;
use crate::output::{note, out, print_json};
use anyhow::{Context, Result, bail};
use registry::{
    Location, Model, ModelName, ModelRef, ModelVersion, Published, Pulled, Registry, Remark, Selector,
    Verification,
};
use std::path::{Path, PathBuf};
use train::checkpoint::MODEL;

/// Runs one of the commands.
pub(crate) fn run(command: &cli::Model, json: bool) -> Result<()> {
    match command {
        cli::Model::Publish { checkpoint, name, evaluation, registry } => {
            let evaluation = evaluation.as_deref();
            let published = publish(&Registry::init(&registry.registry)?, checkpoint, name, evaluation)?;
            print_json(json, published.version())
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
            warn(pulled.version());
            let signed = if public_key.is_some() { "; the signature holds" } else { "" };
            let ModelVersion { name, version, .. } = pulled.version();
            match &pulled {
                Pulled::New(_) => out!("{}: {name}@{version}, every digest checked{signed}", out.display()),
                Pulled::AlreadyThere(_) => out!("{} held {name}@{version} already{signed}", out.display()),
            }
            print_json(json, pulled.version())
        }
        cli::Model::Verify { model: Some(model), public_key: Some(key), signature, registry } => {
            model_sign::verify(model, key, signature.as_deref(), &registry.registry, json)
        }
        cli::Model::Verify { model, registry, .. } => verify(model.as_deref(), &registry.registry, json),
        cli::Model::Alias(arguments) => model_alias::alias(arguments, json),
        cli::Model::Yank(arguments) => model_alias::yank(arguments, json),
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

/// Reads everything, or all of one version.
fn verify(model: Option<&str>, location: &Location, json: bool) -> Result<()> {
    let asked = model.map(reference).transpose()?;
    let found = Registry::open(location)?.verify(asked.as_ref())?;
    for problem in &found.problems {
        out!("{problem}");
    }
    let Verification { versions, blobs, entries, problems, .. } = &found;
    out!(
        "{versions} versions, {blobs} files read, {entries} entries of aliases, yanks and attachments, {} problems",
        problems.len()
    );
    print_json(json, &found)?;
    if !found.problems.is_empty() {
        bail!("{location}: the registry is damaged; publish again what is lost");
    }
    Ok(())
}

/// Creates a registry, or probes the one that is there. Says whether it was created.
fn init(location: &Location) -> Result<bool> {
    match Registry::open(location) {
        Ok(registry) => {
            registry.probe()?;
            out!("{location}: the registry that is there is safe to publish to");
            Ok(false)
        }
        Err(registry::Error::NoRegistry { .. }) => {
            Registry::init(location)?;
            out!("{location}: created; the store never overwrites what is there");
            Ok(true)
        }
        Err(error) => Err(error.into()),
    }
}

/// What a person calls a version.
pub(crate) fn reference(text: &str) -> Result<ModelRef> {
    text.parse().map_err(bad_input)
}

/// Publishes a checkpoint as the next version of a name, and says so. If the version is there, the evaluation is attached to it.
pub(crate) fn publish(
    registry: &Registry,
    checkpoint: &Path,
    name: &str,
    evaluation: Option<&Path>,
) -> Result<Published> {
    let name: ModelName = name.parse().map_err(bad_input)?;
    let mut provenance = provenance::of(checkpoint)?;
    let evaluation = evaluation.map(|folder| model_attach::evaluation_of(checkpoint, folder)).transpose()?;
    if let Some(evaluation) = &evaluation {
        provenance.metrics.extend(evaluation.metrics.clone());
    }
    let published = registry.publish(&name, checkpoint, provenance)?;
    warn(published.version());
    let ModelVersion { name, version, .. } = published.version();
    match &published {
        Published::New(_) => out!("published {name}@{version}"),
        Published::AlreadyThere(_) => {
            out!("{name}@{version} has this content already; nothing was published");
            if let Some(evaluation) = evaluation {
                model_attach::attach_news(registry, published.version(), evaluation)?;
            }
        }
    }
    Ok(published)
}

/// The folder of a model that a person names.
pub(crate) fn checkpoint(model: &str, registry: &Location) -> Result<PathBuf> {
    find(model, registry).map(|(folder, _)| folder)
}

/// A model that a person names: a checkpoint's folder, or a version in the registry, which is then pulled into `pulled/` beside
/// the registry's content, or here if that is in a bucket.
pub(crate) fn find(model: &str, registry: &Location) -> Result<(PathBuf, Option<ModelVersion>)> {
    if is_folder(model) {
        return Ok((PathBuf::from(model), None));
    }
    let (opened, version) = look_up(model, registry)?;
    let name = format!("{}-{}", version.name, version.version);
    let target = match registry.folder() {
        Some(folder) => folder.join("pulled").join(name),
        // Any bucket may have a version of this name.
        None => Path::new("pulled").join(format!("{name}-{}", &version.digest.hex()[..12])),
    };
    // Exactly this version: an alias or the newest may be another one by now.
    let exact = ModelRef { name: version.name.clone(), selector: Selector::Version(version.version) };
    opened.pull(&exact, &target)?;
    Ok((target, Some(version)))
}

/// Whether a person means a checkpoint's folder by it. Any other folder may have a model's name by chance.
pub(crate) fn is_folder(model: &str) -> bool {
    Path::new(model).join(MODEL).is_file()
}

/// The version that a person means by what is no checkpoint's folder.
pub(crate) fn look_up(model: &str, registry: &Location) -> Result<(Registry, ModelVersion)> {
    let unknown = || {
        let fault = if Path::new(model).is_dir() { "has no model.json" } else { "is no checkpoint's folder" };
        format!("{model} {fault}, and cannot be had from the registry {registry}")
    };
    let reference: ModelRef = model.parse().map_err(bad_input).with_context(unknown)?;
    let opened = Registry::open(registry).map_err(bad_input).with_context(unknown)?;
    let version = opened.show(&reference).map_err(|error| match error {
        // What is damaged was named rightly.
        registry::Error::Damaged(_) => error.into(),
        _ => bad_input(error).context(unknown()),
    })?;
    warn(&version);
    Ok((opened, version))
}

/// Warns of a version that is yanked.
pub(crate) fn warn(version: &ModelVersion) {
    if let Some(remark) = &version.yanked {
        note!("warning: {version} is yanked{}", told(remark));
    }
}

/// What was said about a change, to be appended to what is told of it.
pub(crate) fn told(remark: &Remark) -> String {
    let Remark { who, reason, when } = remark;
    let reason = reason.as_ref().map_or(String::new(), |reason| format!(": {reason}"));
    let source = [who, when].into_iter().flatten().map(String::as_str).collect::<Vec<_>>().join(", ");
    let told = if source.is_empty() { reason } else { format!("{reason} ({source})") };
    // Others wrote it: what would steer the terminal is left out.
    told.chars().filter(|c| !c.is_control()).collect()
}

fn list(model: &Model) {
    let Model { name, versions, yanked, aliases } = model;
    let version =
        |number: &u64| format!("{number}{}", if yanked.contains(number) { " (yanked)" } else { "" });
    let versions = versions.iter().map(version).collect::<Vec<_>>().join(", ");
    let aliases = aliases.iter().map(|(alias, number)| format!("; {alias} is {number}")).collect::<Vec<_>>();
    out!("{name}  versions {versions}{}", aliases.concat());
}
