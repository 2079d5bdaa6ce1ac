//! `flowservo model sign` and `verify --public-key`: signatures of models.

use super::attach::{attach, read_signature};
use crate::cli::NoteArgs;
use crate::commands::lookup;
use crate::error::bad_input;
use crate::output::{out, print_json};
use anyhow::{Context, Result, bail};
use registry::{Attachment, Location, ModelVersion, PrivateKey, PublicKey, Registry, Signature, SignedFiles};
use serde_json::json;
use std::fs::File;
use std::io::Write;
use std::path::Path;

/// Default file of a signature.
const FILE: &str = "model.sig";

/// Signs a version, to which the signature is attached, or a model folder. Writes a file if `out` names one.
pub(crate) fn sign(
    model: &str,
    key: &Path,
    out: Option<&Path>,
    registry: &Location,
    json: bool,
) -> Result<()> {
    let pem = read_key(key)?;
    let key = PrivateKey::from_pem(&pem).with_context(|| key.display().to_string()).map_err(bad_input)?;
    if lookup::is_folder(model) {
        let out = out.unwrap_or(Path::new(FILE));
        let files = SignedFiles::in_folder(Path::new(model))?;
        write(out, &files.sign(&key)?)?;
        out!("{}: signed {} files of {}", out.display(), files.files.len(), files.name);
        return print_json(json, &json!({ "signature": out, "files": files.files }));
    }
    let (registry, version) = verified(model, registry)?;
    let files = SignedFiles::of_version(&version);
    let signature = files.sign(&key)?;
    if let Some(out) = out {
        write(out, &signature)?;
        out!("{}: signed {} files of {version}", out.display(), files.files.len());
    }
    let attachment = Attachment::Signature(signature);
    let attached = attach(&registry, &version, &attachment, &NoteArgs::default())?;
    let result = json!({
        "signature": out, "changed": attached.is_new(), "attachment": attached.value(), "files": files.files,
    });
    print_json(json, &result)
}

/// Verifies a model folder or a version against a signature in a file. For a version, the default is an attached signature.
pub(crate) fn verify(
    model: &str,
    public_key: &Path,
    signature: Option<&Path>,
    registry: &Location,
    json: bool,
) -> Result<()> {
    let key = read_public_key(public_key)?;
    let is_folder = lookup::is_folder(model);
    let (files, attachment) = match signature {
        None if !is_folder => {
            let (registry, version) = verified(model, registry)?;
            let event = registry.signature_by(&version, &key)?;
            (SignedFiles::of_version(&version), Some(event.number))
        }
        file => {
            let file = file.unwrap_or(Path::new(FILE));
            let signature = read_signature(file)?;
            let files = if is_folder {
                SignedFiles::in_folder(Path::new(model))?
            } else {
                SignedFiles::of_version(&verified(model, registry)?.1)
            };
            files.verify(&signature, &key).with_context(|| file.display().to_string())?;
            (files, None)
        }
    };
    out!("{model}: the signature is valid for all {} files", files.files.len());
    print_json(json, &json!({ "verified": model, "attachment": attachment, "files": files.files }))
}

/// Reads a public key.
pub(crate) fn read_public_key(path: &Path) -> Result<PublicKey> {
    let pem = read_key(path)?;
    PublicKey::from_pem(&pem).with_context(|| path.display().to_string()).map_err(bad_input)
}

fn read_key(path: &Path) -> Result<String> {
    std::fs::read_to_string(path).with_context(|| path.display().to_string()).map_err(bad_input)
}

fn write(file: &Path, signature: &Signature) -> Result<()> {
    let write = || File::create_new(file)?.write_all(signature.as_str().as_bytes());
    write().with_context(|| format!("{}: existing signatures are never overwritten", file.display()))
}

/// Resolves a version in the registry and verifies every file of it.
fn verified(model: &str, registry: &Location) -> Result<(Registry, ModelVersion)> {
    let (opened, version) = lookup::look_up(model, registry)?;
    // Exactly this version: by now, an alias may name another one.
    let found = opened.verify(Some(&lookup::reference(&version.to_string())?))?.problems;
    // A damaged attachment does not affect the files. It is reported where it is used.
    if let Some(problem) = found.iter().find(|problem| problem.model == Some(version.to_string())) {
        bail!("{problem}");
    }
    Ok((opened, version))
}
