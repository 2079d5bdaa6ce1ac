//! Files and folders that are written under a temporary name, and renamed when they are complete.

use std::fs::{self, File};
use std::io::{self, ErrorKind};
use std::path::{Path, PathBuf};

use crate::error::{Error, Result};

/// A temporary file or folder. It is deleted when dropped, unless it was renamed.
pub(crate) struct Staged {
    pub(crate) path: PathBuf,
    /// Another process may use the temporary name by now.
    renamed: bool,
}

impl Staged {
    /// Creates a file or folder under the first free of the names that `name` returns for 0, 1, 2...
    pub(crate) fn create<T>(
        name: impl Fn(u64) -> PathBuf,
        create: fn(&Path) -> io::Result<T>,
    ) -> Result<(Self, T)> {
        let mut number = 0;
        loop {
            let path = name(number);
            match create(&path) {
                Ok(created) => return Ok((Self { path, renamed: false }, created)),
                Err(error) if error.kind() == ErrorKind::AlreadyExists => number += 1,
                Err(error) => return Err(Error::io("write", &path)(error)),
            }
        }
    }

    /// Moves it to its final place.
    pub(crate) fn rename(mut self, destination: &Path) -> Result<()> {
        fs::rename(&self.path, destination).map_err(Error::io("write", destination))?;
        self.renamed = true;
        Ok(())
    }
}

impl Drop for Staged {
    fn drop(&mut self) {
        if !self.renamed {
            // What cannot be deleted has a temporary name, and there is nobody to report it to.
            let _ =
                if self.path.is_dir() { fs::remove_dir_all(&self.path) } else { fs::remove_file(&self.path) };
        }
    }
}

/// Creates a folder, and those above it, so that they survive a power failure.
pub(crate) fn create_folder(folder: &Path) -> Result<()> {
    if folder.is_dir() {
        return Ok(());
    }
    let parent = folder.parent().unwrap_or(Path::new(""));
    create_folder(parent)?;
    match fs::create_dir(folder) {
        // Another process creates it at the same time.
        Err(error) if error.kind() != ErrorKind::AlreadyExists => {
            Err(Error::io("create the folder", folder)(error))
        }
        _ => sync_folder(parent),
    }
}

/// Makes the names in a folder durable. Only Unix can open a folder for that.
pub(crate) fn sync_folder(folder: &Path) -> Result<()> {
    if cfg!(unix) {
        File::open(folder).and_then(|folder| folder.sync_all()).map_err(Error::io("write", folder))?;
    }
    Ok(())
}
