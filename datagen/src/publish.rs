//! Files that are either complete or absent: written beside their place, flushed to the disk, then renamed.

use crate::error::{Error, Result};
use sha2::{Digest, Sha256};
use std::fmt::Write as _;
use std::fs::{File, TryLockError};
use std::io::{Read as _, Write};
use std::path::{Path, PathBuf};
use tempfile::TempPath;

/// Writes a file that appears under its name only when it is complete. On an error nothing is left behind. While another
/// process writes the same file, waits.
pub fn publish<T, E: From<Error>>(
    path: &Path,
    write: impl FnOnce(&mut File) -> Result<T, E>,
) -> Result<T, E> {
    Partial::claim(path, |file| file.lock().map_err(TryLockError::Error))?.publish(path, write)
}

/// As [`publish`], but while another process writes the same file, that is an error: for what takes long to make.
pub fn publish_alone<T, E: From<Error>>(
    path: &Path,
    write: impl FnOnce(&mut File) -> Result<T, E>,
) -> Result<T, E> {
    Partial::claim(path, File::try_lock)?.publish(path, write)
}

/// A file that is being written, locked against other processes. Fields are dropped in this order: the name goes before the lock.
struct Partial {
    path: TempPath,
    file: File,
}

impl Partial {
    /// Opens and locks the partial file that belongs to a path.
    fn claim(path: &Path, lock: impl Fn(&File) -> Result<(), TryLockError>) -> Result<Self> {
        let name = path.file_name().unwrap_or_default().to_string_lossy();
        // A fixed name: what a killed process left is overwritten by the next.
        let partial = folder_of(path).join(format!(".{name}.partial"));
        let failed = |source| io(&partial, source);
        loop {
            // Not truncated before it is locked: it may be another's.
            let file = File::options().write(true).create(true).truncate(false).open(&partial);
            let file = file.map_err(failed)?;
            // Other errors are those of file systems without locks, where it goes on without.
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

    /// Writes the file, flushes it and renames it.
    fn publish<T, E: From<Error>>(
        self,
        path: &Path,
        write: impl FnOnce(&mut File) -> Result<T, E>,
    ) -> Result<T, E> {
        // The lock is held until the file has its name, and without one: `self.path` is dropped before `file`.
        let Self { path: partial, mut file } = self;
        let written = write(&mut file).and_then(|written| {
            file.sync_all().map_err(|source| io(&partial, source))?;
            Ok(written)
        });
        match written {
            Ok(written) => {
                partial.persist(path).map_err(|error| io(path, error.error))?;
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

/// Does the path name this file? Who held its lock before has renamed or removed it.
#[cfg(unix)]
fn is_named(file: &File, path: &Path) -> bool {
    use std::os::unix::fs::MetadataExt as _;
    let [named, locked] = [std::fs::metadata(path), file.metadata()]
        .map(|found| found.map(|found| (found.dev(), found.ino())).ok());
    named == locked
}

/// Elsewhere no file is renamed or removed while another process has it open.
#[cfg(not(unix))]
fn is_named(_: &File, _: &Path) -> bool {
    true
}

fn folder_of(path: &Path) -> &Path {
    path.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."))
}

/// Makes the names in a folder durable; only Unix lets a folder be opened for that.
pub fn sync_folder(folder: &Path) -> Result<()> {
    if cfg!(unix) {
        File::open(folder).and_then(|folder| folder.sync_all()).map_err(|source| io(folder, source))?;
    }
    Ok(())
}

/// Counts and digests what is written through it.
pub(crate) struct Hashed<W> {
    inner: W,
    hasher: Sha256,
    bytes: u64,
}

impl<W: Write> Hashed<W> {
    pub(crate) fn new(inner: W) -> Self {
        Self { inner, hasher: Sha256::new(), bytes: 0 }
    }

    /// SHA-256 in hexadecimal, and the number of bytes.
    pub(crate) fn finish(self) -> (String, u64) {
        (hexadecimal(&self.hasher.finalize()), self.bytes)
    }
}

impl<W: Write> Write for Hashed<W> {
    fn write(&mut self, bytes: &[u8]) -> std::io::Result<usize> {
        let written = self.inner.write(bytes)?;
        self.hasher.update(&bytes[..written]);
        self.bytes += written as u64;
        Ok(written)
    }

    fn flush(&mut self) -> std::io::Result<()> {
        self.inner.flush()
    }
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

#[cfg(test)]
mod tests {
    use super::*;
    use std::fs;

    fn put(path: &Path, text: &str) -> Result<()> {
        publish(path, |file| file.write_all(text.as_bytes()).map_err(|source| io(path, source)))
    }

    #[test]
    fn an_error_leaves_what_was_there_and_nothing_beside() {
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
    fn what_a_killed_process_left_is_overwritten_whole() {
        let folder = tempfile::tempdir().unwrap();
        fs::write(folder.path().join(".file.partial"), "longer than what comes").unwrap();
        put(&folder.path().join("file"), "new").unwrap();
        assert_eq!(fs::read_to_string(folder.path().join("file")).unwrap(), "new");
    }

    #[test]
    fn a_second_writer_of_something_long_is_refused_and_one_of_something_short_waits() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("file");
        publish_alone(&path, |file| {
            let second: Result<()> = publish_alone(&path, |_| Ok(()));
            assert!(matches!(&second, Err(Error::Busy { path: busy }) if *busy == path), "{second:?}");
            file.write_all(b"first").map_err(|source| io(&path, source))
        })
        .unwrap();
        assert_eq!(fs::read_to_string(&path).unwrap(), "first");
    }

    #[test]
    fn of_many_writers_none_is_torn() {
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

    #[test]
    fn the_digest_on_the_way_is_that_of_the_file() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("file");
        let mut hashed = Hashed::new(File::create(&path).unwrap());
        for part in ["one ", "after ", "the other"] {
            hashed.write_all(part.as_bytes()).unwrap();
        }
        assert_eq!(hashed.finish(), (digest_of_file(&path).unwrap(), 19));
    }
}
