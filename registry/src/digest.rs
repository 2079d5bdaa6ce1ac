//! SHA-256 digests: the names of contents, as OCI registries write them.

use std::fmt;
use std::str::FromStr;

use serde::{Deserialize, Serialize};
use sha2::{Digest as _, Sha256};

/// SHA-256 of some content, written as `sha256:` and 64 lower-case hexadecimal digits.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(try_from = "String", into = "String")]
pub struct Digest(pub(crate) [u8; 32]);

/// A text that is not a digest.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("`{0}` is not a digest: expected `sha256:` and 64 lower-case hexadecimal digits")]
pub struct InvalidDigest(String);

impl Digest {
    /// Computes the digest of `content`.
    pub fn of(content: &[u8]) -> Self {
        Fingerprint::of([content]).digest
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
    /// Computes the fingerprint of content that arrives in pieces.
    pub(crate) fn of(pieces: impl IntoIterator<Item: AsRef<[u8]>>) -> Self {
        let (mut state, mut size) = (Sha256::new(), 0);
        for piece in pieces {
            state.update(&piece);
            size += piece.as_ref().len() as u64;
        }
        Self { digest: Digest(state.finalize().into()), size }
    }
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
        assert_eq!(Fingerprint::of(["a", "bc"]), Fingerprint { digest: abc.parse().unwrap(), size: 3 });
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
