//! Manifests: the files of a version, where it comes from and how good it is.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};
use serde_json::{Value, json};

use super::checkpoint::check_paths;
use super::reference::ModelName;
use crate::digest::{Digest, Fingerprint};
use crate::error::{Error, Result};
use crate::store::sequence::encode;

pub(crate) const MANIFEST_TYPE: &str = "application/vnd.oci.image.manifest.v1+json";
pub(crate) const ARTIFACT_TYPE: &str = "application/vnd.cncf.model.manifest.v1+json";
const CONFIG_TYPE: &str = "application/vnd.cncf.model.config.v1+json";
const FILE_PATH: &str = "org.cncf.model.filepath";
const TITLE: &str = "org.opencontainers.image.title";
const CREATED: &str = "org.opencontainers.image.created";

/// An OCI image manifest with the media types of the CNCF model format, and three properties of our own: `lineage`, `metrics`
/// and `interface`.
///
/// It serializes to the same bytes on every machine: fields in this order, maps sorted by key. It does not contain the version's
/// number, so its digest is the same in every registry.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "camelCase")]
#[non_exhaustive]
pub struct Manifest {
    /// 2, as OCI requires.
    pub schema_version: u32,
    /// Media type of an OCI image manifest.
    pub media_type: String,
    /// Media type of a model in the CNCF format.
    pub artifact_type: String,
    /// Configuration in the CNCF model format.
    pub config: Descriptor,
    /// The checkpoint's files, sorted by path.
    pub layers: Vec<Descriptor>,
    /// Model name and, if the publisher stated it, time of creation, under OCI's keys.
    pub annotations: BTreeMap<String, String>,
    /// Where the model comes from.
    pub lineage: Lineage,
    /// Metrics at publication: name, ending in its unit (`position_error_mm`), and value.
    /// [`Registry::metrics`](crate::Registry::metrics) includes later evaluations.
    pub metrics: BTreeMap<String, f64>,
    /// Inputs and outputs, in the publisher's words.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub interface: BTreeMap<String, Value>,
}

/// Describes a blob: a file, a configuration or an attachment.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "camelCase")]
#[non_exhaustive]
pub struct Descriptor {
    /// Media type of the content.
    pub media_type: String,
    /// SHA-256 of the content.
    pub digest: Digest,
    /// Size of the content in bytes.
    pub size: u64,
    /// For a layer, its path in the checkpoint.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub annotations: BTreeMap<String, String>,
}

/// Where a model comes from: enough to train it again. Unknown parts are omitted.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "camelCase", default)]
pub struct Lineage {
    /// Training datasets: name and digest.
    pub datasets: BTreeMap<String, Digest>,
    /// Digest of the training configuration.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub config: Option<Digest>,
    /// Manifest digest of the version whose weights training started from.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub parent: Option<Digest>,
    /// Revision of the training code.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub code_revision: Option<String>,
    /// Seed of the training run.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub seed: Option<u64>,
    /// Device of the training run.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub device: Option<String>,
    /// Programs and libraries: name and version.
    pub software: BTreeMap<String, String>,
}

/// What is published along with a checkpoint's files.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Provenance {
    /// Where the model comes from.
    pub lineage: Lineage,
    /// Metrics: name, ending in its unit, and finite value.
    pub metrics: BTreeMap<String, f64>,
    /// Inputs and outputs, for people and for programs that know the publisher.
    pub interface: BTreeMap<String, Value>,
    /// Time of creation, in RFC 3339 (`2026-11-22T10:00:00Z`). The registry has no clock of its own.
    pub created: Option<String>,
    /// Known digests of files, by path. If a file has another digest, nothing is published.
    pub expected: BTreeMap<String, Digest>,
}

impl Descriptor {
    /// Describes the document `content`.
    pub(crate) fn document(media_type: &str, content: &[u8]) -> Self {
        let (media_type, size) = (media_type.to_owned(), content.len() as u64);
        Self { media_type, digest: Digest::of(content), size, annotations: BTreeMap::new() }
    }

    /// Describes the checkpoint's file `path`.
    pub(crate) fn file(path: &str, content: Fingerprint) -> Self {
        let extension = path.rsplit_once('.').map_or("", |(_, extension)| extension);
        let kind = match extension {
            "safetensors" | "bpk" => "weight",
            "md" | "txt" | "html" | "svg" | "png" => "doc",
            _ => "weight.config",
        };
        Self {
            media_type: format!("application/vnd.cncf.model.{kind}.v1.raw"),
            digest: content.digest,
            size: content.size,
            annotations: BTreeMap::from([(FILE_PATH.into(), path.into())]),
        }
    }

    /// Returns a layer's path in the checkpoint, with parts separated by `/`.
    pub fn path(&self) -> Option<&str> {
        self.annotations.get(FILE_PATH).map(String::as_str)
    }

    /// Returns the expected content of the blob.
    pub(crate) fn content(&self) -> Fingerprint {
        Fingerprint { digest: self.digest, size: self.size }
    }
}

impl Manifest {
    /// Creates the manifest of a version of `name`. `config` is its configuration, see [`model_config`].
    pub(crate) fn new(
        name: &ModelName,
        config: &[u8],
        layers: Vec<Descriptor>,
        provenance: Provenance,
    ) -> Self {
        let mut annotations = BTreeMap::from([(TITLE.into(), name.to_string())]);
        annotations.extend(provenance.created.map(|time| (CREATED.into(), time)));
        Self {
            schema_version: 2,
            media_type: MANIFEST_TYPE.into(),
            artifact_type: ARTIFACT_TYPE.into(),
            config: Descriptor::document(CONFIG_TYPE, config),
            layers,
            annotations,
            lineage: provenance.lineage,
            metrics: provenance.metrics,
            interface: provenance.interface,
        }
    }

    /// Makes this the manifest of a version of another model.
    pub(crate) fn rename(&mut self, name: &ModelName, config: &[u8]) {
        self.annotations.insert(TITLE.into(), name.to_string());
        self.config = Descriptor::document(CONFIG_TYPE, config);
    }

    /// Returns the name of the model.
    pub(crate) fn name(&self) -> &str {
        self.annotations.get(TITLE).map_or("", String::as_str)
    }

    /// Returns the time of creation, if the publisher stated it.
    pub fn created(&self) -> Option<&str> {
        self.annotations.get(CREATED).map(String::as_str)
    }

    /// Returns all blobs of the version: its configuration and its files.
    pub(crate) fn blobs(&self) -> impl Iterator<Item = &Descriptor> + Clone {
        std::iter::once(&self.config).chain(&self.layers)
    }

    /// Returns the digests of the files by path.
    pub(crate) fn files(&self) -> BTreeMap<String, Digest> {
        let file = |layer: &Descriptor| (layer.path().unwrap_or_default().to_owned(), layer.digest);
        self.layers.iter().map(file).collect()
    }

    /// Returns whether another version has the same files and configuration.
    pub(crate) fn has_files_of(&self, other: &Self) -> bool {
        self.config == other.config && self.layers == other.layers
    }

    /// Serializes the manifest.
    pub(crate) fn to_bytes(&self) -> Result<Vec<u8>> {
        encode(&self.name(), self)
    }

    /// Parses a manifest. The error describes what is wrong with it.
    pub(crate) fn parse(bytes: &[u8]) -> std::result::Result<Self, String> {
        let manifest: Self = serde_json::from_slice(bytes).map_err(|error| error.to_string())?;
        for (what, found, expected) in [
            ("schemaVersion", manifest.schema_version.to_string().as_str(), "2"),
            ("mediaType", &manifest.media_type, MANIFEST_TYPE),
            ("artifactType", &manifest.artifact_type, ARTIFACT_TYPE),
            ("config.mediaType", &manifest.config.media_type, CONFIG_TYPE),
        ] {
            if found != expected {
                return Err(format!("{what} is `{found}`, expected `{expected}`"));
            }
        }
        manifest.name().parse::<ModelName>().map_err(|error: Error| format!("{TITLE}: {error}"))?;
        if manifest.layers.is_empty() {
            return Err("it names no files".into());
        }
        check_paths(manifest.layers.iter().map(|layer| layer.path().unwrap_or_default()))?;
        Ok(manifest)
    }
}

/// Builds the configuration of the CNCF model format, in its required parts. It depends only on the name and the files, so that
/// equal checkpoints have equal configurations.
pub(crate) fn model_config(name: &ModelName, layers: &[Descriptor]) -> Vec<u8> {
    let is_safetensors = |layer: &Descriptor| layer.path().is_some_and(|path| path.ends_with(".safetensors"));
    let format =
        if layers.iter().any(is_safetensors) { json!({ "format": "safetensors" }) } else { json!({}) };
    let digests: Vec<_> = layers.iter().map(|layer| layer.digest).collect();
    let modelfs = json!({ "type": "layers", "diffIds": digests });
    let document = json!({ "descriptor": { "name": name }, "config": format, "modelfs": modelfs });
    format!("{document}\n").into_bytes()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn sample() -> Manifest {
        let name: ModelName = "approach".parse().unwrap();
        let content = Fingerprint { digest: Digest::of(b"abc"), size: 3 };
        let layers = vec![Descriptor::file("weights.safetensors", content)];
        let provenance = Provenance {
            lineage: Lineage { seed: Some(u64::MAX), ..Lineage::default() },
            metrics: BTreeMap::from([("position_error_mm".into(), 0.1 + 0.2), ("b".into(), 5e-324)]),
            interface: BTreeMap::from([("input".into(), serde_json::json!({ "scale": 2.0 / 255.0 }))]),
            ..Provenance::default()
        };
        Manifest::new(&name, &model_config(&name, &layers), layers, provenance)
    }

    /// The format that OCI and the CNCF model format prescribe, checked on the raw JSON.
    #[test]
    fn has_the_shape_of_oci_and_cncf() {
        let json: serde_json::Value = serde_json::from_slice(&sample().to_bytes().unwrap()).unwrap();
        assert_eq!(json["schemaVersion"], 2);
        assert_eq!(json["mediaType"], "application/vnd.oci.image.manifest.v1+json");
        assert_eq!(json["artifactType"], "application/vnd.cncf.model.manifest.v1+json");
        assert_eq!(json["config"]["mediaType"], "application/vnd.cncf.model.config.v1+json");
        let layer = &json["layers"][0];
        assert_eq!(layer["mediaType"], "application/vnd.cncf.model.weight.v1.raw");
        assert_eq!(layer["size"], 3);
        assert_eq!(layer["annotations"]["org.cncf.model.filepath"], "weights.safetensors");
        assert!(layer["digest"].as_str().unwrap().starts_with("sha256:ba7816bf"));
    }

    #[test]
    fn reads_back_exactly_and_ignores_unknown_fields() {
        let manifest = sample();
        assert_eq!(Manifest::parse(&manifest.to_bytes().unwrap()).unwrap(), manifest);
        let mut json: serde_json::Value = serde_json::from_slice(&manifest.to_bytes().unwrap()).unwrap();
        json["subject"] = serde_json::json!({ "digest": "of a later format" });
        assert_eq!(Manifest::parse(json.to_string().as_bytes()).unwrap(), manifest);
    }

    #[test]
    fn malformed_manifests_are_described() {
        let refusal = |edit: fn(&mut Manifest)| {
            let mut manifest = sample();
            edit(&mut manifest);
            Manifest::parse(&manifest.to_bytes().unwrap()).unwrap_err()
        };
        assert!(refusal(|m| m.schema_version = 1).contains("schemaVersion is `1`, expected `2`"));
        assert!(refusal(|m| m.layers.clear()).contains("no files"));
        assert!(refusal(|m| m.layers.push(m.layers[0].clone())).contains("occurs twice"));
        assert!(refusal(|m| drop(m.annotations.remove(TITLE))).contains("is not a model name"));
        let evil = |m: &mut Manifest| {
            m.layers[0].annotations.insert(FILE_PATH.into(), "../../etc/passwd".into());
        };
        assert!(refusal(evil).contains("../../etc/passwd"));
    }

    /// Two versions with the same files share it.
    #[test]
    fn configurations_depend_on_name_and_files_alone() {
        let manifest = sample();
        let config = model_config(&"approach".parse().unwrap(), &manifest.layers);
        let digest = manifest.layers[0].digest;
        let expected = format!(
            "{{\"config\":{{\"format\":\"safetensors\"}},\"descriptor\":{{\"name\":\"approach\"}},\"modelfs\":{{\
             \"diffIds\":[\"{digest}\"],\"type\":\"layers\"}}}}\n"
        );
        assert_eq!(String::from_utf8(config).unwrap(), expected);
    }
}
