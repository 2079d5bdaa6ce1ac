//! Properties that must hold whatever a parser is given: the targets in `fuzz/`. `cargo test` runs them on their corpora.
//!
//! Each function panics if a property does not hold, and returns whether its parser accepted the bytes.
#![allow(clippy::missing_panics_doc, reason = "documented above")]

use std::collections::BTreeMap;
use std::path::{Component, Path};

use crate::events::Log;
use crate::model::{Event, Manifest, ModelRef, Selector};
use crate::signature::{PublicKey, Signature, SignedFiles, parse_statement};
use crate::store::sequence::encode;

/// A reference has one spelling, and reads back as the same.
pub fn reference(data: &[u8]) -> bool {
    let Ok(text) = std::str::from_utf8(data) else { return false };
    let Ok(parsed) = text.parse::<ModelRef>() else { return false };
    assert_eq!(parsed.to_string(), text, "one spelling for each reference");
    assert_eq!(text.parse().ok(), Some(parsed));
    true
}

/// A manifest reads back as the same, and its files stay inside the folder that they are delivered to.
pub fn manifest(data: &[u8]) -> bool {
    let Ok(parsed) = Manifest::parse(data) else { return false };
    for layer in &parsed.layers {
        let path = Path::new(layer.path().unwrap_or_default());
        assert!(path.components().all(|part| matches!(part, Component::Normal(_))), "{}", path.display());
        assert!(path.components().next().is_some());
    }
    let bytes = parsed.to_bytes().unwrap_or_default();
    let again = Manifest::parse(&bytes);
    assert_eq!(again.as_ref(), Ok(&parsed));
    let again = again.ok().and_then(|again| again.to_bytes().ok());
    assert_eq!(again, Some(bytes), "one spelling for each manifest");
    true
}

/// An event reads back as the same.
pub fn event(data: &[u8]) -> bool {
    let Ok(Event { subject, number, .. }) = serde_json::from_slice(data) else { return false };
    let Ok(reference) = subject.parse::<ModelRef>() else { return false };
    let log = match reference.selector {
        Selector::Alias(alias) => Log::of_alias(&reference.name, &alias),
        Selector::Version(version) => Log::of_number(&reference.name, version),
        _ => return false,
    };
    let Ok(parsed) = log.parse(data, number) else { return false };
    let Ok(bytes) = encode(&parsed.subject, &parsed) else { return false };
    assert_eq!(log.parse(&bytes, number), Ok(parsed));
    true
}

/// The header of a safetensors file.
pub fn safetensors(data: &[u8]) -> bool {
    let start = |limit: u64| {
        let start = data.iter().copied().take(usize::try_from(limit).unwrap_or(usize::MAX));
        Ok((start.collect(), data.len() as u64))
    };
    matches!(crate::model::safetensors::check(".safetensors", &start), Ok(Ok(())))
}

/// The public key of RFC 6979, appendix A.2.5.
const KEY: &str = "-----BEGIN PUBLIC KEY-----
MFkwEwYHKoZIzj0CAQYIKoZIzj0DAQcDQgAEYP7UuiVanTHJYet0xjVtaMBJuJI7
Yfps5mliLmDyn7Z5A/4QCLi8maQa6elWKLxk8vGyDC1+n1F3o8KU1EYimQ==
-----END PUBLIC KEY-----
";

/// A `model.sig` that nobody signed is refused, and a statement is parsed without a panic.
pub fn signature(data: &[u8]) -> bool {
    if let (Ok(key), Ok(signature)) = (PublicKey::from_pem(KEY), Signature::parse(data)) {
        assert_eq!(signature.as_str().as_bytes(), data);
        let files = SignedFiles { name: "approach".into(), files: BTreeMap::new() };
        assert!(files.verify(&signature, &key).is_err());
    }
    parse_statement(data).is_ok()
}

#[cfg(test)]
mod tests {
    use std::fs;

    type Target = fn(&[u8]) -> bool;

    /// The corpora, and variants of each of their inputs: truncated, and with a bit of every seventh byte flipped.
    #[test]
    fn the_corpora_hold() {
        let targets: [(&str, Target); 5] = [
            ("reference", super::reference),
            ("manifest", super::manifest),
            ("event", super::event),
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
