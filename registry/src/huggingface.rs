//! A version as the folder of a model on the Hugging Face Hub, and back.

use std::path::Path;

use crate::card;
use crate::error::{Error, Result};
use crate::import::{self, Foreign};
use crate::manifest::Descriptor;
use crate::name::ModelName;
use crate::publish::Published;
use crate::pull::{Staged, write_new};
use crate::reference::ModelRef;
use crate::registry::{ModelVersion, Registry};

/// What the Hub calls the weights, and what checkpoints call them.
const WEIGHTS: [&str; 2] = ["model.safetensors", "weights.safetensors"];
/// The manifest, byte for byte, by which the folder is verified when it is imported.
const MANIFEST: &str = "manifest.json";

/// Where a file of a checkpoint lies in the folder.
fn place(layer: &Descriptor) -> &str {
    let path = layer.path().unwrap_or_default();
    if path == WEIGHTS[1] { WEIGHTS[0] } else { path }
}

impl Registry {
    /// Writes the version that `reference` names into the new folder `destination`, as a model of the Hugging Face Hub: its files
    /// with the weights as `model.safetensors`, a card under a license of the Hub's list, and the manifest.
    pub fn export_huggingface(
        &self,
        reference: &ModelRef,
        destination: &Path,
        license: Option<&str>,
    ) -> Result<ModelVersion> {
        let version = self.show(reference)?;
        for taken in [card::FILE, MANIFEST, WEIGHTS[0]] {
            if version.manifest.layers.iter().any(|layer| layer.path() == Some(taken)) {
                let reason = format!("the model has a file {taken} already, which would be written over");
                return Err(Error::Destination {
                    path: destination.to_owned(),
                    model: version.to_string(),
                    reason,
                });
            }
        }
        let staged = Staged::beside(destination, &version)?;
        for layer in &version.manifest.layers {
            self.write_blob(&version, layer, &staged.folder.join(place(layer)))?;
        }
        write_new(
            &staged.folder.join(card::FILE),
            card::text(&version, &self.values(&version)?, license).as_bytes(),
        )?;
        write_new(&staged.folder.join(MANIFEST), &self.manifest_bytes(&version)?)?;
        staged.finish(destination, &version)?;
        Ok(version)
    }

    /// Publishes the model in a folder that [`export_huggingface`](Self::export_huggingface) wrote as the next version of `name`.
    /// Every file is compared with its digest in the manifest first; the card and what else lies there is left out.
    pub fn import_huggingface(&self, name: &ModelName, folder: &Path) -> Result<Published> {
        let path = folder.join(MANIFEST);
        let bytes = import::read_document(&path)?;
        let foreign = Foreign::parse(&bytes, &path)?;
        self.adopt(name, foreign, &|layer| folder.join(place(layer)))
    }

    /// Whether a folder looks like one of these.
    pub fn is_huggingface(folder: &Path) -> bool {
        folder.join(MANIFEST).is_file()
    }
}

#[cfg(test)]
mod tests {
    use std::fs;

    use crate::fixture::{Place, model, safetensors};
    use crate::manifest::Provenance;

    #[test]
    fn comes_back_as_it_was_and_refuses_what_was_changed() {
        let (place, other) = (Place::local(), Place::local());
        let checkpoint = place.checkpoint("checkpoint", b"more weights");
        let weights = safetensors(b"weights");
        fs::write(checkpoint.join("weights.safetensors"), &weights).unwrap();
        let published =
            place.registry().publish(&model("approach"), &checkpoint, Provenance::default()).unwrap();
        let version = published.version().clone();
        let folder = place.path("hub");
        let reference = "approach".parse().unwrap();
        place.registry().export_huggingface(&reference, &folder, None).unwrap();
        assert_eq!(fs::read(folder.join("model.safetensors")).unwrap(), weights);
        assert!(!folder.join("weights.safetensors").exists());
        assert!(fs::read_to_string(folder.join("README.md")).unwrap().starts_with("---\n"));
        // Never into a folder that is there.
        assert!(place.registry().export_huggingface(&reference, &folder, None).is_err());

        // People write into the card.
        fs::write(folder.join("README.md"), "ours").unwrap();
        let back = other.registry().import_huggingface(&model("approach"), &folder).unwrap();
        assert_eq!(back.version(), &version);
        assert!(other.registry().verify(None).unwrap().problems.is_empty());

        fs::write(folder.join("model.safetensors"), safetensors(b"weighty")).unwrap();
        let refusal = other.registry().import_huggingface(&model("second"), &folder).unwrap_err().to_string();
        assert!(refusal.contains("model.safetensors") && refusal.contains("digest"), "{refusal}");
        assert_eq!(other.registry().list().unwrap().len(), 1);
    }
}
