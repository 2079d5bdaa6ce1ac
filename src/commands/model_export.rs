//! `flowservo model predict|sign|verify --public-key`: a model outside of its registry.

use super::{model, predict, print_json};
use crate::cli::Exchange;
use crate::config::bad_input;
use crate::output::out;
use anyhow::{Context, Result, anyhow, bail};
use registry::{PrivateKey, PublicKey, Registry, SignedFiles};
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
    }
}

/// Verifies a signature of a model in a folder or in the registry.
pub(crate) fn verify(
    model: &str,
    public_key: &Path,
    signature: &Path,
    registry: &Path,
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
fn files(model: &str, registry: &Path) -> Result<SignedFiles> {
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
