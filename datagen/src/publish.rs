//! Files that are either complete or absent: written beside their place, flushed to the disk, then renamed.

use crate::error::{Error, Result};
use sha2::{Digest, Sha256};
use std::fmt::Write as _;
use std::fs::File;
use std::io::Read as _;
use std::path::{Path, PathBuf};
use tempfile::TempPath;

/// Writes a file that appears under its name only when it is complete. On an error nothing is left behind.
pub fn publish<E: From<Error>>(path: &Path, write: impl FnOnce(&mut File) -> Result<(), E>) -> Result<(), E> {
    let folder = path.parent().unwrap_or(Path::new("."));
    let name = path.file_name().unwrap_or_default().to_string_lossy();
    // A fixed name: what a killed process left is overwritten by the next.
    let partial = folder.join(format!(".{name}.partial"));
    let mut file = File::create(&partial).map_err(|source| io(&partial, source))?;
    let partial = TempPath::try_from_path(&partial).map_err(|source| io(&partial, source))?;
    write(&mut file)?;
    file.sync_all().map_err(|source| io(&partial, source))?;
    partial.persist(path).map_err(|error| io(path, error.error))?;
    Ok(sync_folder(folder)?)
}

/// Makes the names in a folder durable; only Unix lets a folder be opened for that.
pub fn sync_folder(folder: &Path) -> Result<()> {
    if cfg!(unix) {
        File::open(folder).and_then(|folder| folder.sync_all()).map_err(|source| io(folder, source))?;
    }
    Ok(())
}

/// SHA-256 of a file, in hexadecimal.
pub fn digest_of_file(path: &Path) -> Result<String> {
    let mut file = File::open(path).map_err(|source| io(path, source))?;
    let mut hasher = Sha256::new();
    let mut buffer = vec![0; 1 << 16];
    loop {
        match file.read(&mut buffer).map_err(|source| io(path, source))? {
            0 => return Ok(hexadecimal(&hasher.finalize())),
            read => hasher.update(&buffer[..read]),
        }
    }
}

/// SHA-256 of bytes, in hexadecimal.
pub fn digest(bytes: &[u8]) -> String {
    hexadecimal(&Sha256::digest(bytes))
}

fn hexadecimal(bytes: &[u8]) -> String {
    bytes.iter().fold(String::with_capacity(2 * bytes.len()), |mut text, byte| {
        // Writing to a string cannot fail.
        let _ = write!(text, "{byte:02x}");
        text
    })
}

/// An error of the operating system, with its file.
pub(crate) fn io(path: &Path, source: std::io::Error) -> Error {
    Error::Io { path: PathBuf::from(path), source }
}
