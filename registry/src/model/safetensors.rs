//! Headers of safetensors files, checked before any program reads the weights behind them.
//!
//! The format's own parser finds sizes that overflow, overlapping tensors, and bytes that belong to no tensor. It resolves
//! duplicate names silently and accepts null metadata, where other readers may differ. So those are refused here.
//!
//! Source: <https://github.com/huggingface/safetensors#format>.

use std::collections::{BTreeMap, BTreeSet};
use std::fmt;

use safetensors::tensor::Metadata;
use serde::de::{Deserialize, Deserializer, Error as _, IgnoredAny, MapAccess, Visitor};

use crate::error::Result;

/// Bytes of the header's length.
const LENGTH: usize = 8;
/// Size of the longest header, by the format.
const HEADER_LIMIT: u64 = 100_000_000;
/// The one entry of the header that is not a tensor.
const METADATA: &str = "__metadata__";

/// Returns the first bytes of a file, at most as many as requested, and its size.
type Start<'a> = &'a dyn Fn(u64) -> Result<(Vec<u8>, u64)>;

/// Checks the file `path` of a checkpoint if it is a safetensors file. No more than the header is read. The inner error
/// describes what is wrong with it.
pub(crate) fn check(path: &str, start: Start) -> Result<std::result::Result<(), String>> {
    let checked = if path.ends_with(".safetensors") { check_start(start)? } else { Ok(()) };
    Ok(checked.map_err(|reason| format!("is not a safetensors file that all programs read alike: {reason}")))
}

fn check_start(start: Start) -> Result<std::result::Result<(), String>> {
    let (length, size) = start(LENGTH as u64)?;
    let Ok(length) = <[u8; LENGTH]>::try_from(length.as_slice()) else {
        return Ok(Err(format!("it has {size} bytes, too few for the length of a header")));
    };
    let length = u64::from_le_bytes(length);
    // Before memory is allocated for it.
    if length > HEADER_LIMIT {
        return Ok(Err(format!("its header claims {length} bytes, more than the format's {HEADER_LIMIT}")));
    }
    let rest = size.saturating_sub(LENGTH as u64);
    let Some(data) = rest.checked_sub(length) else {
        return Ok(Err(format!("its header claims {length} bytes, and only {rest} follow")));
    };
    let (header, _) = start(LENGTH as u64 + length)?;
    Ok(check_header(header.get(LENGTH..).unwrap_or_default(), data))
}

/// Checks a header that is followed by `data` bytes.
fn check_header(header: &[u8], data: u64) -> std::result::Result<(), String> {
    // The JSON reader does not check the encoding of texts that it skips.
    let header = std::str::from_utf8(header).map_err(|error| format!("its header is not UTF-8: {error}"))?;
    if !header.starts_with('{') {
        return Err("its header does not start with `{`".into());
    }
    let malformed = |error: serde_json::Error| format!("its header is malformed: {error}");
    let UniqueNames = serde_json::from_str(header).map_err(malformed)?;
    let metadata: Metadata = serde_json::from_str(header).map_err(malformed)?;
    let end = metadata.data_len() as u64;
    if end == data {
        Ok(())
    } else {
        Err(format!("its tensors have {end} bytes, and {data} follow the header"))
    }
}

/// An object whose keys differ. A map would keep the last of two entries.
struct UniqueNames;

impl<'de> Deserialize<'de> for UniqueNames {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> std::result::Result<Self, D::Error> {
        deserializer.deserialize_map(Self)
    }
}

impl<'de> Visitor<'de> for UniqueNames {
    type Value = Self;

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("an object of tensors")
    }

    fn visit_map<A: MapAccess<'de>>(self, mut map: A) -> std::result::Result<Self, A::Error> {
        let mut names = BTreeSet::new();
        while let Some(name) = map.next_key::<String>()? {
            if name == METADATA {
                map.next_value::<BTreeMap<String, String>>()?;
            } else {
                map.next_value::<IgnoredAny>()?;
            }
            if let Some(twice) = names.replace(name) {
                return Err(A::Error::custom(format!("`{twice}` occurs twice")));
            }
        }
        Ok(self)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn start(file: &[u8], limit: u64) -> (Vec<u8>, u64) {
        (file.iter().copied().take(limit as usize).collect(), file.len() as u64)
    }

    /// Describes what is wrong with a file that has this header and `data` bytes.
    fn refusal(header: &str, data: usize) -> Option<String> {
        let mut file = (header.len() as u64).to_le_bytes().to_vec();
        file.extend_from_slice(header.as_bytes());
        file.resize(file.len() + data, 7);
        check_start(&|limit| Ok(start(&file, limit))).unwrap().err()
    }

    #[test]
    fn headers_by_the_format() {
        let cases = [
            ("{}", 0),
            ("{}   ", 0),
            (r#"{"__metadata__":{"format":"pt"}}"#, 0),
            (r#"{"a":{"dtype":"F32","shape":[2,3],"data_offsets":[0,24]}}"#, 24),
            (r#"{"scalar":{"dtype":"F64","shape":[],"data_offsets":[0,8]}}"#, 8),
            (r#"{"none":{"dtype":"F64","shape":[3,0],"data_offsets":[0,0]}}"#, 0),
            (r#"{"half":{"dtype":"F4","shape":[4],"data_offsets":[0,2]}}"#, 2),
            (
                r#"{"b":{"dtype":"U8","shape":[1],"data_offsets":[2,3]},"a":{"dtype":"BF16","shape":[1],"data_offsets":[0,2]},
                   "c":{"dtype":"I8","shape":[0],"data_offsets":[2,2]}}"#,
                3,
            ),
        ];
        for (header, data) in cases {
            assert_eq!(refusal(header, data), None, "{header}");
        }
    }

    #[test]
    fn malformed_headers_are_described() {
        let huge = format!(r#"{{"a":{{"dtype":"F32","shape":[{}],"data_offsets":[0,0]}}}}"#, u64::MAX);
        let deep = format!(r#"{{"a":{}"#, "[".repeat(100_000));
        let cases = [
            ("", 0, "does not start with `{`"),
            (" {}", 0, "does not start with `{`"),
            ("[]", 0, "does not start with `{`"),
            ("{", 0, "malformed"),
            ("{}{}", 0, "malformed"),
            (&deep, 0, "malformed"),
            (r#"{"a":{}}"#, 0, "missing field `dtype`"),
            (r#"{"a":{"dtype":"U8","shape":[-1],"data_offsets":[0,1]}}"#, 1, "malformed"),
            (r#"{"a":{"dtype":"U8","shape":[1.5],"data_offsets":[0,1]}}"#, 1, "malformed"),
            (r#"{"a":{"dtype":"U8","shape":[1],"data_offsets":[0,1,1]}}"#, 1, "malformed"),
            (r#"{"a":{"dtype":"U8","dtype":"U8","shape":[1],"data_offsets":[0,1]}}"#, 1, "duplicate field"),
            (r#"{"__metadata__":{"a":1}}"#, 0, "malformed"),
            (r#"{"__metadata__":null}"#, 0, "malformed"),
            (r#"{"__metadata__":{},"__metadata__":{}}"#, 0, "`__metadata__` occurs twice"),
            (
                r#"{"a":{"dtype":"U8","shape":[1],"data_offsets":[0,1]},"a":{"dtype":"U8","shape":[1],"data_offsets":[1,2]}}"#,
                2,
                "`a` occurs twice",
            ),
            (r#"{"a":{"dtype":"F33","shape":[1],"data_offsets":[0,4]}}"#, 4, "unknown variant `F33`"),
            (
                r#"{"a":{"dtype":"F32","shape":[2],"data_offsets":[0,4]}}"#,
                4,
                "invalid shape, data type, or offset",
            ),
            (r#"{"a":{"dtype":"F32","shape":[1],"data_offsets":[4,0]}}"#, 4, "invalid offset for tensor `a`"),
            (r#"{"a":{"dtype":"F4","shape":[1],"data_offsets":[0,1]}}"#, 1, "byte boundary"),
            (r#"{"a":{"dtype":"U8","shape":[1],"data_offsets":[1,2]}}"#, 2, "invalid offset for tensor `a`"),
            (
                r#"{"a":{"dtype":"U8","shape":[2],"data_offsets":[0,2]},"b":{"dtype":"U8","shape":[2],"data_offsets":[1,3]}}"#,
                3,
                "invalid offset for tensor `b`",
            ),
            (r#"{"a":{"dtype":"U8","shape":[2],"data_offsets":[0,2]}}"#, 1, "have 2 bytes, and 1 follow"),
            (r#"{"a":{"dtype":"U8","shape":[2],"data_offsets":[0,2]}}"#, 3, "have 2 bytes, and 3 follow"),
            (&huge, 0, "overflow"),
        ];
        for (header, data, expected) in cases {
            let found = refusal(header, data).unwrap_or_default();
            assert!(found.contains(expected), "{header:.200}: {found}");
        }
    }

    #[test]
    fn skipped_texts_are_checked_too() {
        let header = b"{\"a\":{\"dtype\":\"U8\",\"shape\":[0],\"data_offsets\":[0,0],\"\x89\":0}}";
        assert!(check_header(header, 0).unwrap_err().contains("not UTF-8"));
    }

    /// Reading more than the length would panic.
    #[test]
    fn nothing_is_read_if_the_length_is_wrong() {
        let length = |bytes: u64, size: u64| {
            let read = |limit| {
                assert_eq!(limit, 8);
                Ok((bytes.to_le_bytes().to_vec(), size))
            };
            check_start(&read).unwrap().unwrap_err()
        };
        assert!(length(u64::MAX, 8).contains("more than the format's 100000000"));
        assert!(length(HEADER_LIMIT + 1, 1 << 40).contains("more than the format's 100000000"));
        assert!(length(3, 10).contains("claims 3 bytes, and only 2 follow"));
        let short = check_start(&|limit| Ok(start(&[0; 7], limit))).unwrap().unwrap_err();
        assert!(short.contains("it has 7 bytes"), "{short}");
    }
}
