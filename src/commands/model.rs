//! `flowservo model`: the registry of versioned checkpoints.

use super::print_json;
use crate::cli;
use crate::config::bad_input;
use crate::output::out;
use anyhow::{Context, Result, bail};
use registry::{Location, ModelName, ModelRef, ModelVersion, Published, Pulled, Registry};
use std::path::{Path, PathBuf};

/// Runs one of the commands.
pub(crate) fn run(command: &cli::Model, json: bool) -> Result<()> {
    match command {
        cli::Model::Publish { checkpoint, name, registry } => {
            let published = publish(&Registry::init(&registry.registry)?, checkpoint, name)?;
            print_json(json, published.version())
        }
        cli::Model::List { registry } => {
            let models = Registry::open(&registry.registry)?.list()?;
            for model in &models {
                let versions: Vec<String> = model.versions.iter().map(ToString::to_string).collect();
                out!("{}  versions {}", model.name, versions.join(", "));
            }
            print_json(json, &models)
        }
        cli::Model::Show { model, registry } => {
            let version = Registry::open(&registry.registry)?.show(&reference(model)?)?;
            show(&version);
            print_json(json, &version)
        }
        cli::Model::Pull { model, out, registry } => {
            let pulled = Registry::open(&registry.registry)?.pull(&reference(model)?, out)?;
            let ModelVersion { name, version, .. } = pulled.version();
            match &pulled {
                Pulled::New(_) => out!("{}: {name}@{version}, every digest checked", out.display()),
                Pulled::AlreadyThere(_) => out!("{} held {name}@{version} already", out.display()),
            }
            print_json(json, pulled.version())
        }
        cli::Model::Verify { model, registry } => {
            let asked = model.as_deref().map(reference).transpose()?;
            let found = Registry::open(&registry.registry)?.verify(asked.as_ref())?;
            for problem in &found.problems {
                out!("{problem}");
            }
            out!(
                "{} versions, {} files read, {} problems",
                found.versions,
                found.blobs,
                found.problems.len()
            );
            print_json(json, &found)?;
            if !found.problems.is_empty() {
                bail!("{}: the registry is damaged; publish again what is lost", registry.registry);
            }
            Ok(())
        }
        cli::Model::Init { registry } => {
            let created = init(&registry.registry)?;
            print_json(
                json,
                &serde_json::json!({ "registry": registry.registry.to_string(), "created": created }),
            )
        }
    }
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

fn reference(text: &str) -> Result<ModelRef> {
    text.parse().map_err(bad_input)
}

/// Publishes a checkpoint as the next version of a name, and says so.
pub(crate) fn publish(registry: &Registry, checkpoint: &Path, name: &str) -> Result<Published> {
    let name: ModelName = name.parse().map_err(bad_input)?;
    let provenance = super::train::provenance(checkpoint)?;
    let published = registry.publish(&name, checkpoint, provenance)?;
    let ModelVersion { name, version, .. } = published.version();
    match &published {
        Published::New(_) => out!("published {name}@{version}"),
        Published::AlreadyThere(_) => {
            out!("{name}@{version} has this content already; nothing was published");
        }
    }
    Ok(published)
}

/// The folder of a model that a person names: a checkpoint's folder, or a version in the registry, which is then pulled into
/// `pulled/` beside the registry's content, or here if that is in a bucket.
pub(crate) fn checkpoint(model: &str, registry: &Location) -> Result<PathBuf> {
    let folder = PathBuf::from(model);
    if folder.is_dir() {
        return Ok(folder);
    }
    let unknown =
        || format!("{model} is neither a checkpoint's folder nor a model in the registry {registry}");
    let reference: ModelRef = model.parse().map_err(bad_input).with_context(unknown)?;
    let opened = Registry::open(registry).map_err(bad_input).with_context(unknown)?;
    let version = opened.show(&reference).map_err(bad_input).with_context(unknown)?;
    let name = format!("{}-{}", version.name, version.version);
    let target = match registry.folder() {
        Some(folder) => folder.join("pulled").join(name),
        // Any bucket may have a version of this name.
        None => Path::new("pulled").join(format!("{name}-{}", &version.digest.hex()[..12])),
    };
    opened.pull(&reference, &target)?;
    Ok(target)
}

fn show(version: &ModelVersion) {
    let ModelVersion { name, version: number, digest, manifest, .. } = version;
    out!("{name}@{number}  {digest}");
    for layer in &manifest.layers {
        out!("  {:32} {:>12} bytes  {}", layer.path().unwrap_or("?"), layer.size, layer.digest);
    }
    for (dataset, digest) in &manifest.lineage.datasets {
        out!("  trained on {dataset}  {digest}");
    }
    for (metric, value) in &manifest.metrics {
        out!("  {metric} = {value:.4}");
    }
}
