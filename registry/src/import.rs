//! Versions that come from elsewhere: verified, then published.

use std::fs::{self, File};
use std::io::Read;
use std::path::{Path, PathBuf};

use crate::checkpoint::fingerprint;
use crate::digest::Digest;
use crate::error::{Error, Result};
use crate::manifest::{Descriptor, Manifest, model_config};
use crate::name::ModelName;
use crate::publish::Published;
use crate::registry::Registry;
use crate::safetensors;
use crate::store::DOCUMENT_LIMIT;

/// A manifest of another registry.
pub(crate) struct Foreign {
    manifest: Manifest,
    /// Where it was read, for messages.
    place: PathBuf,
}

impl Foreign {
    /// Reads a manifest.
    pub(crate) fn parse(bytes: &[u8], place: &Path) -> Result<Self> {
        let refuse = |reason| Error::Import { path: place.to_owned(), reason };
        let manifest = Manifest::parse_foreign(bytes).map_err(refuse)?;
        Ok(Self { manifest, place: place.to_owned() })
    }

    /// The descriptor of its configuration.
    pub(crate) fn config(&self) -> &Descriptor {
        &self.manifest.config
    }
}

impl Registry {
    /// Publishes a version that comes from elsewhere, whose files lie where `place` says, as the next version of `name`. If name
    /// and number are those that it had, its manifest stays the same byte for byte.
    pub(crate) fn adopt(
        &self,
        name: &ModelName,
        foreign: Foreign,
        place: &dyn Fn(&Descriptor) -> PathBuf,
    ) -> Result<Published> {
        let Foreign { mut manifest, place: origin } = foreign;
        for layer in &manifest.layers {
            let source = place(layer);
            check(layer, &source)?;
            if let Err(reason) = safetensors::check_file(layer.path().unwrap_or_default(), &source)? {
                return Err(Error::Import { path: source, reason });
            }
        }
        let config = model_config(name, &manifest.layers)
            .map_err(|error| Error::Import { path: origin, reason: error.to_string() })?;
        manifest.rename(name, &config);
        let mut references = None;
        for layer in &manifest.layers {
            let source = place(layer);
            if self.keep_file(&source, &mut references)? != layer.content() {
                let reason = "changed while it was imported; import again when it is complete".to_owned();
                return Err(Error::Import { path: source, reason });
            }
        }
        self.store.put_blob(Digest::of(&config), config)?;
        self.number(name, manifest)
    }
}

/// Checks that a plain file holds what `expected` says.
pub(crate) fn check(expected: &Descriptor, source: &Path) -> Result<()> {
    let refuse = |reason| Error::Import { path: source.to_owned(), reason };
    let size = plain_size(source)?;
    if size != expected.size {
        return Err(refuse(format!("has {size} bytes, the manifest says {}", expected.size)));
    }
    let found = fingerprint(source)?;
    if found != expected.content() {
        return Err(refuse(format!("has digest {}, the manifest says {}", found.digest, expected.digest)));
    }
    Ok(())
}

/// Bytes of a plain file; links are not followed.
fn plain_size(path: &Path) -> Result<u64> {
    let metadata = fs::symlink_metadata(path).map_err(Error::io("read", path))?;
    if metadata.is_file() {
        return Ok(metadata.len());
    }
    let reason = "is no plain file; a model holds no links".to_owned();
    Err(Error::Import { path: path.to_owned(), reason })
}

/// A small document.
pub(crate) fn read_document(path: &Path) -> Result<Vec<u8>> {
    plain_size(path)?;
    let mut bytes = Vec::new();
    let read = File::open(path).and_then(|file| file.take(DOCUMENT_LIMIT + 1).read_to_end(&mut bytes));
    read.map_err(Error::io("read", path))?;
    if bytes.len() as u64 > DOCUMENT_LIMIT {
        let reason = format!("has more than {DOCUMENT_LIMIT} bytes");
        return Err(Error::Import { path: path.to_owned(), reason });
    }
    Ok(bytes)
}

#[cfg(test)]
mod tests {
    use serde_json::Value;

    use super::*;
    use crate::digest::Digest;
    use crate::fixture::{Place, model, safetensors};
    use crate::manifest::Provenance;

    /// A version in both forms, `oci` and `huggingface`.
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

    /// Where the manifest lies in the layout.
    fn oci_manifest(layout: &Path) -> PathBuf {
        let digest = read(&layout.join("index.json"))["manifests"][0]["digest"].as_str().unwrap().to_owned();
        layout.join("blobs/sha256").join(digest.strip_prefix("sha256:").unwrap())
    }

    /// Changes the manifest in both forms; in the layout the index names the new one.
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

    /// Nothing is published and nothing stored, and the refusal says why.
    fn refused(place: &Place, form: &str, told: &str) {
        let registry = Registry::init(&place.path("other")).unwrap();
        let name = model("approach");
        let folder = place.path(form);
        let imported = if form == "oci" {
            registry.import_oci(&name, &folder)
        } else {
            registry.import_huggingface(&name, &folder)
        };
        let refusal = imported.unwrap_err().to_string();
        assert!(refusal.contains(told), "{form}, {told}: {refusal}");
        let stored: Vec<_> = registry.store.walk("").unwrap().into_iter().map(|object| object.key).collect();
        assert_eq!(stored, ["registry.json"]);
    }

    #[test]
    fn manifests_that_lie_are_refused() {
        type Lie = fn(&mut Value);
        let cases: [(&str, Lie); 9] = [
            ("bytes, the manifest says 0", |m| m["layers"][0]["size"] = 0.into()),
            ("bytes, the manifest says 18446744073709551615", |m| m["layers"][0]["size"] = u64::MAX.into()),
            ("is not a digest", |m| m["layers"][0]["digest"] = "sha256:../../x".into()),
            ("`../x` cannot be a file", |m| set_path(m, "../x")),
            ("`/x` cannot be a file", |m| set_path(m, "/x")),
            ("`C:\\x` cannot be a file", |m| set_path(m, "C:\\x")),
            ("is a file and the folder", |m| set_path(m, "state/step.json/x")),
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
        for (told, lie) in cases {
            fs::write(place.path("huggingface/manifest.json"), &intact).unwrap();
            change(&place, &lie);
            refused(&place, "oci", told);
            refused(&place, "huggingface", told);
        }
    }

    #[test]
    fn an_index_that_lies_is_refused() {
        type Lie = fn(&mut Value);
        let cases: [(&str, Lie); 5] = [
            ("bytes, the manifest says 0", |index| index["manifests"][0]["size"] = 0.into()),
            ("the manifest says 18446744073709551615", |index| {
                index["manifests"][0]["size"] = u64::MAX.into();
            }),
            ("is not a digest", |index| index["manifests"][0]["digest"] = "sha256:../../index.json".into()),
            ("names 0 manifests", |index| index["manifests"] = Value::Array(Vec::new())),
            ("more than 4194304 bytes", |index| index["x"] = " ".repeat(5 << 20).into()),
        ];
        let place = Place::local();
        exported(&place);
        let intact = fs::read(place.path("oci/index.json")).unwrap();
        for (told, lie) in cases {
            change_index(&place.path("oci"), &lie);
            refused(&place, "oci", told);
            fs::write(place.path("oci/index.json"), &intact).unwrap();
        }
        fs::write(place.path("huggingface/manifest.json"), vec![b' '; 5 << 20]).unwrap();
        refused(&place, "huggingface", "more than 4194304 bytes");
    }

    /// Weights whose digest is right, and whose header is not.
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
        assert!(refusal.to_string().contains("weights.safetensors: is no safetensors file"), "{refusal}");
        assert_eq!(place.registry().list().unwrap().len(), 1);
    }

    /// Whatever the import reads, in turn.
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
            let form = file.split('/').next().unwrap();
            fs::rename(place.path(&file), place.path("elsewhere")).unwrap();
            symlink(place.path("elsewhere"), place.path(&file)).unwrap();
            refused(&place, form, "no links");
            fs::remove_file(place.path(&file)).unwrap();
            assert!(std::process::Command::new("mkfifo").arg(place.path(&file)).status().unwrap().success());
            refused(&place, form, "is no plain file");
            fs::rename(place.path("elsewhere"), place.path(&file)).unwrap();
        }
        let other = Registry::init(&place.path("other")).unwrap();
        other.import_oci(&model("approach"), &oci).unwrap();
        other.import_huggingface(&model("hub"), &place.path("huggingface")).unwrap();
    }
}
