//! Versions as model folders of the Hugging Face Hub.

use std::path::Path;

use super::card;
use super::import::Import;
use crate::error::{Error, Result};
use crate::model::{Descriptor, ModelName, ModelRef, ModelVersion};
use crate::operations::pull::{export, write_new};
use crate::outcome::Outcome;
use crate::registry::Registry;

/// The Hub's name for the weights, and the one in checkpoints.
const WEIGHTS: [&str; 2] = ["model.safetensors", "weights.safetensors"];
/// The manifest, byte for byte. An import verifies the folder against it.
const MANIFEST: &str = "manifest.json";

/// Returns the path of a checkpoint's file in the folder.
fn locate(layer: &Descriptor) -> &str {
    let path = layer.path().unwrap_or_default();
    if path == WEIGHTS[1] { WEIGHTS[0] } else { path }
}

impl Registry {
    /// Writes the version that `reference` names into the new folder `destination`, as a model of the Hugging Face Hub: its files
    /// with the weights as `model.safetensors`, a card with a license of the Hub's list, and the manifest.
    pub fn export_huggingface(
        &self,
        reference: &ModelRef,
        destination: &Path,
        license: Option<&str>,
    ) -> Result<ModelVersion> {
        let version = self.show(reference)?;
        for reserved in [card::FILE, MANIFEST, WEIGHTS[0]] {
            if version.manifest.layers.iter().any(|layer| layer.path() == Some(reserved)) {
                let reason =
                    format!("the model has a file {reserved} of its own, which the export would overwrite");
                return Err(Error::refused(&version, reason));
            }
        }
        let card = card::text(&version, &self.values(&version)?, license);
        let manifest = self.store.document(&version.to_string(), version.digest)?;
        export(&version, destination, &|root| {
            for layer in &version.manifest.layers {
                self.write_blob(&version, layer, &root.join(locate(layer)))?;
            }
            write_new(&root.join(card::FILE), card.as_bytes())?;
            write_new(&root.join(MANIFEST), &manifest)
        })?;
        Ok(version)
    }

    /// Publishes the model in a folder that [`export_huggingface`](Self::export_huggingface) wrote as the next version of `name`.
    /// Every file is first verified against the manifest. The card and other files are ignored.
    pub fn import_huggingface(&self, name: &ModelName, folder: &Path) -> Result<Outcome<ModelVersion>> {
        let import = Import::open(folder)?;
        import.publish(self, name, import.manifest(MANIFEST)?, &|layer| locate(layer).to_owned())
    }

    /// Returns whether a folder looks like an exported model for the Hub.
    pub fn is_huggingface(folder: &Path) -> bool {
        folder.join(MANIFEST).is_file()
    }
}

#[cfg(test)]
mod tests {
    use std::fs;

    use crate::fixture::{Place, model, safetensors};
    use crate::model::Provenance;

    #[test]
    fn reads_back_unchanged_and_refuses_changed_files() {
        let (place, other) = (Place::local(), Place::local());
        let checkpoint = place.checkpoint("checkpoint", b"more weights");
        let weights = safetensors(b"weights");
        fs::write(checkpoint.join("weights.safetensors"), &weights).unwrap();
        let published =
            place.registry().publish(&model("approach"), &checkpoint, Provenance::default()).unwrap();
        let version = published.value().clone();
        let folder = place.path("hub");
        let reference = "approach".parse().unwrap();
        place.registry().export_huggingface(&reference, &folder, None).unwrap();
        assert_eq!(fs::read(folder.join("model.safetensors")).unwrap(), weights);
        assert!(!folder.join("weights.safetensors").exists());
        assert!(fs::read_to_string(folder.join("README.md")).unwrap().starts_with("---\n"));
        // Existing folders are never overwritten.
        assert!(place.registry().export_huggingface(&reference, &folder, None).is_err());

        // Users edit the card.
        fs::write(folder.join("README.md"), "ours").unwrap();
        let back = other.registry().import_huggingface(&model("approach"), &folder).unwrap();
        assert_eq!(back.value(), &version);
        assert!(other.registry().verify(None).unwrap().problems.is_empty());

        fs::write(folder.join("model.safetensors"), safetensors(b"weighty")).unwrap();
        let refusal = other.registry().import_huggingface(&model("second"), &folder).unwrap_err().to_string();
        assert!(refusal.contains("model.safetensors") && refusal.contains("digest"), "{refusal}");
        assert_eq!(other.registry().list().unwrap().len(), 1);
    }
}
