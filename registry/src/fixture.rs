//! Set-up shared by the tests: registries on a folder and in memory, small checkpoints.

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::AtomicUsize;

use object_store::memory::InMemory;
use p256::SecretKey;
use p256::pkcs8::{EncodePrivateKey as _, LineEnding};
use tempfile::TempDir;

use crate::attachment::Attachment;
use crate::evaluation::Evaluation;
use crate::manifest::Provenance;
use crate::name::ModelName;
use crate::publish::Published;
use crate::quirk::{Quirk, Quirky};
use crate::registry::{ModelVersion, Registry};
use crate::signature::PrivateKey;
use crate::store::Store;

/// A place for a registry and for what is pulled from it, gone when dropped.
pub(crate) struct Place {
    folder: TempDir,
    in_memory: bool,
}

impl Place {
    pub(crate) fn local() -> Self {
        Self { folder: tempfile::tempdir().unwrap(), in_memory: false }
    }

    /// The same code must serve every kind of store.
    pub(crate) fn all() -> [Self; 2] {
        [Self::local(), Self { in_memory: true, ..Self::local() }]
    }

    pub(crate) fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    pub(crate) fn store(&self) -> Store {
        if self.in_memory {
            Store::new(Arc::new(InMemory::new()), "memory".into())
        } else {
            fs::create_dir_all(self.path("registry")).unwrap();
            Store::open(&(&self.path("registry")).into()).unwrap()
        }
    }

    pub(crate) fn registry(&self) -> Registry {
        if self.in_memory {
            Registry::on(self.store()).unwrap()
        } else {
            Registry::init(&self.path("registry")).unwrap()
        }
    }

    /// A checkpoint with these weights, a configuration that never changes, and a file in a folder.
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
            Published::New(version) => version,
            Published::AlreadyThere(version) => panic!("{version} is already there"),
        }
    }
}

/// A safetensors file with these bytes as its one tensor.
pub(crate) fn safetensors(data: &[u8]) -> Vec<u8> {
    let size = data.len();
    let header = format!(r#"{{"w":{{"dtype":"U8","shape":[{size}],"data_offsets":[0,{size}]}}}}"#);
    [&(header.len() as u64).to_le_bytes()[..], header.as_bytes(), data].concat()
}

/// A store in memory with a quirk.
pub(crate) fn quirky(quirk: Quirk) -> Store {
    let objects = Quirky { quirk, objects: InMemory::new(), asked: AtomicUsize::new(1) };
    Store::new(Arc::new(objects), "quirky".into())
}

pub(crate) fn model(name: &str) -> ModelName {
    name.parse().unwrap()
}

/// An evaluation with one metric.
pub(crate) fn evaluation(metric: &str, value: f64) -> Attachment {
    let metrics = BTreeMap::from([(metric.to_owned(), value)]);
    let configuration = BTreeMap::from([("sessions".to_owned(), 40.into())]);
    Attachment::Evaluation(Evaluation { metrics, configuration })
}

/// The key with this scalar, repeated.
pub(crate) fn key(scalar: u8) -> PrivateKey {
    let secret = SecretKey::from_slice(&[scalar; 32]).unwrap();
    PrivateKey::from_pem(&secret.to_pkcs8_pem(LineEnding::LF).unwrap()).unwrap()
}

/// Bytes with no period that a part or buffer could hide.
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
