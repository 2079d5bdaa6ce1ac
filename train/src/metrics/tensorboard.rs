//! TensorBoard's event files, in the folder `tensorboard` of a run. They hold scalars over steps.
//!
//! A file is a sequence of `TFRecord`s (`tensorflow/core/lib/io/record_writer.h`: length, its checksum, data, its checksum).
//! Each is an `Event` (`tensorflow/core/util/event.proto`, protocol buffers). The few fields that scalars need are encoded
//! by hand.

use std::fs::{self, File};
use std::io::Write;
use std::path::{Path, PathBuf};

use crate::error::{Result, at};

/// Field numbers of `Event`.
const WALL_TIME: u32 = 1;
const STEP: u32 = 2;
const FILE_VERSION: u32 = 3;
const SUMMARY: u32 = 5;
const SESSION_LOG: u32 = 7;
/// Field numbers of `Summary`, `Summary.Value` and `SessionLog`.
const VALUE: u32 = 1;
const TAG: u32 = 1;
const SIMPLE_VALUE: u32 = 2;
const STATUS: u32 = 1;
/// `SessionLog.SessionStatus`.
const START: u64 = 1;

/// Prefix of a file name, followed by its number.
const PREFIX: &str = "events.out.tfevents.";

/// An open event file.
#[derive(Debug)]
pub(crate) struct EventFile {
    path: PathBuf,
    file: File,
}

impl EventFile {
    /// Creates the next file of a folder. It invalidates events of earlier files from step `first` on, which are about to be
    /// repeated. `unix_time` is in seconds.
    pub(crate) fn create(folder: &Path, first: usize, unix_time: f64) -> Result<Self> {
        fs::create_dir_all(folder).map_err(at(folder))?;
        // TensorBoard reads the files of a folder in the order of their names.
        let names =
            fs::read_dir(folder).map_err(at(folder))?.filter_map(|entry| Some(entry.ok()?.file_name()));
        let number = names.filter_map(|name| number(name.to_str()?)).max().map_or(0, |latest| latest + 1);
        let path = folder.join(format!("{PREFIX}{number:06}.flowservo"));
        let file = File::create_new(&path).map_err(at(&path))?;
        let mut events = Self { path, file };
        let mut version = timed(unix_time);
        bytes_field(&mut version, FILE_VERSION, b"brain.Event:2");
        events.write(&version)?;
        let mut session = Vec::new();
        varint_field(&mut session, STATUS, START);
        let mut started = timed(unix_time);
        varint_field(&mut started, STEP, first as u64);
        bytes_field(&mut started, SESSION_LOG, &session);
        events.write(&started)?;
        Ok(events)
    }

    /// Adds named values at a step.
    pub(crate) fn scalars(&mut self, step: usize, unix_time: f64, values: &[(String, f64)]) -> Result<()> {
        let mut summary = Vec::new();
        for (tag, value) in values {
            let mut entry = Vec::new();
            bytes_field(&mut entry, TAG, tag.as_bytes());
            key(&mut entry, SIMPLE_VALUE, Wire::Fixed32);
            entry.extend((*value as f32).to_le_bytes());
            bytes_field(&mut summary, VALUE, &entry);
        }
        let mut event = timed(unix_time);
        varint_field(&mut event, STEP, step as u64);
        bytes_field(&mut event, SUMMARY, &summary);
        self.write(&event)
    }

    /// Writes a record in one system call, so that records survive a killed process and at most the last one is truncated.
    fn write(&mut self, event: &[u8]) -> Result<()> {
        self.file.write_all(&framed(event)).map_err(at(&self.path))
    }
}

/// Returns the number in the name of an event file.
fn number(name: &str) -> Option<u64> {
    name.strip_prefix(PREFIX)?.split('.').next()?.parse().ok()
}

/// Returns an `Event` that has only its time.
fn timed(unix_time: f64) -> Vec<u8> {
    let mut event = Vec::new();
    key(&mut event, WALL_TIME, Wire::Fixed64);
    event.extend(unix_time.to_le_bytes());
    event
}

/// Frames data as a `TFRecord`.
fn framed(data: &[u8]) -> Vec<u8> {
    let length = (data.len() as u64).to_le_bytes();
    [&length[..], &masked_crc(&length), data, &masked_crc(data)].concat()
}

/// Returns the CRC-32C, rotated and offset, as is customary for data that contain checksums themselves.
fn masked_crc(data: &[u8]) -> [u8; 4] {
    crc32c::crc32c(data).rotate_right(15).wrapping_add(0xa282_ead8).to_le_bytes()
}

/// Wire type of a field.
#[derive(Clone, Copy)]
enum Wire {
    Varint = 0,
    Fixed64 = 1,
    Bytes = 2,
    Fixed32 = 5,
}

fn key(message: &mut Vec<u8>, field: u32, wire: Wire) {
    varint(message, u64::from(field << 3 | wire as u32));
}

fn varint_field(message: &mut Vec<u8>, field: u32, value: u64) {
    key(message, field, Wire::Varint);
    varint(message, value);
}

fn bytes_field(message: &mut Vec<u8>, field: u32, value: &[u8]) {
    key(message, field, Wire::Bytes);
    varint(message, value.len() as u64);
    message.extend(value);
}

/// Encodes seven bits per byte, lowest first. The eighth bit marks that more bytes follow.
fn varint(message: &mut Vec<u8>, mut value: u64) {
    while value >= 0x80 {
        message.push(value as u8 | 0x80);
        value >>= 7;
    }
    message.push(value as u8);
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn checksums_of_rfc_3720() {
        // Appendix B.4: 32 bytes of zeros, of ones, and in ascending order.
        assert_eq!(crc32c::crc32c(&[0; 32]), 0x8a91_36aa);
        assert_eq!(crc32c::crc32c(&[0xff; 32]), 0x62a8_ab43);
        assert_eq!(crc32c::crc32c(&(0..32).collect::<Vec<u8>>()), 0x46dd_794e);
    }

    /// Output of the writer in Python's `tensorboard` 2.21 for the same events.
    const GOLDEN: [&str; 3] = [
        "1800000000000000a37f4b2209000000c00b5ad6411a0d627261696e2e4576656e743a324ca9a464",
        "100000000000000095fbfe1809000000c00b5ad64110ad023a020801a62462fc",
        "2a00000000000000ae8d91f509000010c00b5ad64110b6022a1c0a100a09737465702f6c6f7373150000003e0a080a0178150000\
         40c02d6e0cbb",
    ];

    #[test]
    fn files_are_those_of_tensorboard_and_in_order() {
        let folder = tempfile::tempdir().unwrap();
        let mut events = EventFile::create(folder.path(), 301, 1.5e9).unwrap();
        events.scalars(310, 1.5e9 + 0.25, &[("step/loss".into(), 0.125), ("x".into(), -3.0)]).unwrap();
        let bytes = fs::read(&events.path).unwrap();
        assert_eq!(format!("{bytes:02x?}").replace(['[', ',', ' ', ']'], ""), GOLDEN.concat());
        let next = EventFile::create(folder.path(), 306, 1.5e9).unwrap();
        assert!(next.path > events.path);
        fs::remove_file(&events.path).unwrap();
        assert!(EventFile::create(folder.path(), 306, 1.5e9).unwrap().path > next.path);
    }
}
