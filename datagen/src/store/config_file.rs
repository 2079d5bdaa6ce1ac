//! `config.toml` of a dataset: published first, so that the folder belongs to one configuration from the beginning.

use crate::config::DatasetConfig;
use crate::digest::digest;
use crate::error::{Error, Result};
use crate::publish::publish;
use std::io::{ErrorKind, Write as _};
use std::path::Path;

/// Name of the file.
pub(super) const FILE_NAME: &str = "config.toml";

/// Reads the configuration of a folder, or returns `None` if it has none.
pub(super) fn read(dir: &Path) -> Result<Option<DatasetConfig>> {
    let path = dir.join(FILE_NAME);
    let text = match std::fs::read_to_string(&path) {
        Err(error) if error.kind() == ErrorKind::NotFound => return Ok(None),
        found => found.map_err(Error::io(&path))?,
    };
    let config = toml::from_str(&text)
        .map_err(|error| Error::NotDatasetConfig { path, found: error.message().to_owned() })?;
    Ok(Some(config))
}

/// Formats a configuration as the content of the file.
pub(super) fn text(config: &DatasetConfig) -> Result<String> {
    Ok(toml::to_string(config)?)
}

/// Returns the SHA-256 of a configuration in its JSON form, which is independent of comments and key order.
pub(super) fn config_digest(config: &DatasetConfig) -> Result<String> {
    Ok(digest(&serde_json::to_vec(config)?))
}

/// Claims a folder for a configuration. Fails if it belongs to a different one.
pub(super) fn claim(config: &DatasetConfig, dir: &Path) -> Result<()> {
    let (path, text) = (dir.join(FILE_NAME), text(config)?);
    refuse_other(config, dir)?;
    if std::fs::read_to_string(&path).is_ok_and(|found| found == text) {
        return Ok(());
    }
    std::fs::create_dir_all(dir).map_err(Error::io(dir))?;
    publish(&path, |file| {
        // Checked again: another process may have claimed the folder while this one waited for the lock.
        refuse_other(config, dir)?;
        file.write_all(text.as_bytes()).map_err(Error::io(&path))
    })
}

/// Fails if a folder belongs to a different configuration.
pub(super) fn refuse_other(config: &DatasetConfig, dir: &Path) -> Result<()> {
    let Some(found) = read(dir)? else { return Ok(()) };
    if found == *config {
        return Ok(());
    }
    let [found, expected] = [config_digest(&found)?, config_digest(config)?];
    Err(Error::OtherConfig { path: dir.join(FILE_NAME), found, expected })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fixture::config;
    use std::fs;

    #[test]
    fn a_folder_belongs_to_one_configuration() {
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
    fn one_of_two_concurrent_claims_is_refused() {
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
    fn a_foreign_config_file_is_not_overwritten() {
        let dir = tempfile::tempdir().unwrap();
        fs::write(dir.path().join(FILE_NAME), "epochs = 3\n").unwrap();
        let error = claim(&config("a", 1), dir.path()).unwrap_err().to_string();
        assert!(error.contains("config.toml is not a dataset configuration"), "{error}");
        assert_eq!(fs::read_to_string(dir.path().join(FILE_NAME)).unwrap(), "epochs = 3\n");
    }
}
