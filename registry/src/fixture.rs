//! Test fixtures: registries in a folder and in memory, small checkpoints.

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::AtomicUsize;

use object_store::memory::InMemory;
use p256::SecretKey;
use p256::pkcs8::{EncodePrivateKey as _, LineEnding};
use tempfile::TempDir;

use crate::events::attachment::Attachment;
use crate::events::attachment::Evaluation;
use crate::model::{ModelName, ModelVersion, Provenance};
use crate::outcome::Outcome;
use crate::registry::{Registry, versions_key};
use crate::signature::PrivateKey;
use crate::store::Store;
use crate::store::location::Location;
use crate::store::misbehaving::{MisbehavingStore, Misbehavior};
use crate::store::sequence::pointer_key;

/// A temporary folder for a registry and for what is pulled from it.
pub(crate) struct Place {
    folder: TempDir,
    in_memory: bool,
}

impl Place {
    pub(crate) fn local() -> Self {
        Self { folder: tempfile::tempdir().unwrap(), in_memory: false }
    }

    /// One place for each kind of store. The same code must serve both.
    pub(crate) fn all() -> [Self; 2] {
        [Self::local(), Self { in_memory: true, ..Self::local() }]
    }

    pub(crate) fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    /// Opens the folder around the registry as a store.
    pub(crate) fn outside(&self) -> Store {
        Store::open(&Location::from(self.folder.path())).unwrap()
    }

    pub(crate) fn location(&self) -> Location {
        Location::from(self.path("registry").as_path())
    }

    pub(crate) fn store(&self) -> Store {
        if self.in_memory {
            Store::new(Arc::new(InMemory::new()), "memory".into())
        } else {
            fs::create_dir_all(self.path("registry")).unwrap();
            Store::open(&self.location()).unwrap()
        }
    }

    pub(crate) fn registry(&self) -> Registry {
        if self.in_memory {
            Registry::on(self.store()).unwrap()
        } else {
            Registry::init(&self.location()).unwrap()
        }
    }

    /// Creates a checkpoint with these weights, a constant configuration, and a file in a folder.
    pub(crate) fn checkpoint(&self, name: &str, weights: &[u8]) -> PathBuf {
        let root = self.path(name);
        fs::create_dir_all(root.join("state")).unwrap();
        fs::write(root.join("weights.bin"), weights).unwrap();
        fs::write(root.join("config.toml"), "width = 0.25\n").unwrap();
        fs::write(root.join("state/step.json"), "7").unwrap();
        root
    }

    /// Publishes a checkpoint with these weights as the next version of `name`.
    pub(crate) fn publish(&self, registry: &Registry, name: &str, weights: &[u8]) -> ModelVersion {
        let checkpoint = self.checkpoint("checkpoint", weights);
        match registry.publish(&model(name), &checkpoint, Provenance::default()).unwrap() {
            Outcome::New(version) => version,
            Outcome::AlreadyThere(version) => panic!("{version} is already there"),
        }
    }
}

/// Returns a safetensors file with these bytes as its only tensor.
pub(crate) fn safetensors(data: &[u8]) -> Vec<u8> {
    let size = data.len();
    let header = format!(r#"{{"w":{{"dtype":"U8","shape":[{size}],"data_offsets":[0,{size}]}}}}"#);
    [&(header.len() as u64).to_le_bytes()[..], header.as_bytes(), data].concat()
}

/// Creates a store in memory that misbehaves.
pub(crate) fn misbehaving(misbehavior: Misbehavior) -> Store {
    let (objects, requests) = (InMemory::new(), AtomicUsize::new(1));
    Store::new(Arc::new(MisbehavingStore { misbehavior, objects, requests }), "misbehaving".into())
}

/// Returns the key of the pointer to version `number` of `approach`.
pub(crate) fn version_key(number: u64) -> String {
    pointer_key(&versions_key(&model("approach")), number)
}

pub(crate) fn model(name: &str) -> ModelName {
    name.parse().unwrap()
}

/// Returns an evaluation with one metric.
pub(crate) fn evaluation(metric: &str, value: f64) -> Attachment {
    let metrics = BTreeMap::from([(metric.to_owned(), value)]);
    let configuration = BTreeMap::from([("sessions".to_owned(), 40.into())]);
    Attachment::Evaluation(Evaluation { metrics, configuration })
}

/// Returns the key with this scalar, repeated.
pub(crate) fn key(scalar: u8) -> PrivateKey {
    let secret = SecretKey::from_slice(&[scalar; 32]).unwrap();
    PrivateKey::from_pem(&secret.to_pkcs8_pem(LineEnding::LF).unwrap()).unwrap()
}

/// Returns bytes without a period, which parts or buffers could hide.
pub(crate) fn bytes(size: usize) -> Vec<u8> {
    (0..size as u32).map(|i| (i.wrapping_mul(2_654_435_761) >> 24) as u8).collect()
}

/// Flips one bit in the middle of the object `key` of a local registry.
pub(crate) fn flip(registry: &Path, key: &str) {
    let path = registry.join(key);
    let mut content = fs::read(&path).unwrap();
    let middle = content.len() / 2;
    content[middle] ^= 1;
    fs::write(path, content).unwrap();
}
