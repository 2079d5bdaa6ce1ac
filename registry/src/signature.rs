//! Signatures of models in the format of OpenSSF Model Signing (OMS): a Sigstore bundle with a DSSE envelope, in which an in-toto
//! statement lists the digest of every file. Signing works offline, with an ECDSA key on the curve NIST P-256.
//!
//! Sources: <https://github.com/sigstore/model-transparency> (the statement), <https://github.com/secure-systems-lab/dsse>
//! (protocol 1.0.0), <https://github.com/in-toto/attestation> (Statement v1). `tests/python/models.sh` exchanges signatures with
//! the Python package `model-signing`.

use std::collections::{BTreeMap, BTreeSet};
use std::fmt::Display;
use std::path::Path;

use base64::Engine as _;
use base64::engine::general_purpose::STANDARD as BASE64;
use p256::ecdsa::signature::{Signer as _, Verifier as _};
use p256::pkcs8::{DecodePrivateKey as _, DecodePublicKey as _, EncodePublicKey as _, LineEnding};
use p256::{SecretKey, ecdsa};
use serde_json::{Value, json};

use crate::digest::{Digest, Fingerprint, InvalidDigest};
use crate::error::{Error, Result};
use crate::model::{ModelVersion, checkpoint};

/// Media type of a signature.
pub(crate) const MEDIA_TYPE: &str = "application/vnd.dev.sigstore.bundle.v0.3+json";
const PAYLOAD: &str = "application/vnd.in-toto+json";
const STATEMENT: &str = "https://in-toto.io/Statement/v1";
const PREDICATE: &str = "https://model_signing/signature/v1.0";

/// Longest reported key hint: SHA-256 in hexadecimal digits.
const HINT_LENGTH: usize = 64;

/// Files in a model's folder that are not part of the model: the signature, and those of Git.
const IGNORED: [&str; 5] = ["model.sig", ".git", ".gitattributes", ".github", ".gitignore"];

/// The subject of a signature: a model's name, and its files with their digests.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct SignedFiles {
    /// The model's name.
    pub name: String,
    /// Path in the model, with parts separated by `/`, and digest.
    pub files: BTreeMap<String, Digest>,
}

impl SignedFiles {
    /// Hashes the files in a folder, except for `model.sig` and those of Git.
    pub fn in_folder(folder: &Path) -> Result<Self> {
        let absolute = folder.canonicalize().map_err(Error::io("read the folder", folder))?;
        let name = absolute.file_name().unwrap_or_default().to_string_lossy().into_owned();
        let mut files = BTreeMap::new();
        let (store, paths) = checkpoint::open(folder, &IGNORED)?;
        for path in paths {
            let digest = store.inspect(&path)?.map(|found| found.digest);
            let gone = || Error::refused(&folder.join(&path).display(), "was deleted meanwhile");
            files.insert(path.clone(), digest.ok_or_else(gone)?);
        }
        Ok(Self { name, files })
    }

    /// Returns the files of a version, as its manifest lists them.
    pub fn of_version(version: &ModelVersion) -> Self {
        Self { name: version.name.to_string(), files: version.manifest.files() }
    }

    fn statement(&self) -> String {
        let resource = |(name, digest): (&String, &Digest)| json!({ "name": name, "algorithm": "sha256", "digest": digest.hex() });
        let resources: Vec<_> = self.files.iter().map(resource).collect();
        let serialization = json!({
            "method": "files", "hash_type": "sha256", "allow_symlinks": false, "ignore_paths": IGNORED,
        });
        json!({
            "_type": STATEMENT,
            "subject": [{ "name": self.name, "digest": { "sha256": root(self.files.values()).hex() } }],
            "predicateType": PREDICATE,
            "predicate": { "serialization": serialization, "resources": resources },
        })
        .to_string()
    }

    /// Signs the files. The same key and files give the same bytes.
    pub fn sign(&self, key: &PrivateKey) -> Result<Signature> {
        let statement = self.statement();
        let signature: ecdsa::DerSignature = key.0.sign(&pre_authentication(PAYLOAD, statement.as_bytes()));
        let hint = PublicKey(*key.0.verifying_key()).hint()?;
        let bundle = json!({
            "mediaType": MEDIA_TYPE,
            "verificationMaterial": { "publicKey": { "hint": hint }, "tlogEntries": [] },
            "dsseEnvelope": {
                "payload": BASE64.encode(&statement),
                "payloadType": PAYLOAD,
                "signatures": [{ "sig": BASE64.encode(signature.as_bytes()), "keyid": "" }],
            },
        });
        Signature::parse(format!("{bundle}\n").as_bytes())
    }

    /// Verifies that `signature` was made with the private key of `key`, over exactly these files. The name may differ.
    pub fn verify(&self, signature: &Signature, key: &PublicKey) -> Result<()> {
        let payload = signature.payload()?;
        if !signature.is_by(key, &payload) {
            let hint = signature.key_hint().unwrap_or_else(|| "unknown".to_owned());
            return Err(invalid(format!(
                "it was not made with the private key of this public key ({}), or was changed since; it claims the key {hint}",
                key.hint()?
            )));
        }
        // Only now is it worth reading.
        self.compare(&payload)
    }

    /// Checks that a signed `payload` lists exactly these files.
    pub(crate) fn compare(&self, payload: &[u8]) -> Result<()> {
        let signed = parse_statement(payload)?;
        let paths: BTreeSet<_> = signed.keys().chain(self.files.keys()).collect();
        let differs = |path: &&String| signed.get(*path) != self.files.get(*path);
        let Some(path) = paths.into_iter().find(differs) else { return Ok(()) };
        let digest =
            |files: &BTreeMap<_, Digest>| files.get(path).map_or("missing".into(), Digest::to_string);
        let (found, signed) = (digest(&self.files), digest(&signed));
        Err(invalid(format!("other files were signed: {path} is {found}, the signed one is {signed}")))
    }
}

/// A signature of a model, the content of a `model.sig`. It is parsed, but proves nothing before it is verified.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Signature {
    text: String,
    bundle: Value,
}

impl Signature {
    /// Parses a Sigstore bundle.
    pub fn parse(bytes: &[u8]) -> Result<Self> {
        let refuse = |error: &dyn Display| invalid(format!("it is not a Sigstore bundle: {error}"));
        // The JSON reader does not check the encoding of texts that it skips.
        let text = std::str::from_utf8(bytes).map_err(|error| refuse(&error))?;
        let bundle: Value = serde_json::from_str(text).map_err(|error| refuse(&error))?;
        for required in ["/mediaType", "/dsseEnvelope/payload", "/dsseEnvelope/payloadType"] {
            string(&bundle, required)?;
        }
        Ok(Self { text: text.to_owned(), bundle })
    }

    /// Returns the bundle, byte for byte.
    pub fn as_str(&self) -> &str {
        &self.text
    }

    /// Returns the signature's own hint on its key, usually the SHA-256 of the public key's PEM. Anybody can write anything there,
    /// so control characters, which could manipulate a terminal, are removed.
    pub fn key_hint(&self) -> Option<String> {
        let hint = string(&self.bundle, "/verificationMaterial/publicKey/hint").ok()?;
        Some(hint.chars().filter(|c| !c.is_control()).take(HINT_LENGTH).collect())
    }

    /// Decodes what was signed.
    pub(crate) fn payload(&self) -> Result<Vec<u8>> {
        expect(&self.bundle, "/mediaType", MEDIA_TYPE)?;
        expect(&self.bundle, "/dsseEnvelope/payloadType", PAYLOAD)?;
        let payload = BASE64.decode(string(&self.bundle, "/dsseEnvelope/payload")?);
        payload.map_err(|error| invalid(format!("its payload is not base64: {error}")))
    }

    /// Returns whether one of the signatures of `payload` was made with the private key of `key`.
    fn is_by(&self, key: &PublicKey, payload: &[u8]) -> bool {
        let signed = pre_authentication(PAYLOAD, payload);
        let is_valid = |signature: &Value| {
            let der = BASE64.decode(signature.pointer("/sig")?.as_str()?).ok()?;
            key.0.verify(&signed, &ecdsa::Signature::from_der(&der).ok()?).ok()
        };
        array(&self.bundle, "/dsseEnvelope/signatures").iter().any(|signature| is_valid(signature).is_some())
    }
}

/// Parses an in-toto statement with the predicate of model signing: the signed files.
pub(crate) fn parse_statement(payload: &[u8]) -> Result<BTreeMap<String, Digest>> {
    let statement: Value = serde_json::from_slice(payload)
        .map_err(|error| invalid(format!("what was signed is not a statement on a model: {error}")))?;
    expect(&statement, "/_type", STATEMENT)?;
    expect(&statement, "/predicateType", PREDICATE)?;
    expect(&statement, "/predicate/serialization/method", "files")?;
    let (mut digests, mut files) = (Vec::new(), BTreeMap::new());
    for resource in array(&statement, "/predicate/resources") {
        expect(resource, "/algorithm", "sha256")?;
        let digest = format!("sha256:{}", string(resource, "/digest")?).parse();
        let digest = digest.map_err(|error: InvalidDigest| invalid(error.to_string()))?;
        digests.push(digest);
        let name = string(resource, "/name")?;
        if files.insert(name.to_owned(), digest).is_some() {
            return Err(invalid(format!("it names {name} twice")));
        }
    }
    let subjects = array(&statement, "/subject").len();
    if subjects != 1 {
        return Err(invalid(format!("it has {subjects} subjects, expected one")));
    }
    expect(&statement, "/subject/0/digest/sha256", &root(&digests).hex())?;
    Ok(files)
}

/// Computes the SHA-256 over the digests in the order of the paths.
fn root<'a>(digests: impl IntoIterator<Item = &'a Digest>) -> Digest {
    Fingerprint::of(digests.into_iter().map(|digest| digest.0)).digest
}

fn invalid(reason: String) -> Error {
    Error::refused(&"the signature is not valid", reason)
}

fn bad_key(reason: String) -> Error {
    Error::refused(&"the key", reason)
}

/// Returns the list at a JSON pointer, an empty one if there is none.
fn array<'a>(document: &'a Value, pointer: &str) -> &'a [Value] {
    document.pointer(pointer).and_then(Value::as_array).map_or(&[], Vec::as_slice)
}

/// Returns the string at a JSON pointer.
fn string<'a>(document: &'a Value, pointer: &str) -> Result<&'a str> {
    document
        .pointer(pointer)
        .and_then(Value::as_str)
        .ok_or_else(|| invalid(format!("it has no string {pointer}")))
}

fn expect(document: &Value, pointer: &str, expected: &str) -> Result<()> {
    match string(document, pointer)? {
        found if found == expected => Ok(()),
        found => Err(invalid(format!("{pointer} is `{found}`, expected `{expected}`"))),
    }
}

/// Returns the bytes that a DSSE signature is over.
fn pre_authentication(kind: &str, payload: &[u8]) -> Vec<u8> {
    let mut bytes = format!("DSSEv1 {} {kind} {} ", kind.len(), payload.len()).into_bytes();
    bytes.extend_from_slice(payload);
    bytes
}

/// A private key that signs models.
pub struct PrivateKey(ecdsa::SigningKey);

impl PrivateKey {
    /// Reads a PEM file with an unencrypted `EC PRIVATE KEY` (SEC 1) or `PRIVATE KEY` (PKCS #8) on the curve NIST P-256.
    pub fn from_pem(pem: &str) -> Result<Self> {
        let key = SecretKey::from_sec1_pem(pem).ok().or_else(|| SecretKey::from_pkcs8_pem(pem).ok());
        let reason = "is not a private key on the curve NIST P-256 in PEM without a password; `openssl ecparam -name \
                      prime256v1 -genkey -noout` creates one";
        key.map(|key| Self(key.into())).ok_or_else(|| bad_key(reason.to_owned()))
    }

    /// Returns the public key as PEM.
    pub fn public_pem(&self) -> Result<String> {
        PublicKey(*self.0.verifying_key()).pem()
    }
}

/// A public key that verifies signatures of models.
#[derive(Debug, Clone, PartialEq)]
pub struct PublicKey(ecdsa::VerifyingKey);

impl PublicKey {
    /// Reads a PEM file with a `PUBLIC KEY` on the curve NIST P-256.
    pub fn from_pem(pem: &str) -> Result<Self> {
        let reason = "is not a public key on the curve NIST P-256 in PEM; `openssl ec -in KEY -pubout` derives it from the \
                      private key";
        ecdsa::VerifyingKey::from_public_key_pem(pem).map(Self).map_err(|_| bad_key(reason.to_owned()))
    }

    fn pem(&self) -> Result<String> {
        let pem = self.0.to_public_key_pem(LineEnding::LF);
        pem.map_err(|error| bad_key(format!("cannot be written: {error}")))
    }

    /// Returns the hint by which a bundle names its key: SHA-256 of the key's PEM.
    pub(crate) fn hint(&self) -> Result<String> {
        Ok(Digest::of(self.pem()?.as_bytes()).hex())
    }
}

#[cfg(test)]
mod tests {
    use std::fs;

    use serde_json::Value;

    use super::*;
    use crate::events::attachment::Attachment;
    use crate::fixture::{self, Place};
    use crate::model::Note;

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

    /// The format of the bundle, on the raw JSON.
    #[test]
    fn has_the_format_of_oms() {
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
    fn verifies_the_folder_and_the_version_and_nothing_else() {
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
        assert!(verify(&again()).unwrap_err().to_string().contains("more.txt is sha256:"));
        fs::remove_file(folder.join("more.txt")).unwrap();
        fs::write(folder.join("weights.bin"), "abd").unwrap();
        assert!(verify(&again()).unwrap_err().to_string().contains("weights.bin is sha256:"));
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
            assert!(refusal.contains("was not made with the private key"), "{refusal}");
        }
        let other = PrivateKey(ecdsa::SigningKey::from_slice(&[7; 32]).unwrap());
        let other = PublicKey::from_pem(&other.public_pem().unwrap()).unwrap();
        assert!(files.verify(&signature, &other).is_err());
        assert!(Signature::parse(b"{}").unwrap_err().to_string().contains("no string /mediaType"));
    }

    /// Otherwise, the attached bytes would differ from the signed ones.
    #[test]
    fn a_signature_is_valid_utf_8() {
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

    /// One valid signature suffices, whatever else is attached.
    #[test]
    fn an_attached_signature_proves_the_signer() {
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
                registry.attach(&version, &Attachment::Signature(signature), &Note::default()).unwrap()
            };
            attach(&theirs);
            let other = pull(&ours).unwrap_err().to_string();
            let (own, hint) = (public(&ours).hint().unwrap(), public(&theirs).hint().unwrap());
            for part in
                ["none of 1 signatures is valid; attachment 1: ", &own, &format!("claims the key {hint}")]
            {
                assert!(other.contains(part), "{part}: {other}");
            }
            assert!(!place.path("pulled").exists(), "refused before a byte is delivered");
            attach(&ours);
            assert_eq!(registry.signature_by(&version, &public(&ours)).unwrap().number, 2);
            assert!(matches!(attach(&ours), crate::Outcome::AlreadyThere(_)), "signed twice, the same bytes");
            pull(&ours).unwrap();
            assert_eq!(fs::read(place.path("pulled/weights.bin")).unwrap(), b"abc");
            pull(&theirs).unwrap();
            assert!(pull(&fixture::key(3)).is_err());
        }
    }

    /// Whoever can write to the registry can attach anything, but not sign.
    #[test]
    fn forged_signatures_are_reported() {
        let place = Place::local();
        let registry = place.registry();
        let version = place.publish(&registry, "approach", b"abc");
        let signature = SignedFiles::of_version(&version).sign(&key()).unwrap();
        // For the right files and with the right hint, but by another key.
        let forged = SignedFiles::of_version(&version).sign(&fixture::key(1)).unwrap();
        let mut bundle: Value = serde_json::from_str(forged.as_str()).unwrap();
        bundle["verificationMaterial"]["publicKey"]["hint"] = signature.key_hint().unwrap().into();
        let forged = Signature::parse(bundle.to_string().as_bytes()).unwrap();
        registry.attach(&version, &Attachment::Signature(forged), &Note::default()).unwrap();
        let refusal = registry.signature_by(&version, &public()).unwrap_err().to_string();
        assert!(
            refusal.contains("attachment 1: ") && refusal.contains("was not made with the private key"),
            "{refusal}"
        );
        // A damaged one does not hide a valid one.
        let damaged = registry.attachments(&version).unwrap()[0].attached.as_ref().unwrap().clone();
        crate::fixture::flip(&place.path("registry"), &crate::store::blob_key(damaged.digest));
        assert!(registry.signature_by(&version, &public()).is_err());
        registry.attach(&version, &Attachment::Signature(signature), &Note::default()).unwrap();
        assert_eq!(registry.signature_by(&version, &public()).unwrap().number, 2);
    }

    #[test]
    fn a_hint_has_no_control_characters() {
        let place = Place::local();
        let mut bundle: Value = serde_json::from_str(signed(&place).1.as_str()).unwrap();
        bundle["verificationMaterial"]["publicKey"]["hint"] = format!("\u{1b}[2J{}", "x".repeat(99)).into();
        let hint = Signature::parse(bundle.to_string().as_bytes()).unwrap().key_hint().unwrap();
        assert_eq!(hint, format!("[2J{}", "x".repeat(61)));
    }
}
