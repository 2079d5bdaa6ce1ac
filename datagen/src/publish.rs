//! Atomic publication: a file is written under a temporary name, flushed to the disk, and renamed. It is complete or absent.

use crate::error::{Error, Result};
use std::fs::{File, TryLockError};
use std::path::Path;
use tempfile::TempPath;

/// Publishes a file atomically: it appears under its name only when it is complete.
///
/// Waits while another process writes the same file. On an error, the previous file stays, and no partial file is left.
pub fn publish<T, E: From<Error>>(
    path: &Path,
    write: impl FnOnce(&mut File) -> Result<T, E>,
) -> Result<T, E> {
    Partial::claim(path, |file| file.lock().map_err(TryLockError::Error))?.publish(path, write)
}

/// Publishes a file like [`publish`], but fails with [`Error::Busy`] while another process writes the same file. Use it for
/// files that take long to write.
pub fn publish_alone<T, E: From<Error>>(
    path: &Path,
    write: impl FnOnce(&mut File) -> Result<T, E>,
) -> Result<T, E> {
    Partial::claim(path, File::try_lock)?.publish(path, write)
}

/// A partial file, locked against other processes. Fields are dropped in this order: the file is removed before the lock is
/// released.
struct Partial {
    path: TempPath,
    file: File,
}

impl Partial {
    /// Opens and locks the partial file of a path.
    fn claim(path: &Path, lock: impl Fn(&File) -> Result<(), TryLockError>) -> Result<Self> {
        let name = path.file_name().unwrap_or_default().to_string_lossy();
        // The name is fixed, so that the next process overwrites the file of a killed one.
        let partial = folder_of(path).join(format!(".{name}.partial"));
        let failed = Error::io(&partial);
        loop {
            // Truncated only after it is locked: until then, it may belong to another process.
            let file = File::options().write(true).create(true).truncate(false).open(&partial);
            let file = file.map_err(failed)?;
            // Any other error means that the file system has no locks. Continue without one.
            if let Err(TryLockError::WouldBlock) = lock(&file) {
                return Err(Error::Busy { path: path.to_owned() });
            }
            if !is_named(&file, &partial) {
                continue;
            }
            if file.metadata().map_err(failed)?.len() > 0 {
                file.set_len(0).map_err(failed)?;
            }
            return Ok(Self { path: TempPath::try_from_path(&partial).map_err(failed)?, file });
        }
    }

    /// Writes, flushes and renames the file.
    fn publish<T, E: From<Error>>(
        self,
        path: &Path,
        write: impl FnOnce(&mut File) -> Result<T, E>,
    ) -> Result<T, E> {
        // `file` holds the lock until the rename, or until `partial` is dropped, which removes the partial file.
        let Self { path: partial, mut file } = self;
        let written = write(&mut file).and_then(|written| {
            file.sync_all().map_err(Error::io(&partial))?;
            Ok(written)
        });
        match written {
            Ok(written) => {
                partial.persist(path).map_err(|error| Error::io(path)(error.error))?;
                sync_folder(folder_of(path))?;
                Ok(written)
            }
            Err(error) => {
                drop(partial);
                Err(error)
            }
        }
    }
}

/// Returns whether the path still names this file. The previous holder of the lock may have renamed or removed it.
#[cfg(unix)]
fn is_named(file: &File, path: &Path) -> bool {
    use std::os::unix::fs::MetadataExt as _;
    let [named, locked] = [std::fs::metadata(path), file.metadata()]
        .map(|found| found.map(|found| (found.dev(), found.ino())).ok());
    named == locked
}

/// Other systems do not rename or remove a file while another process has it open.
#[cfg(not(unix))]
fn is_named(_: &File, _: &Path) -> bool {
    true
}

fn folder_of(path: &Path) -> &Path {
    path.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."))
}

/// Flushes the directory entries of a folder to the disk. Only Unix supports this; elsewhere it does nothing.
pub fn sync_folder(folder: &Path) -> Result<()> {
    if cfg!(unix) {
        File::open(folder).and_then(|folder| folder.sync_all()).map_err(Error::io(folder))?;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::fs;
    use std::io::Write as _;
    use std::path::PathBuf;

    fn put(path: &Path, text: &str) -> Result<()> {
        publish(path, |file| file.write_all(text.as_bytes()).map_err(Error::io(path)))
    }

    #[test]
    fn an_error_keeps_the_previous_file_and_leaves_no_partial_one() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("file");
        put(&path, "old").unwrap();
        let failed: Result<()> = publish(&path, |file| {
            file.write_all(b"half").unwrap();
            Err(Error::Incomplete { dir: PathBuf::new(), files: None })
        });
        assert!(failed.is_err());
        assert_eq!(fs::read_to_string(&path).unwrap(), "old");
        assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 1);
    }

    #[test]
    fn the_partial_file_of_a_killed_process_is_overwritten() {
        let folder = tempfile::tempdir().unwrap();
        fs::write(folder.path().join(".file.partial"), "longer than the new content").unwrap();
        put(&folder.path().join("file"), "new").unwrap();
        assert_eq!(fs::read_to_string(folder.path().join("file")).unwrap(), "new");
    }

    #[test]
    fn a_second_writer_that_does_not_wait_is_refused() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("file");
        publish_alone(&path, |file| {
            let second: Result<()> = publish_alone(&path, |_| Ok(()));
            assert!(matches!(&second, Err(Error::Busy { path: busy }) if *busy == path), "{second:?}");
            file.write_all(b"first").map_err(Error::io(&path))
        })
        .unwrap();
        assert_eq!(fs::read_to_string(&path).unwrap(), "first");
    }

    #[test]
    fn concurrent_writers_never_tear_a_file() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("file");
        let texts: Vec<_> = (1..=4).map(|i| i.to_string().repeat(5000 * i)).collect();
        std::thread::scope(|scope| {
            for text in &texts {
                scope.spawn(|| {
                    for _ in 0..50 {
                        put(&path, text).unwrap();
                        assert!(texts.contains(&fs::read_to_string(&path).unwrap()), "torn");
                    }
                });
            }
        });
        assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 1);
    }
}
