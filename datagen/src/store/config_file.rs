//! `config.toml` of a dataset: written first, so that an unfinished folder says what it is part of.

use crate::config::DatasetConfig;
use crate::error::{Error, Result};
use crate::info::{self, config_digest};
use crate::publish::{io, publish};
use crate::record::ShardRecord;
use std::io::{ErrorKind, Write as _};
use std::path::Path;

/// Name of the file.
pub const FILE_NAME: &str = "config.toml";

/// The configuration that a folder says it is of; `None` if it says nothing.
pub fn read(dir: &Path) -> Result<Option<DatasetConfig>> {
    let path = dir.join(FILE_NAME);
    let text = match std::fs::read_to_string(&path) {
        Err(error) if error.kind() == ErrorKind::NotFound => return Ok(None),
        found => found.map_err(|source| io(&path, source))?,
    };
    let config =
        toml::from_str(&text).map_err(|error| Error::NoRecipe { path, found: error.message().to_owned() })?;
    Ok(Some(config))
}

/// The file's text: the complete configuration.
pub fn text(config: &DatasetConfig) -> Result<String> {
    Ok(toml::to_string(config)?)
}

/// Makes a folder that of a configuration, if it is not yet; refuses one that is of another.
pub(crate) fn claim(config: &DatasetConfig, dir: &Path) -> Result<()> {
    let (path, text) = (dir.join(FILE_NAME), text(config)?);
    refuse_other(config, dir)?;
    if std::fs::read_to_string(&path).is_ok_and(|found| found == text) {
        return Ok(());
    }
    std::fs::create_dir_all(dir).map_err(|source| io(dir, source))?;
    publish(&path, |file| {
        // Looked at again: another process may have claimed the folder while this one waited to write.
        refuse_other(config, dir)?;
        file.write_all(text.as_bytes()).map_err(|source| io(&path, source))
    })
}

/// Gives a folder free again whose configuration makes no rows, if it holds nothing that is finished.
pub(crate) fn give_up(dir: &Path) -> Result<()> {
    let path = dir.join(FILE_NAME);
    if dir.join(info::FILE_NAME).exists() || !ShardRecord::all(dir)?.is_empty() {
        return Ok(());
    }
    std::fs::remove_file(&path).map_err(|source| io(&path, source))
}

/// Refuses a folder of another configuration.
pub(crate) fn refuse_other(config: &DatasetConfig, dir: &Path) -> Result<()> {
    let Some(found) = read(dir)? else { return Ok(()) };
    if found == *config {
        return Ok(());
    }
    let [found, wanted] = [config_digest(&found)?, config_digest(config)?];
    Err(Error::OtherConfig { path: dir.join(FILE_NAME), found, wanted })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::tiny::config;
    use std::fs;

    #[test]
    fn a_folder_is_of_one_configuration() {
        let dir = tempfile::tempdir().unwrap();
        let out = dir.path().join("out");
        assert!(read(&out).unwrap().is_none());
        for _ in 0..2 {
            claim(&config("a", 1), &out).unwrap();
            assert_eq!(read(&out).unwrap(), Some(config("a", 1)));
        }
        let error = claim(&config("a", 2), &out).unwrap_err().to_string();
        for count in [1, 2] {
            assert!(error.contains(&config_digest(&config("a", count)).unwrap()), "{error}");
        }
    }

    #[test]
    fn of_two_that_claim_it_at_once_one_is_refused() {
        for _ in 0..20 {
            let dir = tempfile::tempdir().unwrap();
            let path = dir.path();
            let claims = std::thread::scope(|scope| {
                let claim = |count| scope.spawn(move || claim(&config("a", count), path));
                [1, 2].map(claim).map(|claim| claim.join().unwrap())
            });
            assert_eq!(claims.iter().filter(|claim| claim.is_ok()).count(), 1, "{claims:?}");
        }
    }

    #[test]
    fn the_configuration_of_something_else_is_not_overwritten() {
        let dir = tempfile::tempdir().unwrap();
        fs::write(dir.path().join(FILE_NAME), "epochs = 3\n").unwrap();
        let error = claim(&config("a", 1), dir.path()).unwrap_err().to_string();
        assert!(error.contains("config.toml is not that of a dataset"), "{error}");
        assert_eq!(fs::read_to_string(dir.path().join(FILE_NAME)).unwrap(), "epochs = 3\n");
    }
}
