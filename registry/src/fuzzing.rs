//! What has to hold of whatever a parser is given: the targets in `fuzz/`, which are run on their corpora by `cargo test` as well.
//!
//! Each function panics where something does not hold, and says whether its parser took the bytes.
#![allow(clippy::missing_panics_doc, reason = "said above")]

use std::collections::BTreeMap;
use std::path::{Component, Path};

use crate::log::{Entry, Log, encode};
use crate::manifest::Manifest;
use crate::reference::ModelRef;
use crate::signature::{PublicKey, Signature, SignedFiles, Statement};

/// A reference that is written means the same.
pub fn reference(data: &[u8]) -> bool {
    let Ok(text) = std::str::from_utf8(data) else { return false };
    let Ok(parsed) = text.parse::<ModelRef>() else { return false };
    assert_eq!(parsed.to_string(), text, "one spelling for each reference");
    assert_eq!(text.parse().ok(), Some(parsed));
    true
}

/// A manifest that is written says the same, and its files lie inside the folder that they are delivered to.
pub fn manifest(data: &[u8]) -> bool {
    let Ok(parsed) = Manifest::parse_foreign(data) else { return false };
    for layer in &parsed.layers {
        let path = Path::new(layer.path().unwrap_or_default());
        assert!(path.components().all(|part| matches!(part, Component::Normal(_))), "{}", path.display());
        assert!(path.components().next().is_some());
    }
    let bytes = parsed.to_bytes().unwrap_or_default();
    let again = Manifest::parse_foreign(&bytes);
    assert_eq!(again.as_ref(), Ok(&parsed));
    assert_eq!(
        again.ok().and_then(|again| again.to_bytes().ok()),
        Some(bytes),
        "one spelling for each manifest"
    );
    true
}

/// An entry of a log that is written says the same.
pub fn entry(data: &[u8]) -> bool {
    let Ok(Entry { subject, number, attached, .. }) = serde_json::from_slice(data) else { return false };
    let log = Log { subject, folder: String::new(), attaches: attached.is_some() };
    let Ok(parsed) = log.parse(data, number) else { return false };
    // Only a number or a remark that is too large cannot be written.
    let Ok(bytes) = encode(&parsed) else { return false };
    assert_eq!(log.parse(&bytes, number), Ok(parsed));
    true
}

/// The header of a safetensors file.
pub fn safetensors(data: &[u8]) -> bool {
    matches!(crate::safetensors::check(&mut &data[..], data.len() as u64), Ok(Ok(())))
}

/// The public key of RFC 6979, appendix A.2.5.
const KEY: &str = "-----BEGIN PUBLIC KEY-----
MFkwEwYHKoZIzj0CAQYIKoZIzj0DAQcDQgAEYP7UuiVanTHJYet0xjVtaMBJuJI7
Yfps5mliLmDyn7Z5A/4QCLi8maQa6elWKLxk8vGyDC1+n1F3o8KU1EYimQ==
-----END PUBLIC KEY-----
";

/// The content of a `model.sig` that nobody signed is refused; a statement says what was signed, or what is wrong with it.
pub fn signature(data: &[u8]) -> bool {
    if let (Ok(key), Ok(signature)) = (PublicKey::from_pem(KEY), Signature::parse(data)) {
        assert_eq!(signature.as_str().as_bytes(), data);
        let files = SignedFiles { name: "approach".into(), files: BTreeMap::new() };
        assert!(files.verify(&signature, &key).is_err());
    }
    serde_json::from_slice::<Statement>(data).is_ok_and(|statement| statement.files().is_ok())
}

#[cfg(test)]
mod tests {
    use std::fs;

    type Target = fn(&[u8]) -> bool;

    /// The corpora as they are kept, and what is near each of their inputs: cut off anywhere, and with each bit of some bytes
    /// flipped.
    #[test]
    fn the_corpora_hold() {
        let targets: [(&str, Target); 5] = [
            ("reference", super::reference),
            ("manifest", super::manifest),
            ("entry", super::entry),
            ("safetensors", super::safetensors),
            ("signature", super::signature),
        ];
        for (name, target) in targets {
            let folder = format!("{}/../fuzz/corpus/{name}", env!("CARGO_MANIFEST_DIR"));
            let inputs: Vec<_> =
                fs::read_dir(folder).unwrap().map(|entry| fs::read(entry.unwrap().path()).unwrap()).collect();
            let taken = inputs.iter().filter(|input| target(input)).count();
            assert!(0 < taken && taken < inputs.len(), "{name}: {taken} of {} parse", inputs.len());
            for input in inputs {
                for position in (0..input.len()).step_by(7) {
                    target(&input[..position]);
                    let mut flipped = input.clone();
                    flipped[position] ^= 1 << (position % 8);
                    target(&flipped);
                }
            }
        }
    }
}
