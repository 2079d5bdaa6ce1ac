//! SHA-256 digests: the names of contents, as OCI registries write them.

use std::fmt;
use std::io::{self, Read};
use std::panic::resume_unwind;
use std::str::FromStr;
use std::sync::mpsc;
use std::thread;

use bytes::Bytes;
use serde::{Deserialize, Serialize};
use sha2::{Digest as _, Sha256};

use crate::error::{Error, Result};

/// SHA-256 of some content, written `sha256:` and 64 lower-case hexadecimal digits.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(try_from = "String", into = "String")]
pub struct Digest([u8; 32]);

impl Digest {
    /// The digest of `content`.
    pub fn of(content: &[u8]) -> Self {
        let mut hasher = Hasher::default();
        hasher.update(content);
        hasher.finish().digest
    }

    /// The 32 bytes.
    pub(crate) fn bytes(&self) -> &[u8; 32] {
        &self.0
    }

    /// The 64 hexadecimal digits alone.
    pub fn hex(&self) -> String {
        let nibbles = self.0.iter().flat_map(|byte| [byte >> 4, byte & 15]);
        nibbles.filter_map(|nibble| char::from_digit(nibble.into(), 16)).collect()
    }
}

impl fmt::Display for Digest {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "sha256:{}", self.hex())
    }
}

impl fmt::Debug for Digest {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        fmt::Display::fmt(self, f)
    }
}

impl FromStr for Digest {
    type Err = Error;

    fn from_str(text: &str) -> Result<Self> {
        let refusal = || Error::Digest { text: text.to_owned() };
        let hex = text.strip_prefix("sha256:").filter(|hex| hex.len() == 64).ok_or_else(refusal)?;
        let mut bytes = [0; 32];
        for (byte, pair) in bytes.iter_mut().zip(hex.as_bytes().chunks_exact(2)) {
            *byte = nibble(pair[0])
                .zip(nibble(pair[1]))
                .map(|(high, low)| high << 4 | low)
                .ok_or_else(refusal)?;
        }
        Ok(Self(bytes))
    }
}

fn nibble(digit: u8) -> Option<u8> {
    match digit {
        b'0'..=b'9' => Some(digit - b'0'),
        b'a'..=b'f' => Some(digit - b'a' + 10),
        _ => None,
    }
}

impl TryFrom<String> for Digest {
    type Error = Error;

    fn try_from(text: String) -> Result<Self> {
        text.parse()
    }
}

impl From<Digest> for String {
    fn from(digest: Digest) -> Self {
        digest.to_string()
    }
}

/// What a content is known by: two contents with the same fingerprint are the same.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Fingerprint {
    pub(crate) digest: Digest,
    pub(crate) size: u64,
}

impl Fingerprint {
    /// Of all that `reader` gives, in bounded memory.
    pub(crate) fn of(mut reader: impl Read) -> io::Result<Self> {
        let mut hasher = Hasher::default();
        let mut buffer = vec![0; 1 << 16];
        loop {
            match reader.read(&mut buffer) {
                Ok(0) => return Ok(hasher.finish()),
                Ok(count) => hasher.update(&buffer[..count]),
                Err(error) if error.kind() == io::ErrorKind::Interrupted => {}
                Err(error) => return Err(error),
            }
        }
    }
}

/// Takes a content piece by piece.
#[derive(Default)]
pub(crate) struct Hasher {
    state: Sha256,
    size: u64,
}

impl Hasher {
    pub(crate) fn update(&mut self, piece: &[u8]) {
        self.state.update(piece);
        self.size += piece.len() as u64;
    }

    pub(crate) fn finish(self) -> Fingerprint {
        Fingerprint { digest: Digest(self.state.finalize().into()), size: self.size }
    }
}

/// Does `work` while a thread hashes what it hands over: the hash costs as much time as reading or writing does.
pub(crate) fn hash_meanwhile<T>(
    work: impl FnOnce(&mut dyn FnMut(Bytes)) -> Result<T>,
) -> Result<(T, Fingerprint)> {
    thread::scope(|scope| {
        let (sender, pieces) = mpsc::sync_channel::<Bytes>(1);
        let hashing = scope.spawn(move || {
            let mut hasher = Hasher::default();
            for piece in pieces {
                hasher.update(&piece);
            }
            hasher.finish()
        });
        // Nobody receives only if hashing panicked, which comes to light at the end.
        let done = work(&mut |piece| drop(sender.send(piece)));
        drop(sender);
        let content = hashing.join().unwrap_or_else(|panic| resume_unwind(panic));
        Ok((done?, content))
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// FIPS 180-2, appendix B.1, and the well-known digest of the empty message.
    #[test]
    fn published_digests() {
        let abc = "sha256:ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad";
        let empty = "sha256:e3b0c44298fc1c149afbf4c8996fb92427ae41e4649b934ca495991b7852b855";
        assert_eq!(Digest::of(b"abc").to_string(), abc);
        assert_eq!(Digest::of(b""), empty.parse().unwrap());
        assert_eq!(
            Fingerprint::of(&b"abc"[..]).unwrap(),
            Fingerprint { digest: abc.parse().unwrap(), size: 3 }
        );
    }

    #[test]
    fn malformed_digests_are_refused() {
        let hex = "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad";
        for text in
            [hex, &format!("sha256:{}", &hex[1..]), &format!("sha256:{}", hex.to_uppercase()), "sha256:", ""]
        {
            assert!(text.parse::<Digest>().is_err(), "{text}");
        }
    }
}
