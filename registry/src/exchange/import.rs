//! Importing exported models: verified, then published.

use std::path::Path;

use crate::error::{Error, Result};
use crate::model::{Descriptor, Manifest, ModelName, ModelVersion, model_config};
use crate::outcome::Outcome;
use crate::problem::Fault;
use crate::registry::Registry;
use crate::store::{DOCUMENT_LIMIT, Store};

/// An exported model: a folder whose files are not trusted. No link in it is followed, as in a registry.
pub(super) struct Import(Store);

impl Import {
    pub(super) fn open(folder: &Path) -> Result<Self> {
        Ok(Self(Store::open(&folder.into())?))
    }

    /// Refuses the file `key`.
    pub(super) fn refuse(&self, key: &str, reason: impl std::fmt::Display) -> Error {
        Error::refused(&format!("{}/{key}", self.0.root), format!("{reason}; nothing was published"))
    }

    /// States which folder a problem is in.
    fn located<T>(&self, result: Result<T>) -> Result<T> {
        result.map_err(|error| match error {
            Error::Damaged(problem) => self.refuse(&problem.object, problem.fault),
            error => error,
        })
    }

    /// Reads a small document.
    pub(super) fn document(&self, key: &str) -> Result<Vec<u8>> {
        let bytes = self.located(self.0.read(key))?.ok_or_else(|| self.refuse(key, Fault::Missing))?;
        if bytes.len() as u64 > DOCUMENT_LIMIT {
            return Err(self.refuse(key, format!("has more than {DOCUMENT_LIMIT} bytes")));
        }
        Ok(bytes)
    }

    /// Parses the manifest.
    pub(super) fn manifest(&self, key: &str) -> Result<Manifest> {
        Manifest::parse(&self.document(key)?).map_err(|reason| self.refuse(key, reason))
    }

    /// Verifies that the file `key` has the content that `expected` states.
    pub(super) fn verify(&self, key: &str, expected: &Descriptor) -> Result<()> {
        let found = self.located(self.0.inspect(key))?;
        Fault::of_blob(expected.content(), found).map_or(Ok(()), |fault| Err(self.refuse(key, fault)))
    }

    /// Publishes the model, whose files lie under the keys that `locate` returns, as the next version of `name`. Under its own
    /// name, it keeps its manifest byte for byte.
    pub(super) fn publish(
        &self,
        registry: &Registry,
        name: &ModelName,
        mut manifest: Manifest,
        locate: &dyn Fn(&Descriptor) -> String,
    ) -> Result<Outcome<ModelVersion>> {
        // Everything is verified before anything is stored.
        manifest.layers.iter().try_for_each(|layer| self.verify(&locate(layer), layer))?;
        self.located(registry.transfer(&self.0, manifest.layers.iter(), locate))?;
        let config = model_config(name, &manifest.layers);
        manifest.rename(name, &config);
        registry.store.put_blob(config)?;
        registry
            .add_version(name, &manifest, &manifest.to_bytes()?, &|_, found| found.has_files_of(&manifest))
    }
}

#[cfg(test)]
mod tests {
    use serde_json::Value;

    use super::*;
    use std::fs;
    use std::path::PathBuf;

    use crate::digest::Digest;
    use crate::fixture::{Place, model, safetensors};
    use crate::model::Provenance;

    /// Exports a version in both formats, `oci` and `huggingface`.
    fn exported(place: &Place) {
        let registry = place.registry();
        let checkpoint = place.checkpoint("checkpoint", b"more");
        fs::write(checkpoint.join("weights.safetensors"), safetensors(b"weights")).unwrap();
        registry.publish(&model("approach"), &checkpoint, Provenance::default()).unwrap();
        let reference = "approach".parse().unwrap();
        registry.export_oci(&reference, &place.path("oci")).unwrap();
        registry.export_huggingface(&reference, &place.path("huggingface"), None).unwrap();
    }

    fn read(path: &Path) -> Value {
        serde_json::from_slice(&fs::read(path).unwrap()).unwrap()
    }

    /// Returns the path of the manifest in the layout.
    fn oci_manifest(layout: &Path) -> PathBuf {
        let digest = read(&layout.join("index.json"))["manifests"][0]["digest"].as_str().unwrap().to_owned();
        layout.join("blobs/sha256").join(digest.strip_prefix("sha256:").unwrap())
    }

    /// Changes the manifest in both formats. In the layout, the index names the new one.
    fn change(place: &Place, lie: &dyn Fn(&mut Value)) {
        let path = place.path("huggingface/manifest.json");
        let mut manifest = read(&path);
        lie(&mut manifest);
        let bytes = manifest.to_string().into_bytes();
        fs::write(path, &bytes).unwrap();
        let (layout, digest) = (place.path("oci"), Digest::of(&bytes));
        fs::write(layout.join("blobs/sha256").join(digest.hex()), &bytes).unwrap();
        change_index(&layout, &|index| {
            index["manifests"][0]["digest"] = digest.to_string().into();
            index["manifests"][0]["size"] = bytes.len().into();
        });
    }

    fn change_index(layout: &Path, lie: &dyn Fn(&mut Value)) {
        let path = layout.join("index.json");
        let mut index = read(&path);
        lie(&mut index);
        fs::write(path, index.to_string()).unwrap();
    }

    fn set_path(manifest: &mut Value, path: &str) {
        manifest["layers"][0]["annotations"]["org.cncf.model.filepath"] = path.into();
    }

    /// Asserts that nothing is published or stored, and that the error states why.
    fn refused(place: &Place, format: &str, reason: &str) {
        let registry = Registry::init(&place.path("other").as_path().into()).unwrap();
        let name = model("approach");
        let folder = place.path(format);
        let imported = if format == "oci" {
            registry.import_oci(&name, &folder)
        } else {
            registry.import_huggingface(&name, &folder)
        };
        let refusal = imported.unwrap_err().to_string();
        assert!(refusal.contains(reason), "{format}, {reason}: {refusal}");
        let stored: Vec<_> =
            registry.store.walk("").unwrap().objects.into_iter().map(|object| object.key).collect();
        assert_eq!(stored, ["registry.json"]);
    }

    #[test]
    fn lying_manifests_are_refused() {
        type Lie = fn(&mut Value);
        let cases: [(&str, Lie); 9] = [
            ("bytes, expected 0", |m| m["layers"][0]["size"] = 0.into()),
            ("bytes, expected 18446744073709551615", |m| m["layers"][0]["size"] = u64::MAX.into()),
            ("is not a digest", |m| m["layers"][0]["digest"] = "sha256:../../x".into()),
            ("`../x` cannot be a file", |m| set_path(m, "../x")),
            ("`/x` cannot be a file", |m| set_path(m, "/x")),
            ("`C:\\x` cannot be a file", |m| set_path(m, "C:\\x")),
            ("is both a file and the folder", |m| set_path(m, "state/step.json/x")),
            ("is not a model name", |m| m["annotations"]["org.opencontainers.image.title"] = "../x".into()),
            ("recursion limit", |m| {
                let mut deep = Value::Null;
                for _ in 0..200 {
                    deep = Value::Array(vec![deep]);
                }
                m["interface"] = serde_json::json!({ "x": deep });
            }),
        ];
        let place = Place::local();
        exported(&place);
        let intact = fs::read(place.path("huggingface/manifest.json")).unwrap();
        for (reason, lie) in cases {
            fs::write(place.path("huggingface/manifest.json"), &intact).unwrap();
            change(&place, &lie);
            refused(&place, "oci", reason);
            refused(&place, "huggingface", reason);
        }
    }

    #[test]
    fn a_lying_index_is_refused() {
        type Lie = fn(&mut Value);
        let cases: [(&str, Lie); 5] = [
            ("bytes, expected 0", |index| index["manifests"][0]["size"] = 0.into()),
            ("expected 18446744073709551615", |index| {
                index["manifests"][0]["size"] = u64::MAX.into();
            }),
            ("is not a digest", |index| index["manifests"][0]["digest"] = "sha256:../../index.json".into()),
            ("lists 0 manifests", |index| index["manifests"] = Value::Array(Vec::new())),
            ("more than 4194304 bytes", |index| index["x"] = " ".repeat(5 << 20).into()),
        ];
        let place = Place::local();
        exported(&place);
        let intact = fs::read(place.path("oci/index.json")).unwrap();
        for (reason, lie) in cases {
            change_index(&place.path("oci"), &lie);
            refused(&place, "oci", reason);
            fs::write(place.path("oci/index.json"), &intact).unwrap();
        }
        fs::write(place.path("huggingface/manifest.json"), vec![b' '; 5 << 20]).unwrap();
        refused(&place, "huggingface", "more than 4194304 bytes");
    }

    /// Weights with the right digest and a wrong header.
    #[test]
    fn weights_that_programs_read_differently_are_refused() {
        let place = Place::local();
        exported(&place);
        let weights = [u64::MAX.to_le_bytes(), *b"{}      "].concat();
        let digest = Digest::of(&weights);
        fs::write(place.path("huggingface/model.safetensors"), &weights).unwrap();
        fs::write(place.path("oci/blobs/sha256").join(digest.hex()), &weights).unwrap();
        change(&place, &|manifest| {
            let layers = manifest["layers"].as_array_mut().unwrap();
            let layer =
                layers.iter_mut().find(|layer| layer.to_string().contains("weights.safetensors")).unwrap();
            layer["digest"] = digest.to_string().into();
            layer["size"] = 16.into();
        });
        refused(&place, "oci", "its header claims 18446744073709551615 bytes");
        refused(&place, "huggingface", "its header claims 18446744073709551615 bytes");
        let published = place.checkpoint("lying", b"x");
        fs::write(published.join("weights.safetensors"), &weights).unwrap();
        let refusal =
            place.registry().publish(&model("lying"), &published, Provenance::default()).unwrap_err();
        assert!(refusal.to_string().contains("weights.safetensors is not a safetensors file"), "{refusal}");
        assert_eq!(place.registry().list().unwrap().len(), 1);
    }

    /// Every file that the import reads, in turn.
    #[cfg(unix)]
    #[test]
    fn links_and_pipes_are_not_followed() {
        use std::os::unix::fs::symlink;

        let place = Place::local();
        exported(&place);
        let oci = place.path("oci");
        let manifest = read(&oci_manifest(&oci));
        let blob = |descriptor: &Value| {
            format!("oci/blobs/{}", descriptor["digest"].as_str().unwrap().replacen(':', "/", 1))
        };
        let mut read = vec!["oci/oci-layout".into(), "oci/index.json".into(), blob(&manifest["config"])];
        read.extend(manifest["layers"].as_array().unwrap().iter().map(blob));
        read.push(oci_manifest(&oci).strip_prefix(place.path("")).unwrap().display().to_string());
        let hub = ["manifest.json", "model.safetensors", "config.toml", "state/step.json"];
        read.extend(hub.map(|file| format!("huggingface/{file}")));
        for file in read {
            let format = file.split('/').next().unwrap();
            fs::rename(place.path(&file), place.path("elsewhere")).unwrap();
            symlink(place.path("elsewhere"), place.path(&file)).unwrap();
            refused(&place, format, "is a symbolic link");
            fs::remove_file(place.path(&file)).unwrap();
            assert!(std::process::Command::new("mkfifo").arg(place.path(&file)).status().unwrap().success());
            refused(&place, format, "special file");
            fs::rename(place.path("elsewhere"), place.path(&file)).unwrap();
        }
        let other = Registry::init(&place.path("other").as_path().into()).unwrap();
        other.import_oci(&model("approach"), &oci).unwrap();
        other.import_huggingface(&model("hub"), &place.path("huggingface")).unwrap();
    }
}
