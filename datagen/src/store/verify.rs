//! Verifies every byte of a complete dataset.

use super::existing_files::stray_files;
use super::info::{self, DatasetInfo};
use crate::defect::{Defect, DefectKind};
use crate::error::{Error, Result};
use rayon::iter::{IntoParallelRefIterator, ParallelIterator};
use std::path::Path;

/// Lists all defects of a complete dataset, with the threads of the current rayon pool.
///
/// If `dataset.json` is damaged, it is the only defect listed, because the other digests are unknown.
pub fn verify(dir: &Path) -> Result<Vec<Defect>> {
    let info = match DatasetInfo::read(dir) {
        Ok(info) => info,
        Err(Error::Damaged { expected, found, .. }) => {
            return Ok(vec![Defect {
                path: info::FILE_NAME.to_owned(),
                kind: DefectKind::Form { expected, found },
            }]);
        }
        Err(error) => return Err(error),
    };
    let defect = |path: &String, kind| Defect { path: path.clone(), kind };
    let files = info.files.par_iter();
    let mut defects: Vec<Defect> =
        files.filter_map(|file| Some(defect(&file.path, file.defect(dir)?))).collect();
    defects.extend(info.document_defects(dir));
    defects.extend(stray_files(&info.config, dir)?.iter().map(|path| defect(path, DefectKind::Stray)));
    Ok(defects)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fixture::{config, make};
    use crate::store::{card, config_file};
    use rand::RngExt as _;
    use std::fs::{self, File};
    use std::io::{Seek as _, SeekFrom, Write as _};

    fn damaged(dir: &Path) -> Vec<String> {
        verify(dir).unwrap().into_iter().map(|defect| defect.path).collect()
    }

    #[test]
    fn every_flipped_bit_is_found_and_its_file_named() {
        let dir = tempfile::tempdir().unwrap();
        let mut config = config("c", 3);
        (config.world.camera.width, config.world.camera.height) = (8, 8);
        make(&config, dir.path()).unwrap();
        assert!(damaged(dir.path()).is_empty());
        let data = "data/train-00000-of-00001.parquet";
        let mut random = crate::scene::stream(1, 2);
        for name in [info::FILE_NAME, card::FILE_NAME, config_file::FILE_NAME, data] {
            let path = dir.path().join(name);
            let whole = fs::read(&path).unwrap();
            let positions: Vec<usize> = match name {
                _ if name == data => (0..300).map(|_| random.random_range(0..whole.len())).collect(),
                _ => (0..whole.len()).collect(),
            };
            // Written in place: some file systems flush a newly written file.
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
            if name == info::FILE_NAME {
                assert!(matches!(verify(dir.path()), Err(Error::Incomplete { .. })));
            } else {
                assert_eq!(verify(dir.path()).unwrap()[0].to_string(), format!("{name}: missing"));
            }
            fs::write(&path, &whole).unwrap();
        }
        assert!(damaged(dir.path()).is_empty());
    }

    #[test]
    fn all_damaged_files_are_named_and_generated_again() {
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
        let defects = verify(dir.path()).unwrap();
        let error = Error::Defective { dir: dir.path().to_owned(), defects }.to_string();
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
