//! Versions as OCI image layouts, which tools for container registries can push.
//!
//! Source: <https://github.com/opencontainers/image-spec/blob/v1.1.0/image-layout.md>.

use std::collections::BTreeMap;
use std::path::Path;

use serde::Deserialize;
use serde_json::{Value, json};

use super::import::Import;
use crate::digest::Digest;
use crate::error::Result;
use crate::model::{ARTIFACT_TYPE, Descriptor, MANIFEST_TYPE, ModelName, ModelRef, ModelVersion};
use crate::operations::pull::{export, write_new};
use crate::outcome::Outcome;
use crate::registry::Registry;

const LAYOUT: &str = "oci-layout";
const LAYOUT_VERSION: &str = "1.0.0";
const INDEX: &str = "index.json";
const INDEX_TYPE: &str = "application/vnd.oci.image.index.v1+json";
const TAG: &str = "org.opencontainers.image.ref.name";

fn blob(digest: Digest) -> String {
    format!("blobs/sha256/{}", digest.hex())
}

/// Reads a JSON document.
fn read(import: &Import, key: &str) -> Result<Value> {
    serde_json::from_slice(&import.document(key)?).map_err(|error| import.refuse(key, error))
}

impl Registry {
    /// Writes the version that `reference` names into the new folder `destination`, as an OCI image layout with the version's
    /// number as its tag. Manifest and blobs are those of the registry, byte for byte.
    pub fn export_oci(&self, reference: &ModelRef, destination: &Path) -> Result<ModelVersion> {
        let version = self.show(reference)?;
        let bytes = self.store.document(&version.to_string(), version.digest)?;
        let index = json!({
            "schemaVersion": 2,
            "mediaType": INDEX_TYPE,
            "manifests": [{
                "mediaType": MANIFEST_TYPE,
                "artifactType": ARTIFACT_TYPE,
                "digest": version.digest,
                "size": bytes.len(),
                "annotations": { TAG: version.version.to_string() },
            }],
        });
        let layout = json!({ "imageLayoutVersion": LAYOUT_VERSION });
        export(&version, destination, &|root| {
            write_new(&root.join(blob(version.digest)), &bytes)?;
            // Files with the same content are one blob.
            let blobs: BTreeMap<_, _> = version.manifest.blobs().map(|blob| (blob.digest, blob)).collect();
            for (digest, descriptor) in blobs {
                self.write_blob(&version, descriptor, &root.join(blob(digest)))?;
            }
            write_new(&root.join(INDEX), index.to_string().as_bytes())?;
            write_new(&root.join(LAYOUT), layout.to_string().as_bytes())
        })?;
        Ok(version)
    }

    /// Publishes the one model in an OCI image layout as the next version of `name`. The manifest, its configuration and every
    /// file are first verified against their digests.
    pub fn import_oci(&self, name: &ModelName, folder: &Path) -> Result<Outcome<ModelVersion>> {
        let import = Import::open(folder)?;
        let version = &read(&import, LAYOUT)?["imageLayoutVersion"];
        if version != LAYOUT_VERSION {
            let reason = format!("has version {version}, this program reads {LAYOUT_VERSION}");
            return Err(import.refuse(LAYOUT, reason));
        }
        let manifests = Vec::<Descriptor>::deserialize(&read(&import, INDEX)?["manifests"]);
        let manifests = manifests.map_err(|error| import.refuse(INDEX, error))?;
        let [entry] = manifests.as_slice() else {
            let reason = format!("lists {} manifests; import layouts of one model", manifests.len());
            return Err(import.refuse(INDEX, reason));
        };
        import.verify(&blob(entry.digest), entry)?;
        let manifest = import.manifest(&blob(entry.digest))?;
        import.verify(&blob(manifest.config.digest), &manifest.config)?;
        import.publish(self, name, manifest, &|layer| blob(layer.digest))
    }

    /// Returns whether a folder looks like an OCI image layout.
    pub fn is_oci(folder: &Path) -> bool {
        folder.join(LAYOUT).is_file()
    }
}

#[cfg(test)]
mod tests {
    use std::fs;
    use std::path::PathBuf;

    use serde_json::Value;

    use super::*;
    use crate::fixture::{Place, flip, model};

    fn read(path: &Path) -> Value {
        serde_json::from_slice(&fs::read(path).unwrap()).unwrap()
    }

    /// Reads a layout by the specification, with no code of ours but the digest. Returns all blobs that it reaches.
    fn blobs_of(root: &Path) -> Vec<String> {
        assert_eq!(read(&root.join("oci-layout"))["imageLayoutVersion"], "1.0.0");
        let index = read(&root.join("index.json"));
        assert_eq!(index["schemaVersion"], 2);
        let open = |descriptor: &Value| {
            let digest = descriptor["digest"].as_str().unwrap();
            let (algorithm, hex) = digest.split_once(':').unwrap();
            let content = fs::read(root.join("blobs").join(algorithm).join(hex)).unwrap();
            assert_eq!(content.len() as u64, descriptor["size"].as_u64().unwrap());
            assert_eq!(Digest::of(&content).to_string(), digest);
            (hex.to_owned(), content)
        };
        let mut found = Vec::new();
        for entry in index["manifests"].as_array().unwrap() {
            let (hex, content) = open(entry);
            found.push(hex);
            let manifest: Value = serde_json::from_slice(&content).unwrap();
            assert_eq!(manifest["mediaType"], entry["mediaType"]);
            assert_eq!(manifest["artifactType"], entry["artifactType"]);
            found.push(open(&manifest["config"]).0);
            found.extend(manifest["layers"].as_array().unwrap().iter().map(|layer| open(layer).0));
        }
        found.sort();
        found.dedup();
        found
    }

    fn exported(place: &Place) -> (ModelVersion, PathBuf) {
        let registry = place.registry();
        place.publish(&registry, "approach", b"weights one");
        let version = place.publish(&registry, "approach", b"weights two");
        let folder = place.path("layout");
        registry.export_oci(&"approach@2".parse().unwrap(), &folder).unwrap();
        (version, folder)
    }

    #[test]
    fn is_a_layout_by_the_specification() {
        let place = Place::local();
        let (version, folder) = exported(&place);
        let mut stored: Vec<_> = fs::read_dir(folder.join("blobs/sha256"))
            .unwrap()
            .map(|entry| entry.unwrap().file_name().into_string().unwrap())
            .collect();
        stored.sort();
        assert_eq!(stored, blobs_of(&folder), "every blob is reached, and there is no other");
        let entry = &read(&folder.join("index.json"))["manifests"][0];
        assert_eq!(entry["digest"], version.digest.to_string());
        assert_eq!(entry["annotations"]["org.opencontainers.image.ref.name"], "2");
        assert!(place.registry().export_oci(&"approach@2".parse().unwrap(), &folder).is_err());
    }

    #[test]
    fn the_same_name_and_number_have_the_same_manifest() {
        for other in Place::all() {
            let (place, registry) = (Place::local(), other.registry());
            let (version, folder) = exported(&place);
            other.publish(&registry, "approach", b"weights one");
            let published = registry.import_oci(&model("approach"), &folder).unwrap();
            assert_eq!(published, Outcome::New(version.clone()));
            let again = registry.import_oci(&model("approach"), &folder).unwrap();
            assert_eq!(again, Outcome::AlreadyThere(version.clone()));
            // Under another name it is another version of the same files.
            let renamed = registry.import_oci(&model("champion"), &folder).unwrap().value().clone();
            assert_eq!(renamed.to_string(), "champion@1");
            assert_ne!(renamed.digest, version.digest);
            assert_eq!(renamed.manifest.layers, version.manifest.layers);
            assert!(registry.verify(None).unwrap().problems.is_empty());
        }
    }

    #[test]
    fn damage_is_found_in_every_blob_and_nothing_is_published() {
        let (place, other) = (Place::local(), Place::local());
        let (_, folder) = exported(&place);
        let registry = other.registry();
        for hex in blobs_of(&folder) {
            let key = format!("blobs/sha256/{hex}");
            let intact = fs::read(folder.join(&key)).unwrap();
            flip(&folder, &key);
            let refusal = registry.import_oci(&model("approach"), &folder).unwrap_err().to_string();
            assert!(refusal.contains(&hex) && refusal.contains("has digest"), "{refusal}");
            fs::remove_file(folder.join(&key)).unwrap();
            assert!(registry.import_oci(&model("approach"), &folder).unwrap_err().to_string().contains(&hex));
            fs::write(folder.join(&key), intact).unwrap();
        }
        assert!(registry.list().unwrap().is_empty());
        fs::write(folder.join("oci-layout"), r#"{"imageLayoutVersion":"2.0.0"}"#).unwrap();
        assert!(registry.import_oci(&model("approach"), &folder).unwrap_err().to_string().contains("2.0.0"));
    }

    #[cfg(unix)]
    #[test]
    fn links_are_not_followed() {
        let (place, other) = (Place::local(), Place::local());
        let (version, folder) = exported(&place);
        let path = folder.join(blob(version.manifest.layers[2].digest));
        let elsewhere = place.path("elsewhere");
        fs::rename(&path, &elsewhere).unwrap();
        std::os::unix::fs::symlink(&elsewhere, &path).unwrap();
        let refusal = other.registry().import_oci(&model("approach"), &folder).unwrap_err().to_string();
        assert!(refusal.contains("is a symbolic link"), "{refusal}");
    }
}
