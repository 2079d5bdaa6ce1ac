//! `dataset.json`: what a dataset is made of. Written last, so it says that the dataset is complete.

use crate::config::DatasetConfig;
use crate::error::{Error, Result};
use crate::fault::{self, Fault, Problem};
use crate::publish::{digest, io, publish};
use crate::{card, recipe, record, verify};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::io::{ErrorKind, Write as _};
use std::path::Path;

/// Name of the file.
pub const FILE_NAME: &str = "dataset.json";

/// What a dataset is made of.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct DatasetInfo {
    /// Name of the dataset.
    pub name: String,
    /// Number of rows.
    pub rows: u64,
    /// Number of images.
    pub images: u64,
    /// SHA-256 over `digest  path` of all files, a line each, sorted by path: the identity of the data.
    pub digest: String,
    /// SHA-256 of the configuration.
    pub config_digest: String,
    /// Version of flowservo that wrote it.
    pub version: String,
    /// The files with the rows, in their order.
    pub files: Vec<FileRecord>,
    /// SHA-256 of `README.md` and `config.toml`.
    pub documents: BTreeMap<String, String>,
    /// The configuration that made it, complete.
    pub config: DatasetConfig,
    /// SHA-256 of this description with an empty seal: no byte of it changes unnoticed.
    pub seal: String,
}

/// A finished file.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct FileRecord {
    /// Path below the dataset's folder, with `/`.
    pub path: String,
    /// SHA-256.
    pub sha256: String,
    /// Rows in it.
    pub rows: u64,
    /// Its size.
    pub bytes: u64,
}

impl DatasetInfo {
    /// For files in their order.
    pub fn new(config: &DatasetConfig, files: Vec<FileRecord>) -> Result<Self> {
        let images_per_row = config.motions[0].ranges().count() as u64;
        let lines: Vec<String> =
            files.iter().map(|file| format!("{}  {}\n", file.sha256, file.path)).collect();
        let mut info = Self {
            name: config.name.clone(),
            rows: config.count,
            images: config.count * images_per_row,
            digest: digest(lines.concat().as_bytes()),
            config_digest: config_digest(config)?,
            version: env!("CARGO_PKG_VERSION").to_owned(),
            files,
            documents: BTreeMap::new(),
            config: config.clone(),
            seal: String::new(),
        };
        let documents = info.texts()?.map(|(path, text)| (path.to_owned(), digest(text.as_bytes())));
        info.documents = documents.into();
        info.seal = info.sealed()?;
        Ok(info)
    }

    /// Reads `dataset.json` in a folder; refuses one that is not byte for byte as it was written.
    pub fn read(dir: &Path) -> Result<Self> {
        let path = dir.join(FILE_NAME);
        let bytes = match std::fs::read(&path) {
            Err(error) if error.kind() == ErrorKind::NotFound => return Err(incomplete(dir)),
            found => found.map_err(|source| io(&path, source))?,
        };
        let info: Self = parse_json(&path, &bytes)?;
        if info.sealed()? == info.seal && json(&info)? == bytes {
            return Ok(info);
        }
        let [expected, found] = ["a description as flowservo wrote it", "one that was changed afterwards"];
        Err(Error::Damaged { path, expected: expected.to_owned(), found: found.to_owned() })
    }

    /// Publishes card and configuration, and then `dataset.json`.
    pub(crate) fn publish(&self, dir: &Path) -> Result<()> {
        for (name, text) in self.texts()? {
            let path = dir.join(name);
            publish(&path, |file| file.write_all(text.as_bytes()).map_err(|source| io(&path, source)))?;
        }
        write_json(&dir.join(FILE_NAME), self)
    }

    /// Names and contents of the files that are for people.
    fn texts(&self) -> Result<[(&'static str, String); 2]> {
        Ok([(card::FILE_NAME, card::text(self)), (recipe::FILE_NAME, recipe::text(&self.config)?)])
    }

    /// The seal that belongs to the rest.
    fn sealed(&self) -> Result<String> {
        Ok(digest(&json(&Self { seal: String::new(), ..self.clone() })?))
    }

    /// Size of all files with rows.
    pub fn bytes(&self) -> u64 {
        self.files.iter().map(|file| file.bytes).sum()
    }

    /// Are all files there, with the sizes they should have? Quick; [`DatasetInfo::verify`] reads them.
    pub fn check_sizes(&self, dir: &Path) -> Result<()> {
        for file in &self.files {
            let path = dir.join(&file.path);
            let found = std::fs::metadata(&path).map_err(|source| io(&path, source))?.len();
            if found != file.bytes {
                let [expected, found] = [file.bytes, found].map(|bytes| format!("{bytes} bytes"));
                return Err(Error::Damaged { path, expected, found });
            }
        }
        Ok(())
    }

    /// Compares every file of the dataset with its digest; an error names all that differ.
    pub fn verify(&self, dir: &Path) -> Result<()> {
        fault::none(dir, verify::faults(self, dir)?)
    }

    /// What is wrong with card and configuration.
    pub(crate) fn document_faults(&self, dir: &Path) -> Vec<Fault> {
        let fault = |(path, digest): (&String, &String)| {
            let problem = Problem::of_digest(&dir.join(path), digest)?;
            Some(Fault { path: path.clone(), problem })
        };
        self.documents.iter().filter_map(fault).collect()
    }
}

/// The error for a folder without `dataset.json`, which says how far it is if it says what it is.
fn incomplete(dir: &Path) -> Error {
    let files = || {
        let config = recipe::read(dir).ok()??;
        config.validate().ok()?;
        Some((record::finished(&config, dir).ok()?, config.shards()))
    };
    Error::Incomplete { dir: dir.to_owned(), files: files() }
}

/// SHA-256 of a configuration: of its JSON form, so comments and the order of keys in a file do not matter.
pub fn config_digest(config: &DatasetConfig) -> Result<String> {
    Ok(digest(&serde_json::to_vec(config)?))
}

pub(crate) fn read_json<T: for<'a> Deserialize<'a>>(path: &Path) -> Result<T> {
    parse_json(path, &std::fs::read(path).map_err(|source| io(path, source))?)
}

fn parse_json<T: for<'a> Deserialize<'a>>(path: &Path, bytes: &[u8]) -> Result<T> {
    serde_json::from_slice(bytes).map_err(|error| Error::Damaged {
        path: path.to_owned(),
        expected: "a description as flowservo writes it".to_owned(),
        found: error.to_string(),
    })
}

pub(crate) fn write_json(path: &Path, value: &impl Serialize) -> Result<()> {
    let text = json(value)?;
    publish(path, |file| file.write_all(&text).map_err(|source| io(path, source)))
}

fn json(value: &impl Serialize) -> Result<Vec<u8>> {
    let mut text = serde_json::to_vec_pretty(value)?;
    text.push(b'\n');
    Ok(text)
}
