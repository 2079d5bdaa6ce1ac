//! The header of a safetensors file: what has to hold before any program reads the weights behind it.
//!
//! Eight bytes tell the length of a JSON object, which tells each tensor's type, shape and place among the bytes that follow.
//! Readers differ in what they make of one that is wrong, so none is published: sizes that overflow, tensors that overlap, bytes
//! that belong to no tensor, two tensors of one name.
//!
//! Source: <https://github.com/huggingface/safetensors#format>.

use std::collections::BTreeMap;
use std::fmt;
use std::fs::File;
use std::io::Read;
use std::path::Path;

use serde::Deserialize;
use serde::de::{Deserializer, Error as _, MapAccess, Visitor};

use crate::error::{Error, Result};

/// Bytes of the header's length.
const LENGTH: u64 = 8;
/// Bytes of the longest header, by the format.
const HEADER_LIMIT: u64 = 100_000_000;
/// The one entry of the header that is no tensor.
const METADATA: &str = "__metadata__";

/// Checks the file `source`, if `path`, its path in the checkpoint, is that of a safetensors file; the inner error says what is
/// wrong with it.
pub(crate) fn check_file(path: &str, source: &Path) -> Result<std::result::Result<(), String>> {
    if !path.ends_with(".safetensors") {
        return Ok(Ok(()));
    }
    let mut file = File::open(source).map_err(Error::io("read", source))?;
    let size = file.metadata().map_err(Error::io("read", source))?.len();
    let checked = check(&mut file, size).map_err(Error::io("read", source))?;
    Ok(checked.map_err(|reason| format!("is no safetensors file that all programs read alike: {reason}")))
}

/// Checks what `reader` gives, `size` bytes in all, of which no more than the header is read.
pub(crate) fn check(reader: &mut impl Read, size: u64) -> std::io::Result<std::result::Result<(), String>> {
    let Some(rest) = size.checked_sub(LENGTH) else {
        return Ok(Err(format!("it has {size} bytes, too few for the length of a header")));
    };
    let mut length = [0; LENGTH as usize];
    reader.read_exact(&mut length)?;
    let length = u64::from_le_bytes(length);
    // Before anything is allocated for it.
    if length > HEADER_LIMIT {
        return Ok(Err(format!(
            "its header claims {length} bytes, more than the {HEADER_LIMIT} of the format"
        )));
    }
    let Some(data) = rest.checked_sub(length) else {
        return Ok(Err(format!("its header claims {length} bytes, and only {rest} follow")));
    };
    let mut header = Vec::new();
    reader.take(length).read_to_end(&mut header)?;
    Ok(check_header(&header, data))
}

/// Checks a header that stands before `data` bytes.
fn check_header(header: &[u8], data: u64) -> std::result::Result<(), String> {
    // Texts that are skipped are not looked at by the JSON reader.
    let header = std::str::from_utf8(header).map_err(|error| format!("its header is not UTF-8: {error}"))?;
    if !header.starts_with('{') {
        return Err("its header does not begin with `{`".into());
    }
    let Header(tensors) =
        serde_json::from_str(header).map_err(|error| format!("its header is malformed: {error}"))?;
    let mut tensors: Vec<_> = tensors.iter().collect();
    // The header may name them in another order than that of their bytes.
    tensors.sort_by_key(|(_, tensor)| tensor.data_offsets);
    let mut end = 0;
    for (name, tensor) in tensors {
        let [first, last] = tensor.data_offsets;
        if first != end {
            return Err(format!(
                "tensor `{name}` begins at byte {first}, expected {end}: no holes and no overlaps"
            ));
        }
        let size = tensor.size().map_err(|reason| format!("tensor `{name}` {reason}"))?;
        if first.checked_add(size) != Some(last) {
            return Err(format!(
                "tensor `{name}` has bytes {first} to {last}, its shape and dtype make {size} bytes"
            ));
        }
        end = last;
    }
    if end != data {
        return Err(format!("its tensors have {end} bytes, and {data} follow the header"));
    }
    Ok(())
}

/// What a header says of one tensor.
#[derive(Debug, Deserialize)]
struct Tensor {
    dtype: String,
    shape: Vec<u64>,
    data_offsets: [u64; 2],
}

impl Tensor {
    /// Its bytes.
    fn size(&self) -> std::result::Result<u64, String> {
        let bits = bits(&self.dtype).ok_or_else(|| format!("has the unknown dtype `{}`", self.dtype))?;
        let sizes = self.shape.iter().copied();
        let total = sizes.chain([bits]).try_fold(1, u64::checked_mul);
        let total = total.ok_or_else(|| format!("has a shape too large to count: {:?}", self.shape))?;
        if total % 8 == 0 {
            Ok(total / 8)
        } else {
            Err(format!("has {total} bits, which are no whole bytes"))
        }
    }
}

/// Bits of an element of this type.
fn bits(dtype: &str) -> Option<u64> {
    Some(match dtype {
        "F4" => 4,
        "F6_E2M3" | "F6_E3M2" => 6,
        "BOOL" | "U8" | "I8" | "F8_E5M2" | "F8_E4M3" | "F8_E8M0" | "F8_E4M3FNUZ" | "F8_E5M2FNUZ" => 8,
        "U16" | "I16" | "F16" | "BF16" => 16,
        "U32" | "I32" | "F32" => 32,
        "U64" | "I64" | "F64" | "C64" => 64,
        _ => return None,
    })
}

/// The tensors by name.
struct Header(BTreeMap<String, Tensor>);

impl<'de> Deserialize<'de> for Header {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> std::result::Result<Self, D::Error> {
        deserializer.deserialize_map(HeaderVisitor)
    }
}

/// Of names that occur twice a map would keep the last only.
struct HeaderVisitor;

impl<'de> Visitor<'de> for HeaderVisitor {
    type Value = Header;

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("an object of tensors")
    }

    fn visit_map<A: MapAccess<'de>>(self, mut map: A) -> std::result::Result<Header, A::Error> {
        let mut tensors = BTreeMap::new();
        let mut has_metadata = false;
        while let Some(name) = map.next_key::<String>()? {
            let is_twice = if name == METADATA {
                map.next_value::<BTreeMap<String, String>>()?;
                std::mem::replace(&mut has_metadata, true)
            } else {
                tensors.insert(name.clone(), map.next_value()?).is_some()
            };
            if is_twice {
                return Err(A::Error::custom(format!("`{name}` stands there twice")));
            }
        }
        Ok(Header(tensors))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// What is wrong with a file of this header and as many bytes.
    fn refusal(header: &str, data: usize) -> Option<String> {
        let mut file = (header.len() as u64).to_le_bytes().to_vec();
        file.extend_from_slice(header.as_bytes());
        file.resize(file.len() + data, 7);
        check(&mut &file[..], file.len() as u64).unwrap().err()
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
    fn what_is_wrong_is_said() {
        let huge = format!(r#"{{"a":{{"dtype":"F32","shape":[{}],"data_offsets":[0,0]}}}}"#, u64::MAX);
        let deep = format!(r#"{{"a":{}"#, "[".repeat(100_000));
        let cases = [
            ("", 0, "does not begin with `{`"),
            (" {}", 0, "does not begin with `{`"),
            ("[]", 0, "does not begin with `{`"),
            ("{", 0, "malformed"),
            ("{}{}", 0, "malformed"),
            (&deep, 0, "malformed"),
            (r#"{"a":{}}"#, 0, "missing field `dtype`"),
            (r#"{"a":{"dtype":"U8","shape":[-1],"data_offsets":[0,1]}}"#, 1, "malformed"),
            (r#"{"a":{"dtype":"U8","shape":[1.5],"data_offsets":[0,1]}}"#, 1, "malformed"),
            (r#"{"a":{"dtype":"U8","shape":[1],"data_offsets":[0,1,1]}}"#, 1, "malformed"),
            (r#"{"a":{"dtype":"U8","dtype":"U8","shape":[1],"data_offsets":[0,1]}}"#, 1, "duplicate field"),
            (r#"{"__metadata__":{"a":1}}"#, 0, "malformed"),
            (r#"{"__metadata__":{},"__metadata__":{}}"#, 0, "`__metadata__` stands there twice"),
            (
                r#"{"a":{"dtype":"U8","shape":[1],"data_offsets":[0,1]},"a":{"dtype":"U8","shape":[1],"data_offsets":[1,2]}}"#,
                2,
                "`a` stands there twice",
            ),
            (
                r#"{"a":{"dtype":"F33","shape":[1],"data_offsets":[0,4]}}"#,
                4,
                "`a` has the unknown dtype `F33`",
            ),
            (r#"{"a":{"dtype":"F32","shape":[2],"data_offsets":[0,4]}}"#, 4, "its shape and dtype make 8"),
            (r#"{"a":{"dtype":"F32","shape":[1],"data_offsets":[4,0]}}"#, 4, "begins at byte 4, expected 0"),
            (r#"{"a":{"dtype":"F4","shape":[1],"data_offsets":[0,1]}}"#, 1, "4 bits"),
            (r#"{"a":{"dtype":"U8","shape":[1],"data_offsets":[1,2]}}"#, 2, "no holes"),
            (
                r#"{"a":{"dtype":"U8","shape":[2],"data_offsets":[0,2]},"b":{"dtype":"U8","shape":[2],"data_offsets":[1,3]}}"#,
                3,
                "`b` begins at byte 1, expected 2",
            ),
            (r#"{"a":{"dtype":"U8","shape":[2],"data_offsets":[0,2]}}"#, 1, "have 2 bytes, and 1 follow"),
            (r#"{"a":{"dtype":"U8","shape":[2],"data_offsets":[0,2]}}"#, 3, "have 2 bytes, and 3 follow"),
            (&huge, 0, "too large to count"),
        ];
        for (header, data, expected) in cases {
            let found = refusal(header, data).unwrap_or_default();
            assert!(found.contains(expected), "{header:.200}: {found}");
        }
    }

    #[test]
    fn what_is_skipped_is_text_as_well() {
        let header = b"{\"a\":{\"dtype\":\"U8\",\"shape\":[0],\"data_offsets\":[0,0],\"\x89\":0}}";
        assert!(check_header(header, 0).unwrap_err().contains("not UTF-8"));
    }

    /// The reader would fail if it were asked for more than the length.
    #[test]
    fn nothing_is_read_by_a_length_that_lies() {
        let length = |bytes: u64, size: u64| check(&mut &bytes.to_le_bytes()[..], size).unwrap().unwrap_err();
        assert!(length(u64::MAX, 8).contains("more than the 100000000 of the format"));
        assert!(length(HEADER_LIMIT + 1, 1 << 40).contains("more than the 100000000"));
        assert!(length(3, 10).contains("claims 3 bytes, and only 2 follow"));
        assert!(check(&mut &[0; 7][..], 7).unwrap().unwrap_err().contains("it has 7 bytes"));
    }
}
