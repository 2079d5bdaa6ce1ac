//! Atomic publication of folders.

use std::fs::{self, File};
use std::io::{ErrorKind, Write};
use std::path::{Path, PathBuf};

use datagen::publish::sync_folder;

use crate::error::{Result, at};

/// Fills a temporary folder beside `target` and replaces `target` with it.
///
/// A crash, even of the machine, leaves either the previous folder or the new one. Between the two renames the previous
/// one has another name, under which [`recover`] finds it.
pub(crate) fn replace(target: &Path, fill: impl FnOnce(&Path) -> Result<()>) -> Result<()> {
    recover(target)?;
    let (partial, previous) = (beside(target, "partial"), beside(target, "previous"));
    remove(&partial)?;
    fs::create_dir_all(&partial).map_err(at(&partial))?;
    fill(&partial)?;
    for entry in fs::read_dir(&partial).map_err(at(&partial))? {
        let path = entry.map_err(at(&partial))?.path();
        File::open(&path).and_then(|file| file.sync_all()).map_err(at(&path))?;
    }
    // The files are on disk before the folder is renamed, and the rename is on disk before the previous one is removed.
    sync_folder(&partial)?;
    remove(&previous)?;
    if target.exists() {
        fs::rename(target, &previous).map_err(at(target))?;
    }
    fs::rename(&partial, target).map_err(at(target))?;
    sync_folder(target.parent().unwrap_or(Path::new(".")))?;
    remove(&previous)
}

/// Restores the previous folder after a crash in [`replace`].
pub(crate) fn recover(target: &Path) -> Result<()> {
    let previous = beside(target, "previous");
    if !target.exists() && previous.exists() {
        fs::rename(&previous, target).map_err(at(target))?;
    }
    Ok(())
}

/// Writes a file atomically.
pub(crate) fn write(path: &Path, contents: &str) -> Result<()> {
    datagen::publish::publish(path, |file| file.write_all(contents.as_bytes()).map_err(at(path)))
}

fn beside(target: &Path, what: &str) -> PathBuf {
    let mut name = target.file_name().unwrap_or_default().to_owned();
    name.push(".");
    name.push(what);
    target.with_file_name(name)
}

fn remove(directory: &Path) -> Result<()> {
    match fs::remove_dir_all(directory) {
        Err(error) if error.kind() != ErrorKind::NotFound => Err(at(directory)(error)),
        _ => Ok(()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::error::Error;

    fn put(directory: &Path, text: &str) -> Result<()> {
        replace(directory, |inside| fs::write(inside.join("file"), text).map_err(at(inside)))
    }

    #[test]
    fn a_failure_leaves_the_previous_directory() {
        let root = tempfile::tempdir().unwrap();
        let target = root.path().join("last");
        put(&target, "old").unwrap();
        let failed = replace(&target, |_| Err(Error::LabelsNotFinite));
        assert!(failed.is_err());
        assert_eq!(fs::read_to_string(target.join("file")).unwrap(), "old");
        put(&target, "new").unwrap();
        assert_eq!(fs::read_to_string(target.join("file")).unwrap(), "new");
        assert_eq!(fs::read_dir(root.path()).unwrap().count(), 1, "no temporary directory remains");
    }

    #[test]
    fn a_crash_between_the_renames_is_recovered_from() {
        let root = tempfile::tempdir().unwrap();
        let target = root.path().join("last");
        put(&target, "old").unwrap();
        fs::rename(&target, root.path().join("last.previous")).unwrap();
        recover(&target).unwrap();
        assert_eq!(fs::read_to_string(target.join("file")).unwrap(), "old");
    }
}
