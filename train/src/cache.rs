//! The images of a dataset at the size of a network's input: decoded once into a file that is mapped into memory. So no
//! epoch waits for PNG, and of a dataset larger than the memory the system keeps what fits.
//!
//! ```text
//! DATASET/cache/0123456789abcdef-128x96.images    named by digest and size
//!     header    magic, format, width, height, images an example, examples, digest of the dataset
//!     pixels    [example, image, height, width, 3], a byte each
//! ```
//!
//! A file that is cut short, or of another format, dataset or size, is made again. The folder may be deleted.
#![allow(unsafe_code)]

use std::fs::{self, File};
use std::io::{ErrorKind, Write};
use std::path::{Path, PathBuf};
use std::{env, io};

use datagen::publish;
use memmap2::Mmap;

use crate::error::{Error, Result};
use crate::publish::at;
use crate::stream::ImageStream;

/// Name of the folder within that of the dataset.
const FOLDER: &str = "cache";
/// First bytes of a file.
const MAGIC: &[u8; 8] = b"FSIMAGES";
/// Version of the file's form and of what becomes of an image in [`input`](crate::input): other bytes need another number.
const FORMAT: u64 = 1;
/// Examples that are decoded at a time.
const CHUNK: u64 = 128;

/// The decoded images of one dataset.
#[derive(Debug)]
pub(crate) struct ImageCache {
    path: PathBuf,
    bytes: Mmap,
    /// Where the pixels begin.
    begin: usize,
    /// Bytes of an example.
    example: usize,
}

impl ImageCache {
    /// The images of a dataset, decoded first if they have not been; then `progress` hears how many examples are done.
    ///
    /// The file lies in the dataset's folder, or in a folder of the user's below the system's temporary one where
    /// nothing can be written there. Of several processes one decodes, and the others wait for it.
    pub(crate) fn of(images: &ImageStream, progress: &dyn Fn(usize)) -> Result<Self> {
        let contents = Contents { images };
        let beside = images.reader().dir().join(FOLDER);
        if let Ok(cache) = contents.open(&beside) {
            return Ok(cache);
        }
        let (folder, _locked) = if let Ok(lock) = locked(&beside) {
            (beside, lock)
        } else {
            let folder = of_user();
            let lock = locked(&folder).map_err(at(&folder))?;
            (folder, lock)
        };
        // Another process may have made it meanwhile.
        if let Ok(cache) = contents.open(&folder) {
            return Ok(cache);
        }
        let path = contents.path(&folder);
        publish::publish(&path, |file| contents.write(file, &path, progress))?;
        contents.open(&folder).map_err(at(&path))
    }

    /// The file.
    pub(crate) fn path(&self) -> &Path {
        &self.path
    }

    /// The pixels of an example, those of all its images one after the other.
    pub(crate) fn pixels(&self, example: u64) -> &[u8] {
        let begin = self.begin + example as usize * self.example;
        &self.bytes[begin..begin + self.example]
    }
}

/// What a file is made of.
struct Contents<'a> {
    images: &'a ImageStream,
}

impl Contents<'_> {
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

    /// Size of the whole file.
    fn size(&self) -> u64 {
        self.header().len() as u64 + self.images.reader().info().rows * self.images.example() as u64
    }

    /// Maps the file in a folder if it is there, and as it should be.
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
        Ok(ImageCache { path, bytes, begin: header.len(), example: self.images.example() })
    }

    /// Decodes some examples at a time, and writes them in their order.
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

/// Makes the folder, and waits until no other process writes in it. Version control is told to leave it out.
fn locked(folder: &Path) -> io::Result<File> {
    fs::create_dir_all(folder)?;
    fs::write(folder.join(".gitignore"), "*\n")?;
    let lock = File::create(folder.join(".lock"))?;
    lock.lock()?;
    Ok(lock)
}

/// Where files go that cannot lie in their dataset's folder.
fn of_user() -> PathBuf {
    let user = env::var("USER").or_else(|_| env::var("USERNAME")).unwrap_or_default();
    env::temp_dir().join(format!("flowservo-{FOLDER}-{user}"))
}

/// Maps a file for reading.
fn map(file: &File) -> io::Result<Mmap> {
    // SAFETY: nothing may change the file while it is mapped. This program writes it under another name, and never again
    // once it has its own; replacing or deleting it leaves the mapped one as it is. What another program could do is
    // against the purpose of the folder: overwritten pixels would be other pixels (every byte is one), and where the
    // file was cut short, the system would end this process at its next look there.
    unsafe { Mmap::map(file) }
}

#[cfg(test)]
pub(crate) mod tests {
    use std::cell::Cell;
    use std::thread;

    use datagen::{DatasetReader, ImagesRow};
    use tempfile::TempDir;

    use super::*;
    use crate::examples::tests::dataset;
    use crate::input::{self, decode};

    const SMALL: [usize; 2] = [32, 24];

    /// Images without a file.
    pub(crate) fn in_memory(pixels: &[u8], example: usize) -> ImageCache {
        let mut bytes = memmap2::MmapMut::map_anon(pixels.len()).unwrap();
        bytes.copy_from_slice(pixels);
        let bytes = bytes.make_read_only().unwrap();
        ImageCache { path: PathBuf::new(), bytes, begin: 0, example }
    }

    /// The images of a dataset of pairs, and how many examples were decoded for them.
    fn opened(dataset: &TempDir, input: [usize; 2]) -> Result<(ImageCache, usize)> {
        let (reader, decoded) = (DatasetReader::open(dataset.path()).unwrap(), Cell::new(0));
        let cache = ImageCache::of(&ImageStream::new(&reader, input, 2), &|done| decoded.set(done))?;
        Ok((cache, decoded.get()))
    }

    fn pixels(cache: &ImageCache) -> Vec<&[u8]> {
        (0..4).map(|example| cache.pixels(example)).collect()
    }

    /// The files with images in the folder, and what was left there by mistake.
    fn files(dataset: &TempDir) -> Vec<String> {
        let entries = fs::read_dir(dataset.path().join(FOLDER)).unwrap();
        let names = entries.map(|entry| entry.unwrap().file_name().into_string().unwrap());
        names.filter(|name| ![".gitignore", ".lock"].contains(&name.as_str())).collect()
    }

    /// Overwrites what makes the images of a dataset PNG.
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
    fn a_file_that_is_not_as_it_should_be_is_made_again() {
        let dataset = dataset("a", 60.0);
        let (cache, decoded) = opened(&dataset, SMALL).unwrap();
        assert_eq!(decoded, 4);
        let whole = fs::read(cache.path()).unwrap();
        let changed = |i: usize| {
            let mut bytes = whole.clone();
            bytes[i] ^= 1;
            bytes
        };
        // Cut short, empty, no cache at all, another format, another dataset.
        let short = whole[..whole.len() - 1].to_vec();
        for bytes in [short, Vec::new(), changed(0), changed(8), changed(MAGIC.len() + 40)] {
            fs::write(dataset.path().join("other"), bytes).unwrap();
            fs::rename(dataset.path().join("other"), cache.path()).unwrap();
            let (again, decoded) = opened(&dataset, SMALL).unwrap();
            assert_eq!((decoded, pixels(&again)), (4, pixels(&cache)));
        }
    }

    #[test]
    fn of_several_at_once_one_decodes() {
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
    fn a_folder_that_takes_nothing_is_avoided() {
        let dataset = dataset("a", 61.0);
        fs::write(dataset.path().join(FOLDER), "in the way").unwrap();
        let (cache, _) = opened(&dataset, SMALL).unwrap();
        assert!(cache.path().starts_with(env::temp_dir()) && !cache.path().starts_with(dataset.path()));
        assert_eq!(opened(&dataset, SMALL).unwrap().1, 0);
        fs::remove_file(cache.path()).unwrap();
    }

    #[test]
    fn a_full_disk_is_named_with_what_is_needed() {
        let dataset = dataset("a", 60.0);
        let reader = DatasetReader::open(dataset.path()).unwrap();
        let contents = Contents { images: &ImageStream::new(&reader, [64, 48], 2) };
        let mut room = [0; 10_000];
        let error =
            contents.write(&mut room.as_mut_slice(), Path::new("full/a.images"), &|_| ()).unwrap_err();
        assert!(matches!(error, Error::Cache { bytes: 73_840, .. }), "{error:?}");
        let said = error.to_string();
        assert!(said.starts_with("full/a.images: ") && said.contains("take 1 MB"), "{said}");
        let error = opened(&dataset, [128, 96]).unwrap_err().to_string();
        assert!(error.contains("64x48 pixels") && files(&dataset).is_empty(), "{error}");
    }

    /// Fails when images become other bytes: then [`FORMAT`] has to change, and this digest.
    #[test]
    fn the_format_covers_what_becomes_of_an_image() {
        let image = image::RgbImage::from_fn(25, 20, |x, y| {
            image::Rgb([x * 41 + y * 7, x * y * 13, x * 3 + y * y].map(|value| value as u8))
        });
        let pixels = input::shrink(&image, [10, 8]).unwrap();
        assert_eq!((FORMAT, &datagen::digest::digest(&pixels)[..16]), (1, "ce257097a3da619a"));
    }
}
