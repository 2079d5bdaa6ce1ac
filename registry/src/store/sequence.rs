//! Numbered pointers, the only objects with a name of their own: each holds the digest of a document, and the document is a blob.
//!
//! The number finds the document, and the digest proves it. A pointer is created once under the next free number, so of two
//! simultaneous writers one gets the number and the other notices. The versions of a model are such a sequence, and so are the
//! events of a version or an alias.

use std::fmt::Display;

use serde::Serialize;

use super::{DOCUMENT_LIMIT, Store, blob_key, file_name};
use crate::digest::Digest;
use crate::error::{Error, Result};
use crate::problem::Fault;

/// The highest number. Numbers have six digits, so that they sort as text.
pub(crate) const LAST_NUMBER: u64 = 999_999;

/// Returns the key of pointer `number` in `folder`.
pub(crate) fn pointer_key(folder: &str, number: u64) -> String {
    format!("{folder}/{number:06}")
}

/// Parses the name of a pointer or of a version's folder, as `000007`.
pub(crate) fn parse_number(name: &str) -> Option<u64> {
    let number = name.parse().ok()?;
    ((1..=LAST_NUMBER).contains(&number) && name == format!("{number:06}")).then_some(number)
}

/// Parses the content of a pointer: a digest and a line feed.
pub(crate) fn parse_pointer(bytes: &[u8]) -> std::result::Result<Digest, String> {
    let text = std::str::from_utf8(bytes).ok().and_then(|text| text.strip_suffix('\n'));
    let text = text.ok_or_else(|| "expected a digest and a line feed".to_owned())?;
    text.parse().map_err(|error| format!("{error}"))
}

/// Serializes a document of `subject`: to the same bytes on every machine.
pub(crate) fn encode(subject: &dyn Display, document: &impl Serialize) -> Result<Vec<u8>> {
    let text = serde_json::to_string_pretty(document);
    Ok((text.map_err(|error| Error::refused(subject, error.to_string()))? + "\n").into_bytes())
}

impl Store {
    /// Returns the numbers of the pointers in `folder`, in ascending order.
    pub(crate) fn numbers(&self, folder: &str) -> Result<Vec<u64>> {
        let objects = self.list(folder)?.checked()?.objects;
        Ok(objects.iter().filter_map(|object| parse_number(file_name(&object.key))).collect())
    }

    /// Reads the digests in these pointers. Damaged pointers are left out.
    pub(crate) fn pointers(&self, folder: &str, numbers: &[u64]) -> Result<Vec<(u64, Digest)>> {
        let keys: Vec<_> = numbers.iter().map(|&number| pointer_key(folder, number)).collect();
        let pointers = numbers.iter().zip(self.read_each(&keys)?);
        Ok(pointers.filter_map(|(&number, bytes)| Some((number, parse_pointer(&bytes).ok()?))).collect())
    }

    /// Reads the document of `subject` that the pointer `key` names, and its digest. Both are verified.
    pub(crate) fn follow(&self, subject: &str, key: &str) -> Result<(Vec<u8>, Digest)> {
        let fail = |fault: Fault| Error::from(fault.of(subject, key));
        let pointer = self.read(key)?.ok_or_else(|| fail(Fault::Missing))?;
        let digest = parse_pointer(&pointer).map_err(|reason| fail(Fault::Malformed { reason }))?;
        match self.document(subject, digest) {
            Err(Error::Damaged(problem)) if problem.fault == Fault::Missing => {
                Err(fail(Fault::Dangling { digest }))
            }
            document => Ok((document?, digest)),
        }
    }

    /// Reads the document of `subject` with this digest, and verifies it.
    pub(crate) fn document(&self, subject: &str, digest: Digest) -> Result<Vec<u8>> {
        let key = blob_key(digest);
        let fault = match self.read(&key)? {
            None => Fault::Missing,
            Some(bytes) if bytes.len() as u64 > DOCUMENT_LIMIT => {
                Fault::Malformed { reason: format!("it has more than {DOCUMENT_LIMIT} bytes") }
            }
            Some(bytes) => match Digest::of(&bytes) {
                found if found == digest => return Ok(bytes),
                found => Fault::Digest { expected: digest, found },
            },
        };
        Err(fault.of(subject, &key).into())
    }

    /// Stores a document of `subject` as a blob.
    pub(crate) fn put_document(&self, subject: &dyn Display, document: &[u8]) -> Result<Digest> {
        if document.len() as u64 > DOCUMENT_LIMIT {
            let size = document.len();
            let reason = format!("its document would have {size} bytes, more than {DOCUMENT_LIMIT}");
            return Err(Error::refused(subject, reason));
        }
        self.put_blob(document.to_owned())
    }

    /// Creates pointer `number` to a document. Returns false if another document has the number.
    pub(crate) fn point(&self, folder: &str, number: u64, digest: Digest) -> Result<bool> {
        if number > LAST_NUMBER {
            let reason = format!("all {LAST_NUMBER} numbers are taken; publish under a new name");
            return Err(Error::refused(&folder, reason));
        }
        self.create(&pointer_key(folder, number), format!("{digest}\n").into_bytes())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_have_one_spelling() {
        assert_eq!(parse_number("000007"), Some(7));
        for stray in ["7", "000000", "+00007", "000007.json", "x", "0000007", "1234567", ""] {
            assert_eq!(parse_number(stray), None, "{stray}");
        }
    }

    #[test]
    fn pointers_have_one_spelling() {
        let digest = Digest::of(b"x");
        assert_eq!(parse_pointer(format!("{digest}\n").as_bytes()), Ok(digest));
        let upper = format!("sha256:{}\n", digest.hex().to_uppercase());
        for bad in ["", "\n", &format!("{digest}"), &format!("{digest}\n\n"), &format!(" {digest}\n"), &upper]
        {
            assert!(parse_pointer(bad.as_bytes()).is_err(), "{bad:?}");
        }
        let intact = format!("{digest}\n").into_bytes();
        for bit in 0..8 * intact.len() {
            let mut damaged = intact.clone();
            damaged[bit / 8] ^= 1 << (bit % 8);
            assert_ne!(parse_pointer(&damaged), Ok(digest), "bit {bit}");
        }
    }
}
