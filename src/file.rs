//! Files published by rename.

use anyhow::{Context, Result};
use std::io::Write;
use std::path::Path;

/// Writes a file under a temporary name and renames it when it is complete. Creates the folder if necessary.
pub(crate) fn write_file(path: &Path, content: impl AsRef<[u8]>) -> Result<()> {
    let folder = path.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."));
    let write = || -> Result<()> {
        std::fs::create_dir_all(folder)?;
        datagen::publish::publish(path, |file| Ok(file.write_all(content.as_ref())?))
    };
    write().with_context(|| format!("{}: cannot be written", path.display()))
}
