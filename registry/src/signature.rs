//! Signatures of models, in the form of OpenSSF Model Signing (OMS): a Sigstore bundle with a DSSE envelope, in which
//! an in-toto statement lists the digest of every file. Offline, with an ECDSA key on the curve NIST P-256.
//!
//! Sources: <https://github.com/sigstore/model-transparency> (the statement), <https://github.com/secure-systems-lab/dsse>
//! (protocol 1.0.0), <https://github.com/in-toto/attestation> (Statement v1). Checked against the Python package
//! `model-signing` by `tests/python/models.sh`.

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

use base64::Engine as _;
use base64::engine::general_purpose::STANDARD as BASE64;
use p256::ecdsa::signature::{Signer as _, Verifier as _};
use p256::pkcs8::{DecodePrivateKey as _, DecodePublicKey as _, EncodePublicKey as _, LineEnding};
use p256::{SecretKey, ecdsa};
use serde::Deserialize;
use serde_json::json;

use crate::attachment::{Attachment, SIGNATURE, of_kind};
use crate::checkpoint;
use crate::digest::{Digest, Hasher};
use crate::error::{Error, Result};
use crate::log::Entry;
use crate::registry::{ModelVersion, Registry};

const PAYLOAD: &str = "application/vnd.in-toto+json";
const STATEMENT: &str = "https://in-toto.io/Statement/v1";
const PREDICATE: &str = "https://model_signing/signature/v1.0";

/// Characters of a hint on a key that are told: SHA-256 in hexadecimal digits.
const HINT_LENGTH: usize = 64;

/// What lies in a model's folder and is no part of it: the signature, and what belongs to Git.
const IGNORED: [&str; 5] = ["model.sig", ".git", ".gitattributes", ".github", ".gitignore"];

/// What is signed: a model's name, its files and their digests.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct SignedFiles {
    /// The model's name.
    pub name: String,
    /// Path in the model, with parts separated by `/`, and digest.
    pub files: BTreeMap<String, Digest>,
}

impl SignedFiles {
    /// The files in a folder, but for `model.sig` and what belongs to Git.
    pub fn in_folder(folder: &Path) -> Result<Self> {
        let whole = folder.canonicalize().map_err(Error::io("read the folder", folder))?;
        let name = whole.file_name().unwrap_or_default().to_string_lossy().into_owned();
        let mut files = BTreeMap::new();
        for (path, source) in checkpoint::list_except(folder, &IGNORED)? {
            files.insert(path, checkpoint::fingerprint(&source)?.digest);
        }
        Ok(Self { name, files })
    }

    /// The files of a version, as its manifest names them.
    pub fn of_version(version: &ModelVersion) -> Self {
        let layers = version.manifest.layers.iter();
        let files = layers.map(|layer| (layer.path().unwrap_or_default().to_owned(), layer.digest)).collect();
        Self { name: version.name.to_string(), files }
    }

    /// SHA-256 over the digests in the order of the paths.
    fn root(&self) -> Digest {
        root(self.files.values())
    }

    fn statement(&self) -> String {
        let resource = |(name, digest): (&String, &Digest)| json!({ "name": name, "algorithm": "sha256", "digest": digest.hex() });
        let resources: Vec<_> = self.files.iter().map(resource).collect();
        let serialization = json!({
            "method": "files", "hash_type": "sha256", "allow_symlinks": false, "ignore_paths": IGNORED,
        });
        json!({
            "_type": STATEMENT,
            "subject": [{ "name": self.name, "digest": { "sha256": self.root().hex() } }],
            "predicateType": PREDICATE,
            "predicate": { "serialization": serialization, "resources": resources },
        })
        .to_string()
    }

    /// Signs them. The same key and files give the same bytes.
    pub fn sign(&self, key: &PrivateKey) -> Result<Signature> {
        let statement = self.statement();
        let signature: ecdsa::DerSignature = key.0.sign(&pre_authentication(PAYLOAD, statement.as_bytes()));
        let hint = PublicKey(*key.0.verifying_key()).hint()?;
        let bundle = json!({
            "mediaType": SIGNATURE,
            "verificationMaterial": { "publicKey": { "hint": hint }, "tlogEntries": [] },
            "dsseEnvelope": {
                "payload": BASE64.encode(&statement),
                "payloadType": PAYLOAD,
                "signatures": [{ "sig": BASE64.encode(signature.as_bytes()), "keyid": "" }],
            },
        });
        Signature::parse(format!("{bundle}\n").as_bytes())
    }

    /// Checks that `signature` was made with the key that belongs to `key`, over exactly these files. The name may be another.
    pub fn verify(&self, signature: &Signature, key: &PublicKey) -> Result<()> {
        let refuse = |reason| Error::Signature { reason };
        let signed = signature.bundle.open(key).and_then(|statement| statement.files()).map_err(refuse)?;
        self.compare(&signed)
    }

    /// Checks that `signature` is over exactly these files, whoever made it.
    pub(crate) fn are_named_by(&self, signature: &Signature) -> Result<()> {
        let refuse = |reason| Error::Signature { reason };
        let payload = signature.bundle.payload().map_err(refuse)?;
        self.compare(&Statement::parse(&payload).and_then(|statement| statement.files()).map_err(refuse)?)
    }

    fn compare(&self, signed: &BTreeMap<String, Digest>) -> Result<()> {
        match difference(signed, &self.files) {
            None => Ok(()),
            Some(difference) => {
                Err(Error::Signature { reason: format!("other files were signed: {difference}") })
            }
        }
    }
}

/// A signature of a model, the content of a `model.sig`: read, but believed by nobody before it is verified.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Signature {
    text: String,
    bundle: Bundle,
}

impl Signature {
    /// Reads a Sigstore bundle.
    pub fn parse(bytes: &[u8]) -> Result<Self> {
        let refuse = |error: &dyn std::fmt::Display| Error::Signature {
            reason: format!("it is no Sigstore bundle with a DSSE envelope: {error}"),
        };
        // Names and texts that are skipped are not looked at by the JSON reader.
        let text = std::str::from_utf8(bytes).map_err(|error| refuse(&error))?;
        let bundle = serde_json::from_str(text).map_err(|error| refuse(&error))?;
        Ok(Self { text: text.to_owned(), bundle })
    }

    /// The bundle, byte for byte.
    pub fn as_str(&self) -> &str {
        &self.text
    }

    /// By which it says what key it is for, usually the SHA-256 of the public key's PEM. Anybody can write anything there: what
    /// would steer a terminal is left out.
    pub fn key_hint(&self) -> Option<String> {
        let key = self.bundle.verification_material.public_key.as_ref();
        key.map(|key| key.hint.chars().filter(|c| !c.is_control()).take(HINT_LENGTH).collect())
    }
}

impl Registry {
    /// The entry that attaches a signature of `version` by the owner of `key`; [`Error::Unsigned`] if there is none that holds.
    pub fn signature_by(&self, version: &ModelVersion, key: &PublicKey) -> Result<Entry> {
        let files = SignedFiles::of_version(version);
        let hint = key.hint()?;
        let mut found = Vec::new();
        for entry in of_kind(&self.attachments(version)?, SIGNATURE) {
            // What is wrong with one signature does not count against another.
            let number = entry.number;
            found.push(match self.attachment(version, entry) {
                Ok(Some(Attachment::Signature(signature))) => match files.verify(&signature, key) {
                    Ok(()) => return Ok(entry.clone()),
                    Err(error) => match signature.key_hint().filter(|other| *other != hint) {
                        Some(other) => format!("attachment {number} is by {other}"),
                        None => format!("attachment {number}: {error}"),
                    },
                },
                Ok(_) => continue,
                Err(error) => format!("attachment {number}: {error}"),
            });
        }
        let reason = match found.len() {
            0 => "no signature is attached; `model sign` attaches one".to_owned(),
            count => format!("of {count} signatures none is by {hint}; {}", found.join("; ")),
        };
        Err(Error::Unsigned { model: version.to_string(), reason })
    }
}

/// The first difference between the files that were signed and those that are there.
fn difference(signed: &BTreeMap<String, Digest>, found: &BTreeMap<String, Digest>) -> Option<String> {
    let paths: BTreeSet<_> = signed.keys().chain(found.keys()).collect();
    paths.into_iter().find_map(|path| match (signed.get(path), found.get(path)) {
        (Some(signed), Some(found)) if signed == found => None,
        (Some(signed), Some(found)) => Some(format!("{path} has digest {found}, signed was {signed}")),
        (Some(_), None) => Some(format!("{path} was signed and is missing")),
        (None, _) => Some(format!("{path} was not signed")),
    })
}

fn root<'a>(digests: impl Iterator<Item = &'a Digest>) -> Digest {
    let mut hasher = Hasher::default();
    digests.for_each(|digest| hasher.update(digest.bytes()));
    hasher.finish().digest
}

/// What a DSSE signature is over.
fn pre_authentication(kind: &str, payload: &[u8]) -> Vec<u8> {
    let mut bytes = format!("DSSEv1 {} {kind} {} ", kind.len(), payload.len()).into_bytes();
    bytes.extend_from_slice(payload);
    bytes
}

/// Signs models.
pub struct PrivateKey(ecdsa::SigningKey);

impl PrivateKey {
    /// From a PEM file with `EC PRIVATE KEY` (SEC 1) or `PRIVATE KEY` (PKCS #8), not encrypted, of the curve NIST P-256.
    pub fn from_pem(pem: &str) -> Result<Self> {
        let key = SecretKey::from_sec1_pem(pem).ok().or_else(|| SecretKey::from_pkcs8_pem(pem).ok());
        let reason = "is no private key of the curve NIST P-256 in PEM without a password; `openssl ecparam -name prime256v1 \
                      -genkey -noout` makes one";
        key.map(|key| Self(key.into())).ok_or_else(|| Error::Key { reason: reason.to_owned() })
    }

    /// The key that verifies what this one signs, as PEM.
    pub fn public_pem(&self) -> Result<String> {
        PublicKey(*self.0.verifying_key()).pem()
    }
}

/// Verifies signatures of models.
#[derive(Debug, Clone, PartialEq)]
pub struct PublicKey(ecdsa::VerifyingKey);

impl PublicKey {
    /// From a PEM file with `PUBLIC KEY` of the curve NIST P-256.
    pub fn from_pem(pem: &str) -> Result<Self> {
        let reason = "is no public key of the curve NIST P-256 in PEM; `openssl ec -in KEY -pubout` makes it from the private key";
        ecdsa::VerifyingKey::from_public_key_pem(pem)
            .map(Self)
            .map_err(|_| Error::Key { reason: reason.to_owned() })
    }

    fn pem(&self) -> Result<String> {
        let pem = self.0.to_public_key_pem(LineEnding::LF);
        pem.map_err(|error| Error::Key { reason: format!("cannot be written: {error}") })
    }

    /// By which a bundle says which key it is for: SHA-256 of the key's PEM.
    fn hint(&self) -> Result<String> {
        Ok(Digest::of(self.pem()?.as_bytes()).hex())
    }
}

/// A Sigstore bundle, as far as it matters here.
#[derive(Debug, Clone, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "camelCase")]
struct Bundle {
    media_type: String,
    #[serde(default)]
    verification_material: Material,
    dsse_envelope: Envelope,
}

#[derive(Debug, Clone, Default, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "camelCase")]
struct Material {
    public_key: Option<KeyHint>,
}

#[derive(Debug, Clone, PartialEq, Eq, Deserialize)]
struct KeyHint {
    hint: String,
}

#[derive(Debug, Clone, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "camelCase")]
struct Envelope {
    payload: String,
    payload_type: String,
    signatures: Vec<EnvelopeSignature>,
}

#[derive(Debug, Clone, PartialEq, Eq, Deserialize)]
struct EnvelopeSignature {
    sig: String,
}

impl Bundle {
    /// What is signed.
    fn payload(&self) -> std::result::Result<Vec<u8>, String> {
        expect("mediaType", &self.media_type, SIGNATURE)?;
        let Envelope { payload, payload_type, .. } = &self.dsse_envelope;
        expect("payloadType", payload_type, PAYLOAD)?;
        BASE64.decode(payload).map_err(|error| format!("its payload is not base64: {error}"))
    }

    /// The statement, if one of the signatures is of this key.
    fn open(&self, key: &PublicKey) -> std::result::Result<Statement, String> {
        let payload = self.payload()?;
        let signed = pre_authentication(PAYLOAD, &payload);
        let holds = |signature: &EnvelopeSignature| {
            let der = BASE64.decode(&signature.sig).ok()?;
            let signature = ecdsa::Signature::from_der(&der).ok()?;
            key.0.verify(&signed, &signature).ok()
        };
        if !self.dsse_envelope.signatures.iter().any(|signature| holds(signature).is_some()) {
            return Err(
                "it was not made with the key that belongs to this public key, or was changed since".into()
            );
        }
        // Only now is it worth reading.
        Statement::parse(&payload)
    }
}

/// An in-toto statement with the predicate of model signing.
#[derive(Deserialize)]
#[serde(rename_all = "camelCase")]
pub(crate) struct Statement {
    #[serde(rename = "_type")]
    kind: String,
    subject: Vec<Subject>,
    predicate_type: String,
    predicate: Predicate,
}

#[derive(Deserialize)]
struct Subject {
    digest: BTreeMap<String, String>,
}

#[derive(Deserialize)]
struct Predicate {
    serialization: Serialization,
    resources: Vec<Resource>,
}

#[derive(Deserialize)]
struct Serialization {
    method: String,
}

#[derive(Deserialize)]
struct Resource {
    name: String,
    algorithm: String,
    digest: String,
}

impl Statement {
    fn parse(payload: &[u8]) -> std::result::Result<Self, String> {
        serde_json::from_slice(payload)
            .map_err(|error| format!("what was signed is no statement on a model: {error}"))
    }

    /// The files that were signed.
    pub(crate) fn files(&self) -> std::result::Result<BTreeMap<String, Digest>, String> {
        expect("_type", &self.kind, STATEMENT)?;
        expect("predicateType", &self.predicate_type, PREDICATE)?;
        expect("serialization.method", &self.predicate.serialization.method, "files")?;
        let mut digests = Vec::new();
        let mut files = BTreeMap::new();
        for Resource { name, algorithm, digest } in &self.predicate.resources {
            expect("algorithm", algorithm, "sha256")?;
            let digest: Digest =
                format!("sha256:{digest}").parse().map_err(|error: Error| error.to_string())?;
            digests.push(digest);
            if files.insert(name.clone(), digest).is_some() {
                return Err(format!("it names {name} twice"));
            }
        }
        let [subject] = self.subject.as_slice() else {
            return Err(format!("it is of {} subjects, expected one", self.subject.len()));
        };
        let stated = subject.digest.get("sha256").map_or("", String::as_str);
        expect("the subject's digest", stated, &root(digests.iter()).hex())?;
        Ok(files)
    }
}

fn expect(what: &str, found: &str, expected: &str) -> std::result::Result<(), String> {
    if found == expected { Ok(()) } else { Err(format!("{what} is `{found}`, expected `{expected}`")) }
}

#[cfg(test)]
mod tests {
    use std::fs;

    use serde_json::Value;

    use super::*;
    use crate::fixture::{self, Place};
    use crate::log::Remark;

    fn bytes(hex: &str) -> Vec<u8> {
        (0..hex.len()).step_by(2).map(|i| u8::from_str_radix(&hex[i..i + 2], 16).unwrap()).collect()
    }

    /// The example key of RFC 6979, appendix A.2.5.
    fn key() -> PrivateKey {
        let scalar = bytes("C9AFA9D845BA75166B5C215767B1D6934E50C3DB36E89B127B8A622B120F6721");
        PrivateKey(ecdsa::SigningKey::from_slice(&scalar).unwrap())
    }

    fn public() -> PublicKey {
        PublicKey::from_pem(&key().public_pem().unwrap()).unwrap()
    }

    fn signed(place: &Place) -> (SignedFiles, Signature) {
        let files = SignedFiles::in_folder(&place.checkpoint("approach", b"abc")).unwrap();
        let signature = files.sign(&key()).unwrap();
        (files, signature)
    }

    /// The example of the DSSE protocol, section "PAE".
    #[test]
    fn the_published_example_of_dsse() {
        let encoded = pre_authentication("http://example.com/HelloWorld", b"hello world");
        assert_eq!(encoded, b"DSSEv1 29 http://example.com/HelloWorld 11 hello world");
    }

    /// RFC 6979, appendix A.2.5: P-256 with SHA-256 over "sample".
    #[test]
    fn the_published_signature_of_rfc_6979() {
        let signature: ecdsa::Signature = key().0.sign(b"sample");
        let r = bytes("EFD48B2AACB6A8FD1140DD9CD45E81D69D2C877B56AAF991C34D0EA84EAF3716");
        assert_eq!(signature.to_bytes()[..32], r);
    }

    /// The form of the bundle, on the raw JSON.
    #[test]
    fn has_the_shape_of_oms() {
        let place = Place::local();
        let bundle: Value = serde_json::from_str(signed(&place).1.as_str()).unwrap();
        assert_eq!(bundle["mediaType"], "application/vnd.dev.sigstore.bundle.v0.3+json");
        let payload = BASE64.decode(bundle["dsseEnvelope"]["payload"].as_str().unwrap()).unwrap();
        let statement: Value = serde_json::from_slice(&payload).unwrap();
        assert_eq!(statement["_type"], "https://in-toto.io/Statement/v1");
        assert_eq!(statement["predicateType"], "https://model_signing/signature/v1.0");
        assert_eq!(statement["subject"][0]["name"], "approach");
        let resources = statement["predicate"]["resources"].as_array().unwrap();
        assert_eq!(resources.len(), 3);
        assert_eq!(resources[2]["name"], "weights.bin");
        assert!(resources[2]["digest"].as_str().unwrap().starts_with("ba7816bf"), "FIPS 180-2 of abc");
    }

    #[test]
    fn holds_for_the_folder_and_for_the_version_and_for_nothing_else() {
        let place = Place::local();
        let (files, signature) = signed(&place);
        let verify = |files: &SignedFiles| files.verify(&signature, &public());
        verify(&files).unwrap();
        let version = place.publish(&place.registry(), "other", b"abc");
        verify(&SignedFiles::of_version(&version)).unwrap();

        let folder = place.path("approach");
        let again = || SignedFiles::in_folder(&folder).unwrap();
        fs::write(folder.join("model.sig"), signature.as_str()).unwrap();
        fs::create_dir(folder.join(".git")).unwrap();
        fs::write(folder.join(".git/a b"), "").unwrap();
        verify(&again()).unwrap();
        fs::write(folder.join("more.txt"), "").unwrap();
        assert!(verify(&again()).unwrap_err().to_string().contains("more.txt was not signed"));
        fs::remove_file(folder.join("more.txt")).unwrap();
        fs::write(folder.join("weights.bin"), "abd").unwrap();
        assert!(verify(&again()).unwrap_err().to_string().contains("weights.bin has digest"));
        fs::remove_file(folder.join("weights.bin")).unwrap();
        assert!(verify(&again()).unwrap_err().to_string().contains("is missing"));
    }

    #[test]
    fn every_changed_byte_of_what_was_signed_is_found() {
        let place = Place::local();
        let (files, signature) = signed(&place);
        let mut bundle: Value = serde_json::from_str(signature.as_str()).unwrap();
        let payload = BASE64.decode(bundle["dsseEnvelope"]["payload"].as_str().unwrap()).unwrap();
        for position in (0..payload.len()).step_by(7) {
            let mut changed = payload.clone();
            changed[position] ^= 1;
            bundle["dsseEnvelope"]["payload"] = BASE64.encode(changed).into();
            let changed = Signature::parse(bundle.to_string().as_bytes()).unwrap();
            let refusal = files.verify(&changed, &public()).unwrap_err().to_string();
            assert!(refusal.contains("was not made with the key"), "{refusal}");
        }
        let other = PrivateKey(ecdsa::SigningKey::from_slice(&[7; 32]).unwrap());
        let other = PublicKey::from_pem(&other.public_pem().unwrap()).unwrap();
        assert!(files.verify(&signature, &other).is_err());
        assert!(Signature::parse(b"{}").unwrap_err().to_string().contains("no Sigstore bundle"));
    }

    /// It would be attached as something else than what was signed elsewhere.
    #[test]
    fn what_is_no_text_is_no_signature() {
        let place = Place::local();
        let (_, signature) = signed(&place);
        let text = signature.as_str().replacen('{', "{\"?\":0,", 1);
        Signature::parse(text.as_bytes()).unwrap();
        let bytes: Vec<_> = text.bytes().map(|c| if c == b'?' { 0x89 } else { c }).collect();
        assert!(Signature::parse(&bytes).unwrap_err().to_string().contains("utf-8"));
    }

    #[test]
    fn keys_of_other_kinds_are_refused() {
        for text in ["", "-----BEGIN PRIVATE KEY-----\nAAAA\n-----END PRIVATE KEY-----\n"] {
            let refusal = PrivateKey::from_pem(text).err().unwrap().to_string();
            assert!(refusal.contains("P-256"), "{refusal}");
            assert!(PublicKey::from_pem(text).unwrap_err().to_string().contains("-pubout"));
        }
    }

    /// One signature that holds is enough, whatever else is attached.
    #[test]
    fn a_version_is_signed_by_whose_signature_is_attached() {
        for place in Place::all() {
            let registry = place.registry();
            let version = place.publish(&registry, "approach", b"abc");
            let (ours, theirs) = (fixture::key(1), fixture::key(2));
            let public = |key: &PrivateKey| PublicKey::from_pem(&key.public_pem().unwrap()).unwrap();
            let reference = "approach@1".parse().unwrap();
            let pull = |key| registry.pull_signed(&reference, &place.path("pulled"), &public(key));
            let none = pull(&ours).unwrap_err().to_string();
            assert!(none.contains("no signature is attached"), "{none}");

            let attach = |key: &PrivateKey| {
                let signature = SignedFiles::of_version(&version).sign(key).unwrap();
                registry.attach(&version, &Attachment::Signature(signature), &Remark::default()).unwrap()
            };
            attach(&theirs);
            let other = pull(&ours).unwrap_err().to_string();
            let (own, hint) = (public(&ours).hint().unwrap(), public(&theirs).hint().unwrap());
            assert!(
                other.contains(&format!("of 1 signatures none is by {own}; attachment 1 is by {hint}")),
                "{other}"
            );
            assert!(!place.path("pulled").exists(), "refused before a byte is delivered");
            attach(&ours);
            assert_eq!(registry.signature_by(&version, &public(&ours)).unwrap().number, 2);
            assert!(
                matches!(attach(&ours), crate::Attached::AlreadyThere(_)),
                "signed twice, the same bytes"
            );
            pull(&ours).unwrap();
            assert_eq!(fs::read(place.path("pulled/weights.bin")).unwrap(), b"abc");
            pull(&theirs).unwrap();
            assert!(pull(&fixture::key(3)).is_err());
        }
    }

    /// Who can write into the registry can attach anything, but sign nothing.
    #[test]
    fn what_only_looks_signed_is_told() {
        let place = Place::local();
        let registry = place.registry();
        let version = place.publish(&registry, "approach", b"abc");
        let signature = SignedFiles::of_version(&version).sign(&key()).unwrap();
        // Of the right files and with the right hint, but by another key.
        let forged = SignedFiles::of_version(&version).sign(&fixture::key(1)).unwrap();
        let mut bundle: Value = serde_json::from_str(forged.as_str()).unwrap();
        bundle["verificationMaterial"]["publicKey"]["hint"] = signature.key_hint().unwrap().into();
        let forged = Signature::parse(bundle.to_string().as_bytes()).unwrap();
        registry.attach(&version, &Attachment::Signature(forged), &Remark::default()).unwrap();
        let refusal = registry.signature_by(&version, &public()).unwrap_err().to_string();
        assert!(
            refusal.contains("attachment 1: ") && refusal.contains("was not made with the key"),
            "{refusal}"
        );
        // A damaged one in front does not hide the one that holds.
        let damaged = registry.attachments(&version).unwrap()[0].attached.clone().unwrap();
        crate::fixture::flip(&place.path("registry"), &crate::store::blob_key(damaged.digest));
        assert!(registry.signature_by(&version, &public()).is_err());
        registry.attach(&version, &Attachment::Signature(signature), &Remark::default()).unwrap();
        assert_eq!(registry.signature_by(&version, &public()).unwrap().number, 2);
    }

    #[test]
    fn a_hint_does_not_steer_the_terminal() {
        let place = Place::local();
        let mut bundle: Value = serde_json::from_str(signed(&place).1.as_str()).unwrap();
        bundle["verificationMaterial"]["publicKey"]["hint"] = format!("\u{1b}[2J{}", "x".repeat(99)).into();
        let hint = Signature::parse(bundle.to_string().as_bytes()).unwrap().key_hint().unwrap();
        assert_eq!(hint, format!("[2J{}", "x".repeat(61)));
    }
}
