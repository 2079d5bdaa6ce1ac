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
            check(layer, &place(layer))?;
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
    let kind = fs::symlink_metadata(source).map_err(Error::io("read", source))?;
    if !kind.is_file() {
        return Err(refuse("is no plain file; a model holds no links".to_owned()));
    }
    if kind.len() != expected.size {
        return Err(refuse(format!("has {} bytes, the manifest says {}", kind.len(), expected.size)));
    }
    let found = fingerprint(source)?;
    if found != expected.content() {
        return Err(refuse(format!("has digest {}, the manifest says {}", found.digest, expected.digest)));
    }
    Ok(())
}

/// A small document.
pub(crate) fn read_document(path: &Path) -> Result<Vec<u8>> {
    let mut bytes = Vec::new();
    let read = File::open(path).and_then(|file| file.take(DOCUMENT_LIMIT + 1).read_to_end(&mut bytes));
    read.map_err(Error::io("read", path))?;
    if bytes.len() as u64 > DOCUMENT_LIMIT {
        let reason = format!("has more than {DOCUMENT_LIMIT} bytes");
        return Err(Error::Import { path: path.to_owned(), reason });
    }
    Ok(bytes)
}
