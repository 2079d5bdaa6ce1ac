//! `flowservo model predict|sign|verify --public-key|export|import`: a model outside of its registry.

use super::{model, predict, print_json};
use crate::cli::{Exchange, ExportFormat};
use crate::config::bad_input;
use crate::output::out;
use anyhow::{Context, Result, anyhow, bail};
use registry::{Location, ModelName, PrivateKey, PublicKey, Published, Registry, SignedFiles};
use std::fs::File;
use std::io::Write;
use std::path::Path;

/// Runs one of the commands.
pub(crate) fn run(command: &Exchange, json: bool) -> Result<()> {
    match command {
        Exchange::Predict { model, images, registry } => {
            predict::run(&model::checkpoint(model, &registry.registry)?, images, json)
        }
        Exchange::Sign { model, key, out, registry } => {
            let pem = read_key(key)?;
            let key =
                PrivateKey::from_pem(&pem).with_context(|| key.display().to_string()).map_err(bad_input)?;
            let files = files(model, &registry.registry)?;
            let signature = files.sign(&key)?;
            let write = || File::create_new(out)?.write_all(signature.as_bytes());
            write().with_context(|| format!("{}: a signature is never written over", out.display()))?;
            out!("{}: signed {} files of {}", out.display(), files.files.len(), files.name);
            print_json(json, &serde_json::json!({ "signature": out, "files": files.files }))
        }
        Exchange::Export { model, format, out, license, registry } => {
            let opened = Registry::open(&registry.registry)?;
            let reference = model::reference(model)?;
            if license.is_some() && *format == ExportFormat::Oci {
                return Err(bad_input(anyhow!(
                    "--license goes with --format huggingface: an OCI layout has no card"
                )));
            }
            let version = match format {
                ExportFormat::Huggingface => {
                    opened.export_huggingface(&reference, out, license.as_deref())?
                }
                ExportFormat::Oci => opened.export_oci(&reference, out)?,
            };
            out!("{}: {version}, every digest checked", out.display());
            print_json(json, &version)
        }
        Exchange::Import { folder, name, registry } => {
            let published = import(folder, name, &registry.registry)?;
            let version = published.version();
            match &published {
                Published::New(_) => out!("published {version}  {}", version.digest),
                Published::AlreadyThere(_) => {
                    out!("{version} has this content already; nothing was published");
                }
            }
            print_json(json, version)
        }
    }
}

/// Publishes an exported model.
fn import(folder: &Path, name: &str, registry: &Location) -> Result<Published> {
    let name: ModelName = name.parse().map_err(bad_input)?;
    if Registry::is_oci(folder) {
        return Ok(Registry::init(registry)?.import_oci(&name, folder)?);
    }
    if Registry::is_huggingface(folder) {
        return Ok(Registry::init(registry)?.import_huggingface(&name, folder)?);
    }
    Err(bad_input(anyhow!(
        "{} holds neither `oci-layout` nor `manifest.json`: it is no exported model; `flowservo model publish` takes a \
         checkpoint's folder",
        folder.display()
    )))
}

/// Verifies a signature of a model in a folder or in the registry.
pub(crate) fn verify(
    model: &str,
    public_key: &Path,
    signature: &Path,
    registry: &Location,
    json: bool,
) -> Result<()> {
    let pem = read_key(public_key)?;
    let key =
        PublicKey::from_pem(&pem).with_context(|| public_key.display().to_string()).map_err(bad_input)?;
    let content =
        std::fs::read(signature).with_context(|| signature.display().to_string()).map_err(bad_input)?;
    let files = files(model, registry)?;
    files.verify(&content, &key).with_context(|| signature.display().to_string())?;
    out!("{model}: every one of {} files is as the key's owner signed it", files.files.len());
    print_json(json, &serde_json::json!({ "verified": model, "files": files.files }))
}

fn read_key(path: &Path) -> Result<String> {
    std::fs::read_to_string(path).with_context(|| path.display().to_string()).map_err(bad_input)
}

/// The files of a model in a folder, or of a version in the registry, which are read and compared with their digests.
fn files(model: &str, registry: &Location) -> Result<SignedFiles> {
    let folder = Path::new(model);
    if folder.is_dir() {
        return Ok(SignedFiles::in_folder(folder)?);
    }
    let reference = model::reference(model)?;
    let opened = Registry::open(registry).map_err(|error| {
        bad_input(anyhow!(error).context(format!("{model} is no folder, and it is not in a registry")))
    })?;
    if let Some(problem) = opened.verify(Some(&reference))?.problems.first() {
        bail!("{problem}");
    }
    Ok(SignedFiles::of_version(&opened.show(&reference)?))
}
