//! The manifest of a version: which files it has, where it comes from, how good it is.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};
use serde_json::Value;

use crate::checkpoint::check_paths;
use crate::digest::{Digest, Fingerprint};
use crate::error::Error;
use crate::name::ModelName;

pub(crate) const MANIFEST_TYPE: &str = "application/vnd.oci.image.manifest.v1+json";
pub(crate) const ARTIFACT_TYPE: &str = "application/vnd.cncf.model.manifest.v1+json";
const CONFIG_TYPE: &str = "application/vnd.cncf.model.config.v1+json";
const FILE_PATH: &str = "org.cncf.model.filepath";
const TITLE: &str = "org.opencontainers.image.title";
const VERSION: &str = "org.opencontainers.image.version";
const CREATED: &str = "org.opencontainers.image.created";

/// An OCI image manifest with the media types of the CNCF model format, and three properties of ours: `lineage`, `metrics` and
/// `interface`.
///
/// Serialized the same way on every machine: fields in this order, maps sorted by key.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "camelCase")]
#[non_exhaustive]
pub struct Manifest {
    /// 2, as OCI demands.
    pub schema_version: u32,
    /// Media type of an OCI image manifest.
    pub media_type: String,
    /// Media type of a model in the CNCF format.
    pub artifact_type: String,
    /// The CNCF model format's configuration.
    pub config: Descriptor,
    /// The checkpoint's files, sorted by path.
    pub layers: Vec<Descriptor>,
    /// Model name, version number and, if the publisher gave it, the time of creation, under OCI's keys.
    pub annotations: BTreeMap<String, String>,
    /// Where the model comes from.
    pub lineage: Lineage,
    /// How good it was when it was published: name, with its unit as the last part (`position_error_mm`), and value.
    /// [`Registry::metrics`](crate::Registry::metrics) also knows what was measured since.
    pub metrics: BTreeMap<String, f64>,
    /// What goes in and what comes out, in the publisher's words.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub interface: BTreeMap<String, Value>,
}

/// One blob of a version, or of what is attached to it.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "camelCase")]
#[non_exhaustive]
pub struct Descriptor {
    /// What kind of content it is.
    pub media_type: String,
    /// SHA-256 of the content.
    pub digest: Digest,
    /// Bytes of the content.
    pub size: u64,
    /// For a layer, its path in the checkpoint.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub annotations: BTreeMap<String, String>,
}

/// Where a model comes from: enough to train it again. What is unknown is left out.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "camelCase", default)]
pub struct Lineage {
    /// The datasets that it was trained on: name and digest.
    pub datasets: BTreeMap<String, Digest>,
    /// Digest of the training configuration.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub config: Option<Digest>,
    /// Manifest digest of the version whose weights training began from.
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
    /// The programs and libraries that took part: name and version.
    pub software: BTreeMap<String, String>,
}

/// What is published with a checkpoint beside its files.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Provenance {
    /// Where the model comes from.
    pub lineage: Lineage,
    /// How good it is: name, with its unit as the last part, and finite value.
    pub metrics: BTreeMap<String, f64>,
    /// What goes in and what comes out, for people and for programs that know the publisher.
    pub interface: BTreeMap<String, Value>,
    /// When it was made, in RFC 3339 (`2026-11-22T10:00:00Z`). The registry has no clock of its own.
    pub created: Option<String>,
    /// Digests that files have to have, by path: what else is known of the checkpoint. If one has another, nothing is published.
    pub expected: BTreeMap<String, Digest>,
}

impl Descriptor {
    /// Describes the document `content`.
    pub(crate) fn document(media_type: &str, content: &[u8]) -> Self {
        let (media_type, size) = (media_type.to_owned(), content.len() as u64);
        Self { media_type, digest: Digest::of(content), size, annotations: BTreeMap::new() }
    }

    /// Describes the CNCF model format's configuration, the blob `content`.
    pub(crate) fn config(content: &[u8]) -> Self {
        Self::document(CONFIG_TYPE, content)
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

    /// For a layer, its path in the checkpoint, with parts separated by `/`.
    pub fn path(&self) -> Option<&str> {
        self.annotations.get(FILE_PATH).map(String::as_str)
    }

    /// What the blob must hold.
    pub(crate) fn content(&self) -> Fingerprint {
        Fingerprint { digest: self.digest, size: self.size }
    }
}

impl Manifest {
    /// Of a version of `name` that has no number yet; `config` is the blob of its configuration.
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
            config: Descriptor::config(config),
            layers,
            annotations,
            lineage: provenance.lineage,
            metrics: provenance.metrics,
            interface: provenance.interface,
        }
    }

    /// States which version this is.
    pub(crate) fn set_version(&mut self, number: u64) {
        self.annotations.insert(VERSION.into(), number.to_string());
    }

    /// When the version was created, if its publisher said so.
    pub fn created(&self) -> Option<&str> {
        self.annotations.get(CREATED).map(String::as_str)
    }

    /// Bytes of all files together.
    pub fn size(&self) -> u64 {
        self.layers.iter().fold(0, |sum, layer| sum.saturating_add(layer.size))
    }

    /// Makes it the manifest of a version of `name`, whose configuration is the blob `config`.
    pub(crate) fn rename(&mut self, name: &ModelName, config: &[u8]) {
        self.annotations.insert(TITLE.into(), name.to_string());
        self.config = Descriptor::config(config);
    }

    /// Reads a manifest of another registry, or says what is wrong with it.
    pub(crate) fn parse_foreign(bytes: &[u8]) -> Result<Self, String> {
        let manifest: Self = serde_json::from_slice(bytes).map_err(|error| error.to_string())?;
        let annotation = |key: &str| manifest.annotations.get(key).map_or("", String::as_str);
        let name = annotation(TITLE).parse().map_err(|error: Error| format!("{TITLE}: {error}"))?;
        let number = annotation(VERSION);
        let number = number.parse().map_err(|_| format!("{VERSION} is `{number}`, expected a number"))?;
        Self::parse(bytes, &name, number)
    }

    /// The bytes that are stored and digested.
    pub(crate) fn to_bytes(&self) -> serde_json::Result<Vec<u8>> {
        let mut bytes = serde_json::to_vec_pretty(self)?;
        bytes.push(b'\n');
        Ok(bytes)
    }

    /// Reads the manifest that stands at version `number` of `name`, or says what is wrong with it.
    pub(crate) fn parse(bytes: &[u8], name: &ModelName, number: u64) -> Result<Self, String> {
        let manifest: Self = serde_json::from_slice(bytes).map_err(|error| error.to_string())?;
        let states = |what: &str, found: &str, expected: &str| {
            if found == expected {
                Ok(())
            } else {
                Err(format!("{what} is `{found}`, expected `{expected}`"))
            }
        };
        let annotation = |key: &str| manifest.annotations.get(key).map_or("", String::as_str);
        states("schemaVersion", &manifest.schema_version.to_string(), "2")?;
        states("mediaType", &manifest.media_type, MANIFEST_TYPE)?;
        states("artifactType", &manifest.artifact_type, ARTIFACT_TYPE)?;
        states("config.mediaType", &manifest.config.media_type, CONFIG_TYPE)?;
        states(TITLE, annotation(TITLE), name.as_str())?;
        states(VERSION, annotation(VERSION), &number.to_string())?;
        if manifest.layers.is_empty() {
            return Err("it names no files".into());
        }
        check_paths(manifest.layers.iter().map(|layer| layer.path().unwrap_or_default()))?;
        Ok(manifest)
    }
}

/// The CNCF model format's configuration, in its required parts. It depends on nothing but the name and the files, so that equal
/// checkpoints have equal configurations.
#[derive(Serialize)]
struct ModelConfig<'a> {
    descriptor: ConfigDescriptor<'a>,
    config: Architecture,
    modelfs: ModelFs,
}

#[derive(Serialize)]
struct ConfigDescriptor<'a> {
    name: &'a ModelName,
}

#[derive(Serialize)]
struct Architecture {
    #[serde(skip_serializing_if = "Option::is_none")]
    format: Option<&'static str>,
}

#[derive(Serialize)]
#[serde(rename_all = "camelCase")]
struct ModelFs {
    r#type: &'static str,
    diff_ids: Vec<Digest>,
}

/// The configuration blob of a model with these files.
pub(crate) fn model_config(name: &ModelName, layers: &[Descriptor]) -> serde_json::Result<Vec<u8>> {
    let is_safetensors = |layer: &Descriptor| layer.path().is_some_and(|path| path.ends_with(".safetensors"));
    let document = ModelConfig {
        descriptor: ConfigDescriptor { name },
        config: Architecture { format: layers.iter().any(is_safetensors).then_some("safetensors") },
        modelfs: ModelFs { r#type: "layers", diff_ids: layers.iter().map(|layer| layer.digest).collect() },
    };
    let mut bytes = serde_json::to_vec(&document)?;
    bytes.push(b'\n');
    Ok(bytes)
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
        let mut manifest = Manifest::new(&name, &model_config(&name, &layers).unwrap(), layers, provenance);
        manifest.set_version(3);
        manifest
    }

    /// The shape that OCI and the CNCF model format fix, checked on the raw JSON.
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
    fn reads_back_exactly_and_ignores_what_it_does_not_know() {
        let name: ModelName = "approach".parse().unwrap();
        let manifest = sample();
        assert_eq!(Manifest::parse(&manifest.to_bytes().unwrap(), &name, 3).unwrap(), manifest);
        let mut json: serde_json::Value = serde_json::from_slice(&manifest.to_bytes().unwrap()).unwrap();
        json["subject"] = serde_json::json!({ "digest": "of a later format" });
        assert_eq!(Manifest::parse(json.to_string().as_bytes(), &name, 3).unwrap(), manifest);
    }

    #[test]
    fn says_what_is_wrong() {
        let name: ModelName = "approach".parse().unwrap();
        let refusal = |edit: fn(&mut Manifest), number| {
            let mut manifest = sample();
            edit(&mut manifest);
            Manifest::parse(&manifest.to_bytes().unwrap(), &name, number).unwrap_err()
        };
        assert!(refusal(|_| {}, 4).contains("image.version is `3`, expected `4`"));
        assert!(refusal(|m| m.schema_version = 1, 3).contains("schemaVersion"));
        assert!(refusal(|m| m.layers.clear(), 3).contains("no files"));
        assert!(refusal(|m| m.layers.push(m.layers[0].clone()), 3).contains("is named twice"));
        let evil =
            |m: &mut Manifest| m.layers[0].annotations.insert(FILE_PATH.into(), "../../etc/passwd".into());
        let mut manifest = sample();
        evil(&mut manifest);
        assert!(
            Manifest::parse(&manifest.to_bytes().unwrap(), &name, 3)
                .unwrap_err()
                .contains("../../etc/passwd")
        );
    }
}
