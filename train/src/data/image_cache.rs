//! The images of a dataset at the size of a network's input, decoded once into a memory-mapped file. No epoch waits for PNG
//! decoding, and the operating system keeps as much of a large dataset in memory as fits.
//!
//! ```text
//! DATASET/cache/0123456789abcdef-128x96.images    named by digest and size
//!     header    magic, format, width, height, images per example, examples, digest of the dataset
//!     pixels    [example, image, height, width, 3], one byte each
//! ```
//!
//! A file that is truncated or belongs to another format, dataset or size is replaced. The folder can be deleted.
#![allow(unsafe_code)]

use std::fs::{self, File};
use std::io::{ErrorKind, Write};
use std::path::{Path, PathBuf};
use std::{env, io};

use datagen::publish;
use memmap2::Mmap;

use super::image_stream::ImageStream;
use crate::error::{Error, Result, at};

/// Name of the folder in the dataset.
const FOLDER: &str = "cache";
/// First bytes of a file.
const MAGIC: &[u8; 8] = b"FSIMAGES";
/// Version of the file layout and of the conversion in [`input`](super::input). Increase it whenever the bytes change.
const FORMAT: u64 = 1;
/// Examples decoded at a time.
const CHUNK: u64 = 128;

/// The decoded images of one dataset.
#[derive(Debug)]
pub(crate) struct ImageCache {
    path: PathBuf,
    bytes: Mmap,
    /// Offset of the pixels.
    begin: usize,
    /// Bytes per example.
    example_len: usize,
}

impl ImageCache {
    /// Opens the cache of a dataset. If there is none, decodes the images first and reports the number of decoded examples
    /// to `progress`.
    ///
    /// The file is stored in the dataset's folder, or in a temporary folder of the user if that is not writable. If
    /// several processes need the same file, one decodes and the others wait for it.
    pub(crate) fn open(images: &ImageStream, progress: &dyn Fn(usize)) -> Result<Self> {
        let file = CacheFile { images };
        let beside = images.reader().dir().join(FOLDER);
        if let Ok(cache) = file.open(&beside) {
            return Ok(cache);
        }
        let (folder, _lock) = if let Ok(lock) = lock(&beside) {
            (beside, lock)
        } else {
            let folder = user_folder();
            let lock = lock(&folder).map_err(at(&folder))?;
            (folder, lock)
        };
        // Another process may have written it in the meantime.
        if let Ok(cache) = file.open(&folder) {
            return Ok(cache);
        }
        let path = file.path(&folder);
        publish::publish(&path, |output| file.write(output, &path, progress))?;
        file.open(&folder).map_err(at(&path))
    }

    /// Returns the path of the file.
    pub(crate) fn path(&self) -> &Path {
        &self.path
    }

    /// Returns the pixels of an example: those of its images, one after the other.
    pub(crate) fn pixels(&self, example: u64) -> &[u8] {
        let begin = self.begin + example as usize * self.example_len;
        &self.bytes[begin..begin + self.example_len]
    }
}

/// The cache file of a dataset, which may not exist yet.
struct CacheFile<'a> {
    images: &'a ImageStream,
}

impl CacheFile<'_> {
    fn path(&self, folder: &Path) -> PathBuf {
        let [width, height] = self.images.input;
        let digest = self.images.reader().info().digest.chars().filter(char::is_ascii_alphanumeric);
        folder.join(format!("{}-{width}x{height}.images", digest.take(16).collect::<String>()))
    }

    fn header(&self) -> Vec<u8> {
        let ImageStream { input, images_each, .. } = *self.images;
        let info = self.images.reader().info();
        let sizes = [input[0] as u64, input[1] as u64, images_each as u64, info.rows];
        let sizes = sizes.map(u64::to_le_bytes);
        [MAGIC, &FORMAT.to_le_bytes(), sizes.as_flattened(), info.digest.as_bytes()].concat()
    }

    /// Returns the size of the file.
    fn size(&self) -> u64 {
        self.header().len() as u64 + self.images.reader().info().rows * self.images.example_len() as u64
    }

    /// Maps the file in a folder if it exists and is valid.
    fn open(&self, folder: &Path) -> io::Result<ImageCache> {
        let (path, header) = (self.path(folder), self.header());
        let file = File::open(&path)?;
        if file.metadata()?.len() != self.size() {
            return Err(ErrorKind::InvalidData.into());
        }
        let bytes = map(&file)?;
        if !bytes.starts_with(&header) {
            return Err(ErrorKind::InvalidData.into());
        }
        Ok(ImageCache { path, bytes, begin: header.len(), example_len: self.images.example_len() })
    }

    /// Decodes all examples, chunk by chunk, and writes them in order.
    fn write(&self, file: &mut dyn Write, path: &Path, progress: &dyn Fn(usize)) -> Result<()> {
        let failed = |source| Error::Cache { path: path.to_owned(), bytes: self.size(), source };
        file.write_all(&self.header()).map_err(failed)?;
        let rows = self.images.reader().info().rows;
        let mut done = 0;
        while done < rows {
            let end = rows.min(done + CHUNK);
            let decoded = self.images.pixels(&(done..end).collect::<Vec<_>>())?;
            decoded.iter().try_for_each(|pixels| file.write_all(pixels)).map_err(failed)?;
            done = end;
            progress(done as usize);
        }
        Ok(())
    }
}

/// Creates the folder, excludes it from version control, and locks it against other processes.
fn lock(folder: &Path) -> io::Result<File> {
    fs::create_dir_all(folder)?;
    fs::write(folder.join(".gitignore"), "*\n")?;
    let lock = File::create(folder.join(".lock"))?;
    lock.lock()?;
    Ok(lock)
}

/// Returns the folder for datasets that are not writable.
fn user_folder() -> PathBuf {
    let user = env::var("USER").or_else(|_| env::var("USERNAME")).unwrap_or_default();
    env::temp_dir().join(format!("flowservo-{FOLDER}-{user}"))
}

/// Maps a file for reading.
fn map(file: &File) -> io::Result<Mmap> {
    // SAFETY: the file must not change while it is mapped. This program writes it under a temporary name and never
    // modifies it after the rename. Replacing or deleting it does not affect an existing mapping. Another program that
    // overwrites it would change pixels, all of which are valid bytes; one that truncates it would end this process with
    // a bus error.
    unsafe { Mmap::map(file) }
}

#[cfg(test)]
pub(crate) mod tests {
    use std::cell::Cell;
    use std::thread;

    use datagen::{DatasetReader, ImagesRow};
    use tempfile::TempDir;

    use super::*;
    use crate::data::examples::tests::dataset;
    use crate::data::input::{self, decode};

    const SMALL: [usize; 2] = [32, 24];

    /// Returns a cache without a file.
    pub(crate) fn in_memory(pixels: &[u8], example_len: usize) -> ImageCache {
        let mut bytes = memmap2::MmapMut::map_anon(pixels.len()).unwrap();
        bytes.copy_from_slice(pixels);
        let bytes = bytes.make_read_only().unwrap();
        ImageCache { path: PathBuf::new(), bytes, begin: 0, example_len }
    }

    /// Opens the cache of a dataset of pairs. Also returns how many examples were decoded for it.
    fn opened(dataset: &TempDir, input: [usize; 2]) -> Result<(ImageCache, usize)> {
        let (reader, decoded) = (DatasetReader::open(dataset.path()).unwrap(), Cell::new(0));
        let cache = ImageCache::open(&ImageStream::new(&reader, input, 2), &|done| decoded.set(done))?;
        Ok((cache, decoded.get()))
    }

    fn pixels(cache: &ImageCache) -> Vec<&[u8]> {
        (0..4).map(|example| cache.pixels(example)).collect()
    }

    /// Lists the files in the folder, except those that always accompany the images.
    fn files(dataset: &TempDir) -> Vec<String> {
        let entries = fs::read_dir(dataset.path().join(FOLDER)).unwrap();
        let names = entries.map(|entry| entry.unwrap().file_name().into_string().unwrap());
        names.filter(|name| ![".gitignore", ".lock"].contains(&name.as_str())).collect()
    }

    /// Overwrites the PNG signatures in a dataset.
    pub(crate) fn destroy_images(dataset: &TempDir) {
        for entry in fs::read_dir(dataset.path().join("data")).unwrap() {
            let path = entry.unwrap().path();
            let mut bytes = fs::read(&path).unwrap();
            let begins: Vec<_> = (0..bytes.len()).filter(|&i| bytes[i..].starts_with(b"\x89PNG")).collect();
            for begin in begins {
                bytes[begin..begin + 4].fill(0);
            }
            fs::write(&path, bytes).unwrap();
        }
    }

    #[test]
    fn images_are_decoded_once_for_each_size() {
        let dataset = dataset("a", 60.0);
        let [(small, _), (tiny, _)] = [SMALL, [16, 12]].map(|input| opened(&dataset, input).unwrap());
        assert_eq!((small.path().parent(), files(&dataset).len()), (Some(&*dataset.path().join(FOLDER)), 2));
        let rows = DatasetReader::open(dataset.path()).unwrap().all::<ImagesRow>().unwrap();
        let rows: Vec<_> = rows.map(Result::unwrap).collect();
        for (cache, input) in [(&small, SMALL), (&tiny, [16, 12])] {
            let decoded =
                rows.iter().map(|row| [0, 1].map(|i| decode(&row.images[i], input).unwrap()).concat());
            let decoded: Vec<_> = decoded.collect();
            assert_eq!(pixels(cache), decoded);
        }
        destroy_images(&dataset);
        let (again, decoded) = opened(&dataset, SMALL).unwrap();
        assert_eq!((pixels(&again), decoded), (pixels(&small), 0));
        let error = opened(&dataset, [24, 18]).unwrap_err().to_string();
        assert!(error.contains("row") && files(&dataset).len() == 2, "{error}");
    }

    #[test]
    fn an_invalid_cache_is_replaced() {
        let dataset = dataset("a", 60.0);
        let (cache, decoded) = opened(&dataset, SMALL).unwrap();
        assert_eq!(decoded, 4);
        let whole = fs::read(cache.path()).unwrap();
        let changed = |i: usize| {
            let mut bytes = whole.clone();
            bytes[i] ^= 1;
            bytes
        };
        // Truncated, empty, not a cache, another format, another dataset.
        let short = whole[..whole.len() - 1].to_vec();
        for bytes in [short, Vec::new(), changed(0), changed(8), changed(MAGIC.len() + 40)] {
            fs::write(dataset.path().join("other"), bytes).unwrap();
            fs::rename(dataset.path().join("other"), cache.path()).unwrap();
            let (again, decoded) = opened(&dataset, SMALL).unwrap();
            assert_eq!((decoded, pixels(&again)), (4, pixels(&cache)));
        }
    }

    #[test]
    fn concurrent_opens_decode_once() {
        let dataset = dataset("a", 60.0);
        let decoded: Vec<_> = thread::scope(|scope| {
            let threads: Vec<_> =
                (0..3).map(|_| scope.spawn(|| opened(&dataset, SMALL).unwrap().1)).collect();
            threads.into_iter().map(|thread| thread.join().unwrap()).collect()
        });
        assert_eq!(decoded.iter().sum::<usize>(), 4, "{decoded:?}");
        assert_eq!(files(&dataset).len(), 1);
    }

    #[test]
    fn an_unwritable_folder_is_avoided() {
        let dataset = dataset("a", 61.0);
        fs::write(dataset.path().join(FOLDER), "in the way").unwrap();
        let (cache, _) = opened(&dataset, SMALL).unwrap();
        assert!(cache.path().starts_with(env::temp_dir()) && !cache.path().starts_with(dataset.path()));
        assert_eq!(opened(&dataset, SMALL).unwrap().1, 0);
        fs::remove_file(cache.path()).unwrap();
    }

    #[test]
    fn a_full_disk_is_reported_with_the_needed_size() {
        let dataset = dataset("a", 60.0);
        let reader = DatasetReader::open(dataset.path()).unwrap();
        let file = CacheFile { images: &ImageStream::new(&reader, [64, 48], 2) };
        let mut room = [0; 10_000];
        let error = file.write(&mut room.as_mut_slice(), Path::new("full/a.images"), &|_| ()).unwrap_err();
        assert!(matches!(error, Error::Cache { bytes: 73_840, .. }), "{error:?}");
        let said = error.to_string();
        assert!(said.starts_with("full/a.images: ") && said.contains("need 1 MB"), "{said}");
        let error = opened(&dataset, [128, 96]).unwrap_err().to_string();
        assert!(error.contains("64x48 pixels") && files(&dataset).is_empty(), "{error}");
    }

    /// Fails when the conversion of images changes. Then increase [`FORMAT`] and update this digest.
    #[test]
    fn the_format_covers_the_conversion_of_images() {
        let image = image::RgbImage::from_fn(25, 20, |x, y| {
            image::Rgb([x * 41 + y * 7, x * y * 13, x * 3 + y * y].map(|value| value as u8))
        });
        let pixels = input::downsample(&image, [10, 8]).unwrap();
        assert_eq!((FORMAT, &datagen::digest::digest(&pixels)[..16]), (1, "ce257097a3da619a"));
    }
}
