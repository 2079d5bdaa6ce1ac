//! Looks at every byte of a complete dataset.

use crate::earlier::strays;
use crate::error::{Error, Result};
use crate::fault::{Fault, Problem};
use crate::info::{DatasetInfo, FILE_NAME};
use rayon::iter::{IntoParallelRefIterator, ParallelIterator};
use std::path::Path;

/// All files of a dataset that are not as they were written, with the threads of the current rayon pool.
///
/// Where `dataset.json` is damaged it is named alone: what the others should be is not known then.
pub fn verify(dir: &Path) -> Result<Vec<Fault>> {
    match DatasetInfo::read(dir) {
        Ok(info) => faults(&info, dir),
        Err(Error::Damaged { expected, found, .. }) => {
            Ok(vec![Fault { path: FILE_NAME.to_owned(), problem: Problem::Form { expected, found } }])
        }
        Err(error) => Err(error),
    }
}

/// All files that are not as a description says.
pub(crate) fn faults(info: &DatasetInfo, dir: &Path) -> Result<Vec<Fault>> {
    let fault = |path: &String, problem| Fault { path: path.clone(), problem };
    let data = info.files.par_iter();
    let mut faults: Vec<Fault> =
        data.filter_map(|file| Some(fault(&file.path, file.problem(dir)?))).collect();
    faults.extend(info.document_faults(dir));
    faults.extend(strays(&info.config, dir)?.iter().map(|path| fault(path, Problem::Stray)));
    Ok(faults)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::tiny::{config, make};
    use crate::{card, recipe};
    use rand::RngExt as _;
    use std::fs::{self, File};
    use std::io::{Seek as _, SeekFrom, Write as _};

    fn damaged(dir: &Path) -> Vec<String> {
        verify(dir).unwrap().into_iter().map(|fault| fault.path).collect()
    }

    #[test]
    fn every_flipped_bit_is_found_and_its_file_named() {
        let dir = tempfile::tempdir().unwrap();
        let mut config = config("c", 3);
        (config.world.camera.width, config.world.camera.height) = (8, 8);
        make(&config, dir.path()).unwrap();
        assert!(damaged(dir.path()).is_empty());
        let data = "data/train-00000-of-00001.parquet";
        let mut random = crate::range::stream(1, 2);
        for name in [FILE_NAME, card::FILE_NAME, recipe::FILE_NAME, data] {
            let path = dir.path().join(name);
            let whole = fs::read(&path).unwrap();
            let positions: Vec<usize> = match name {
                _ if name == data => (0..300).map(|_| random.random_range(0..whole.len())).collect(),
                _ => (0..whole.len()).collect(),
            };
            // In place: a file system may flush a file that is written anew.
            let mut file = File::options().write(true).open(&path).unwrap();
            let mut put = |position: usize, byte: u8| {
                file.seek(SeekFrom::Start(position as u64)).unwrap();
                file.write_all(&[byte]).unwrap();
            };
            for (i, position) in positions.into_iter().enumerate() {
                put(position, whole[position] ^ (1 << (i % 8)));
                assert_eq!(damaged(dir.path()), [name], "byte {position}, bit {}", i % 8);
                put(position, whole[position]);
            }
            for length in [0, 1, whole.len() / 2, whole.len() - 1] {
                fs::write(&path, &whole[..length]).unwrap();
                assert_eq!(damaged(dir.path()), [name], "cut to {length} bytes");
            }
            fs::write(&path, [whole.as_slice(), b"\n"].concat()).unwrap();
            assert_eq!(damaged(dir.path()), [name], "a byte was added");
            fs::remove_file(&path).unwrap();
            if name == FILE_NAME {
                assert!(matches!(verify(dir.path()), Err(Error::Incomplete { .. })));
            } else {
                assert_eq!(verify(dir.path()).unwrap()[0].to_string(), format!("{name}: missing"));
            }
            fs::write(&path, &whole).unwrap();
        }
        assert!(damaged(dir.path()).is_empty());
    }

    #[test]
    fn all_damaged_files_are_named_and_made_again() {
        let (dir, config) = (tempfile::tempdir().unwrap(), config("a", 12));
        make(&config, dir.path()).unwrap();
        let path = |name: &str| dir.path().join(name);
        let first = path("data/train-00000-of-00004.parquet");
        let size = fs::metadata(&first).unwrap().len();
        fs::write(&first, "short").unwrap();
        fs::remove_file(path("data/train-00002-of-00004.parquet")).unwrap();
        fs::write(path("data/train-00000-of-00001.parquet"), "another").unwrap();
        fs::write(path("README.md"), "another").unwrap();
        fs::write(path("config.toml"), "another").unwrap();
        let info = DatasetInfo::read(dir.path()).unwrap();
        let error = info.verify(dir.path()).unwrap_err().to_string();
        for line in [
            format!("\n  data/train-00000-of-00004.parquet: expected {size} bytes, found 5"),
            "\n  data/train-00002-of-00004.parquet: missing".to_owned(),
            "\n  README.md: expected SHA-256".to_owned(),
            "\n  config.toml: expected SHA-256".to_owned(),
            "\n  data/train-00000-of-00001.parquet: does not belong to this dataset".to_owned(),
        ] {
            assert!(error.contains(&line), "{line} in {error}");
        }
        fs::remove_file(path("data/train-00000-of-00001.parquet")).unwrap();
        assert_eq!(make(&config, dir.path()).unwrap().rows_made, 6);
        assert!(damaged(dir.path()).is_empty());
    }
}
