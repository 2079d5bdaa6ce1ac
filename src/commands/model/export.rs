//! `flowservo model predict|export|import`: models outside the registry.

use super::{attach, predict, sign};
use crate::cli::{Exchange, ExportFormat};
use crate::commands::lookup;
use crate::error::bad_input;
use crate::output::{out, print_json};
use anyhow::{Result, anyhow};
use registry::{Location, ModelName, ModelVersion, Outcome, Registry};
use std::path::Path;

/// Runs one of the commands.
pub(crate) fn run(command: &Exchange, json: bool) -> Result<()> {
    match command {
        Exchange::Predict { model, images, registry } => {
            predict::run(&lookup::checkpoint(model, &registry.registry)?, images, json)
        }
        Exchange::Sign { model, key, out, registry } => {
            sign::sign(model, key, out.as_deref(), &registry.registry, json)
        }
        Exchange::Attach(arguments) => attach::run(arguments, json),
        Exchange::Export { model, format, out, license, registry } => {
            let opened = Registry::open(&registry.registry)?;
            let reference = lookup::reference(model)?;
            if license.is_some() && *format == ExportFormat::Oci {
                return Err(bad_input(anyhow!(
                    "--license requires --format huggingface: an OCI layout has no card"
                )));
            }
            let version = match format {
                ExportFormat::Huggingface => {
                    opened.export_huggingface(&reference, out, license.as_deref())?
                }
                ExportFormat::Oci => opened.export_oci(&reference, out)?,
            };
            out!("{}: {version}, every digest verified", out.display());
            print_json(json, &version)
        }
        Exchange::Import { folder, name, registry } => {
            let published = import(folder, name, &registry.registry)?;
            let version = published.value();
            match &published {
                Outcome::New(_) => out!("published {version}  {}", version.digest),
                Outcome::AlreadyThere(_) => {
                    out!("{version} already has this content; nothing was published");
                }
            }
            print_json(json, version)
        }
    }
}

/// Publishes an exported model.
fn import(folder: &Path, name: &str, registry: &Location) -> Result<Outcome<ModelVersion>> {
    let name: ModelName = name.parse().map_err(bad_input)?;
    if Registry::is_oci(folder) {
        return Ok(Registry::init(registry)?.import_oci(&name, folder)?);
    }
    if Registry::is_huggingface(folder) {
        return Ok(Registry::init(registry)?.import_huggingface(&name, folder)?);
    }
    Err(bad_input(anyhow!(
        "{} is not an exported model: it has neither `oci-layout` nor `manifest.json`. To publish a checkpoint folder, use \
         `flowservo model publish`",
        folder.display()
    )))
}
