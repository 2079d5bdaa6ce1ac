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

/// SHA-256 of some content, written as `sha256:` and 64 lower-case hexadecimal digits.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(try_from = "String", into = "String")]
pub struct Digest([u8; 32]);

/// A text that is not a digest.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("`{0}` is not a digest: expected `sha256:` and 64 lower-case hexadecimal digits")]
pub struct InvalidDigest(String);

impl Digest {
    /// Computes the digest of `content`.
    pub fn of(content: &[u8]) -> Self {
        Fingerprint::of_bytes(content).digest
    }

    /// Returns the 32 bytes.
    pub(crate) fn bytes(&self) -> &[u8; 32] {
        &self.0
    }

    /// Returns the 64 hexadecimal digits alone.
    pub fn hex(&self) -> String {
        hex::encode(self.0)
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
    type Err = InvalidDigest;

    fn from_str(text: &str) -> Result<Self, InvalidDigest> {
        let mut digest = Self([0; 32]);
        let decoded = text.strip_prefix("sha256:").map(|digits| hex::decode_to_slice(digits, &mut digest.0));
        // The decoder also takes upper-case digits, but a digest has one spelling.
        let is_exact = decoded.is_some_and(|decoded| decoded.is_ok()) && digest.to_string() == text;
        if is_exact { Ok(digest) } else { Err(InvalidDigest(text.to_owned())) }
    }
}

impl TryFrom<String> for Digest {
    type Error = InvalidDigest;

    fn try_from(text: String) -> Result<Self, InvalidDigest> {
        text.parse()
    }
}

impl From<Digest> for String {
    fn from(digest: Digest) -> Self {
        digest.to_string()
    }
}

/// Digest and size of some content. Contents with equal fingerprints are equal.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Fingerprint {
    pub(crate) digest: Digest,
    pub(crate) size: u64,
}

impl Fingerprint {
    /// Computes the fingerprint of `content`.
    pub(crate) fn of_bytes(content: &[u8]) -> Self {
        let mut hasher = Hasher::default();
        hasher.update(content);
        hasher.finish()
    }

    /// Computes the fingerprint of everything that `reader` returns, in bounded memory.
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

/// Computes a fingerprint piece by piece.
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

/// Runs `work` while another thread hashes the pieces that it hands over. Hashing takes about as long as reading or writing.
pub(crate) fn hash_in_background<T, E>(
    work: impl FnOnce(&mut dyn FnMut(Bytes)) -> Result<T, E>,
) -> Result<(T, Fingerprint), E> {
    thread::scope(|scope| {
        let (sender, pieces) = mpsc::sync_channel::<Bytes>(1);
        let hashing = scope.spawn(move || {
            let mut hasher = Hasher::default();
            for piece in pieces {
                hasher.update(&piece);
            }
            hasher.finish()
        });
        // Sending fails only if hashing panicked, which is propagated below.
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
