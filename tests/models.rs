//! `flowservo model`: publish, list, show, pull, verify, alias, yank, copy, gc, diff, export, import, sign, attach.

use crate::support::{Folder, safetensors};

/// Writes a checkpoint folder with these weights.
pub(crate) fn checkpoint(folder: &Folder, name: &str, weights: &str) {
    let info = r#"{
        "format": 2,
        "task": { "kind": "avoidance", "network": { "trunk": "flownet_s", "width": 0.1, "input": [32, 24], "head": 8 } },
        "standardization": null,
        "camera": { "width": 32, "height": 24, "horizontal_fov_deg": 60.0, "behind_hand_mm": 100.0 },
        "datasets": [{ "name": "avoid", "digest": "DIGEST", "rows": 4 }],
        "seed": 5,
        "epoch": null,
        "weights_sha256": "WEIGHTS"
    }"#;
    let weights = safetensors(weights);
    let digest = registry::Digest::of(weights.as_bytes()).hex();
    let info = info.replace("DIGEST", &"ab".repeat(32)).replace("WEIGHTS", &digest);
    folder.write(&format!("{name}/model.json"), &info);
    folder.write(&format!("{name}/config.toml"), "seed = 5\n");
    folder.write(&format!("{name}/weights.safetensors"), &weights);
}

#[test]
fn what_is_pulled_is_what_was_published() {
    let folder = Folder::new();
    checkpoint(&folder, "first", "one");
    checkpoint(&folder, "second", "two");
    assert!(folder.run("model publish first avoid").ok().stdout().contains("published avoid@1"));
    assert!(folder.run("model publish second avoid").ok().stdout().contains("published avoid@2"));
    let again = folder.run("model publish first avoid").ok().stdout();
    assert!(again.contains("avoid@1 already has this content"), "{again}");
    assert!(folder.run("model list").ok().stdout().contains("avoid  versions 1, 2"));
    let shown = folder.run("model show avoid@1 --json").ok().json();
    assert_eq!(shown["manifest"]["lineage"]["seed"], 5);
    assert_eq!(shown["manifest"]["lineage"]["datasets"]["avoid"], format!("sha256:{}", "ab".repeat(32)));
    // Unknown provenance is omitted, not guessed.
    assert_eq!(shown["manifest"]["lineage"]["software"], serde_json::json!({}));
    assert_eq!(shown["manifest"]["lineage"].get("device"), None);
    // Inputs and outputs.
    let interface = &shown["manifest"]["interface"];
    assert_eq!(interface["input"]["width"], 32);
    assert_eq!(interface["output"]["kind"], "avoidance_map");
    assert_eq!(interface["camera"]["horizontal_fov_deg"], 60.0);
    folder.run("model pull avoid@1 --out pulled").ok();
    assert!(folder.path("pulled/config.json").exists());
    assert_eq!(
        std::fs::read_to_string(folder.path("pulled/weights.safetensors")).unwrap(),
        safetensors("one")
    );
    folder.run("model verify").ok();
}

#[test]
fn a_changed_file_is_found_and_never_delivered() {
    let folder = Folder::new();
    checkpoint(&folder, "run", "the weights");
    folder.run("model publish run avoid").ok();
    let shown = folder.run("model show avoid --json").ok().json();
    let layers = shown["manifest"]["layers"].as_array().unwrap();
    let weights = layers.iter().find(|layer| layer["annotations"].to_string().contains("weights")).unwrap();
    let digest = weights["digest"].as_str().unwrap().strip_prefix("sha256:").unwrap();
    let blob = folder.path(&format!("models/blobs/sha256/{}/{digest}", &digest[..2]));
    std::fs::write(&blob, safetensors("The weights")).unwrap();
    let verified = folder.run("model verify");
    verified.fails(1, &["damaged"]);
    assert!(verified.stdout().contains("weights.safetensors"), "{}", verified.stdout());
    folder.run("model pull avoid@1 --out pulled").fails(1, &["weights.safetensors"]);
    assert!(!folder.path("pulled").exists());
}

#[test]
fn invalid_names_are_refused() {
    let folder = Folder::new();
    checkpoint(&folder, "run", "x");
    for name in ["../out", "a/b", "Upper", "."] {
        folder.run(&format!("model publish run {name}")).fails(2, &[name]);
    }
    folder.run("model show avoid@0").fails(2, &["avoid@0"]);
    folder.run("model show avoid@1").fails(1, &["models"]);
    folder.run("model publish run avoid").ok();
    folder.run("model show avoid@7").fails(1, &["avoid@7"]);
    folder.run("model show avoid@x").fails(2, &["avoid@x"]);
    folder.run("model publish nowhere avoid").fails(1, &["nowhere/model.json"]);
}

/// Creates a registry with two versions of `avoid`.
fn two_versions() -> Folder {
    let folder = Folder::new();
    for name in ["first", "second"] {
        checkpoint(&folder, name, name);
        folder.run(&format!("model publish {name} avoid")).ok();
    }
    folder
}

#[test]
fn aliases_move_and_end_and_their_history_stays() {
    let folder = two_versions();
    // Control characters are not printed.
    let set = folder.run("model alias avoid champion 2 --reason wins\u{1b} --by ann --json").ok();
    assert!(set.stdout().contains("avoid:champion now names avoid@2"), "{}", set.stdout());
    assert_eq!(set.json()["changed"], true);
    assert_eq!(folder.run("model alias avoid champion 2 --json").ok().json()["changed"], false);
    folder.run("model alias avoid champion 1 --expect 1").fails(1, &["avoid:champion is version 2"]);
    folder.run("model alias avoid champion 1 --expect 2").ok();
    folder.run("model pull avoid:champion --out pulled").ok();
    assert_eq!(
        std::fs::read_to_string(folder.path("pulled/weights.safetensors")).unwrap(),
        safetensors("first")
    );
    assert!(folder.run("model alias avoid").ok().stdout().contains("avoid:champion names avoid@1"));
    assert!(folder.run("model list").ok().stdout().contains("versions 1, 2; champion is 1"));

    folder.run("model alias avoid champion --remove").ok();
    let history = folder.run("model alias avoid champion --json").ok();
    assert!(history.stdout().contains("version 2: wins (ann, 2"), "{}", history.stdout());
    assert!(history.stdout().contains("3  no version"), "{}", history.stdout());
    assert_eq!(history.json().as_array().unwrap().len(), 3);
    folder.run("model alias avoid champion 2 --expect none").ok();
    let verified = folder.run("model verify --json").ok().json();
    assert_eq!((&verified["events"], &verified["versions"]), (&4.into(), &2.into()));
}

#[test]
fn invalid_aliases_are_refused() {
    let folder = two_versions();
    folder.run("model alias avoid champion 7").fails(1, &["avoid@7"]);
    folder.run("model alias avoid champion").fails(1, &["no alias `champion`", "none"]);
    folder.run("model alias avoid champion 1").ok();
    folder.run("model show avoid:champoin").fails(1, &["no alias `champoin`", "champion"]);
    folder.run("model alias other champion 1").fails(1, &["no model `other`"]);
    folder.run("model alias other").fails(1, &["no model `other`"]);
    folder.run("model alias avoid 3 1").fails(2, &["`3` is not an alias"]);
    folder.run("model alias avoid champion x").fails(2, &["avoid@x"]);
    folder.run("model alias avoid champion 2 --expect x").fails(2, &["--expect x"]);
    folder.run("model alias avoid --remove").fails(2, &["<ALIAS>"]);
    folder.run("model alias avoid champion --expect 1").fails(2, &["--remove"]);
    folder.run("model alias avoid champion 1 --remove").fails(2, &["--remove"]);
}

#[test]
fn a_yanked_version_is_used_only_by_name_and_with_a_warning() {
    let folder = two_versions();
    folder.run("model alias avoid champion 2").ok();
    folder.run("model yank avoid@2").fails(2, &["--reason"]);
    folder.run("model yank avoid --reason bad").fails(2, &["which version"]);
    assert!(
        folder.run("model yank avoid@2 --reason leaked").ok().stdout().contains("yanked avoid@2: leaked")
    );
    assert!(folder.run("model yank avoid@2 --reason x").ok().stdout().contains("already yanked: leaked"));
    assert!(folder.run("model list").ok().stdout().contains("versions 1, 2 (yanked)"));
    assert_eq!(folder.run("model show avoid --json").ok().json()["version"], 1);
    for model in ["avoid@2", "avoid:champion"] {
        let shown = folder.run(&format!("model show {model} --json")).ok();
        assert!(shown.stderr().contains("warning: avoid@2 is yanked: leaked"), "{}", shown.stderr());
        assert_eq!(shown.json()["yanked"]["reason"], "leaked");
    }
    let pulled = folder.run("model pull avoid@2 --out pulled").ok();
    assert!(pulled.stderr().contains("yanked: leaked"), "{}", pulled.stderr());
    folder.run("model yank avoid@1 --reason old").ok();
    folder.run("model show avoid").fails(1, &["every version is yanked", "avoid@2"]);
    folder.run("model yank avoid@2 --undo").ok();
    assert_eq!(folder.run("model show avoid --json").ok().json()["version"], 2);
    folder.run("model verify").ok();
}

#[test]
fn garbage_is_shown_first_and_deleted_on_demand() {
    let folder = two_versions();
    let name = format!("models/blobs/sha256/cd/{}", "cd".repeat(32));
    folder.write(&name, "orphan");
    folder.write("models/models/avoid/versions/000003#1", "half");
    let young = folder.run("model gc --json").ok();
    assert_eq!(young.json()["found"], serde_json::json!([]));
    let shown = folder.run("model gc --older-than 0s --json").ok();
    assert!(shown.stdout().contains("nothing was deleted"), "{}", shown.stdout());
    assert_eq!((&shown.json()["found_bytes"], &shown.json()["deleted_bytes"]), (&10.into(), &0.into()));
    assert!(folder.path(&name).exists());
    let deleted = folder.run("model gc --older-than 0s --delete --json").ok();
    assert_eq!(deleted.json()["deleted"].as_array().unwrap().len(), 2);
    assert!(!folder.path(&name).exists());
    folder.run("model verify").ok();
    folder.run("model gc --older-than 2w").fails(2, &["14d"]);
}

#[test]
fn differences_between_versions_are_shown() {
    let folder = two_versions();
    checkpoint(&folder, "third", "first");
    folder.write("third/config.toml", "seed = 6\n[phase]\nepochs = 2\n");
    folder.run("model publish third avoid").ok();
    let told = folder.run("model diff avoid@1 avoid --json").ok();
    for words in ["- avoid@1", "+ avoid@3", "- seed", "+ phase.epochs", "config.toml"] {
        assert!(told.stdout().contains(words), "{words}: {}", told.stdout());
    }
    let found = told.json();
    let seed = serde_json::json!({ "key": "seed", "from": 5, "to": 6 });
    assert_eq!(found["configuration"].as_array().unwrap().len(), 2);
    assert_eq!(found["configuration"][1], seed);
    assert_eq!(found["files"].as_array().unwrap().len(), 1, "the weights are the same");
    assert_eq!(found["lineage"][0]["key"], "config");
    let same = folder.run("model diff avoid@1 avoid@1").ok().stdout();
    assert!(same.contains("configuration: the same") && same.contains("files: the same"), "{same}");
}

/// A version that is exported and imported into another registry under its name keeps its digest.
#[test]
fn exported_models_can_be_imported() {
    let folder = Folder::new();
    checkpoint(&folder, "run", "the weights");
    folder.run("model publish run avoid").ok();
    let digest = folder.run("model show avoid --json").ok().json()["digest"].clone();
    for (format, further) in [("oci", ""), ("huggingface", "--license cc0-1.0")] {
        folder.run(&format!("model export avoid@1 --format {format} --out {format} {further}")).ok();
        folder.run(&format!("model export avoid@1 --format {format} --out {format}")).fails(1, &[format]);
        let imported =
            folder.run(&format!("model import {format} avoid --registry {format}-registry --json")).ok();
        assert_eq!(imported.json()["digest"], digest);
        let pulled = format!("model pull avoid@1 --registry {format}-registry --out {format}-pulled");
        folder.run(&pulled).ok();
        assert_eq!(folder.files(&format!("{format}-pulled")), folder.files("run"));
    }
    let card = std::fs::read_to_string(folder.path("huggingface/README.md")).unwrap();
    assert!(card.starts_with("---\nlicense: \"cc0-1.0\"\n") && card.contains("CNN_avoid"), "{card}");
    for file in ["config.json", "model.safetensors", "model.json", "config.toml"] {
        assert!(folder.path("huggingface").join(file).exists(), "{file}");
    }
    std::fs::write(folder.path("huggingface/model.safetensors"), safetensors("the Weights")).unwrap();
    folder.run("model import huggingface avoid --registry new").fails(1, &["model.safetensors", "digest"]);
    folder.run("model import run avoid").fails(2, &["run", "model publish"]);
    folder.run("model export avoid --format oci --license mit --out x").fails(2, &["--license"]);
}

/// The example key of RFC 6979, appendix A.2.5. It is public.
const KEY: &str = "-----BEGIN EC PRIVATE KEY-----\n\
MHcCAQEEIMmvqdhFunUWa1whV2ex1pNOUMPbNuibEnuKYisSD2choAoGCCqGSM49\n\
AwEHoUQDQgAEYP7UuiVanTHJYet0xjVtaMBJuJI7Yfps5mliLmDyn7Z5A/4QCLi8\n\
maQa6elWKLxk8vGyDC1+n1F3o8KU1EYimQ==\n\
-----END EC PRIVATE KEY-----\n";
const PUBLIC_KEY: &str = "-----BEGIN PUBLIC KEY-----\n\
MFkwEwYHKoZIzj0CAQYIKoZIzj0DAQcDQgAEYP7UuiVanTHJYet0xjVtaMBJuJI7\n\
Yfps5mliLmDyn7Z5A/4QCLi8maQa6elWKLxk8vGyDC1+n1F3o8KU1EYimQ==\n\
-----END PUBLIC KEY-----\n";

#[test]
fn a_checkpoint_with_other_weights_is_not_published() {
    let folder = Folder::new();
    checkpoint(&folder, "run", "the weights");
    folder.write("run/weights.safetensors", &safetensors("the weighs"));
    folder.run("model publish run avoid").fails(1, &["run/weights.safetensors", "damaged"]);
    assert_eq!(folder.run("model list --json").ok().json(), serde_json::json!([]));
}

#[test]
fn a_signature_verifies_what_was_signed() {
    let folder = Folder::new();
    checkpoint(&folder, "first", "one");
    checkpoint(&folder, "second", "two");
    folder.write("key.pem", KEY);
    folder.write("pub.pem", PUBLIC_KEY);
    folder.run("model publish first avoid").ok();
    folder.run("model publish second avoid").ok();
    folder.run("model sign avoid@1 --key key.pem --out one.sig").ok();
    folder.run("model sign avoid@1 --key key.pem --out one.sig").fails(1, &["one.sig", "never"]);
    folder.run("model sign avoid@1 --key pub.pem --out x.sig").fails(2, &["pub.pem", "private key"]);
    assert!(!folder.path("model.sig").exists(), "the signature is in the registry");
    // A folder that is not a checkpoint, but has the model's name by chance.
    folder.write("avoid/notes.md", "our plans");
    assert!(folder.run("model sign avoid --key key.pem").ok().stdout().starts_with("avoid@2: signature"));
    folder.run("model verify avoid --public-key pub.pem").ok();
    folder.run("model pull avoid@1 --out pulled").ok();
    for model in ["avoid@1", "pulled"] {
        folder.run(&format!("model verify {model} --public-key pub.pem --signature one.sig")).ok();
    }
    let other = "model verify avoid@2 --public-key pub.pem --signature one.sig";
    folder.run(other).fails(1, &["one.sig", "model.json"]);
    folder.run("model verify avoid@1 --public-key key.pem --signature one.sig").fails(2, &["public key"]);
    folder.run("model verify --public-key pub.pem").fails(2, &["MODEL"]);
    folder.run("model sign pulled --key key.pem").ok();
    folder.run("model verify pulled --public-key pub.pem").ok();
    folder.write("pulled/weights.safetensors", "One");
    folder
        .run("model verify pulled --public-key pub.pem --signature one.sig")
        .fails(1, &["weights.safetensors"]);
}

/// Another key, made with `openssl ecparam`.
const OTHER_KEY: &str = "-----BEGIN EC PRIVATE KEY-----\n\
MHcCAQEEID2CibQXA+y1m2J6wOdtI6cD9xDO5fecOqk7GvbkR4bYoAoGCCqGSM49\n\
AwEHoUQDQgAEBgiPsY0Es4qnhEqO2rv1dI7jByWPL29KFdy5+V6TMZ3X/sjxKw8K\n\
OrzWbTml/CofJ123vjc3+X9L3L4hDBqagQ==\n\
-----END EC PRIVATE KEY-----\n";

/// Creates two versions of `avoid`, and keys.
fn with_keys() -> Folder {
    let folder = two_versions();
    for (file, text) in [("key.pem", KEY), ("pub.pem", PUBLIC_KEY), ("other.pem", OTHER_KEY)] {
        folder.write(file, text);
    }
    folder
}

/// Creates two versions of `avoid` and signs the first with both keys. `other.sig` is a file of the first signature.
fn signed_twice() -> Folder {
    let folder = with_keys();
    folder.run("model sign avoid@1 --key other.pem --out other.sig").ok();
    folder.run("model sign avoid@1 --key key.pem").ok();
    folder
}

const VERIFY_SIGNED: &str = "model verify avoid@1 --public-key pub.pem";
const PULL_SIGNED: &str = "model pull avoid@1 --out pulled --public-key pub.pem";

#[test]
fn pulling_with_a_key_requires_a_signature() {
    let folder = with_keys();
    let none = ["avoid@1 is not signed with this key", "no signature is attached"];
    folder.run(VERIFY_SIGNED).fails(1, &none);
    folder.run(PULL_SIGNED).fails(1, &none);
    folder.run("model sign avoid@1 --key other.pem").ok();
    folder.run(PULL_SIGNED).fails(1, &["none of 1 signatures is valid"]);
    assert!(!folder.path("pulled").exists());
    folder.run(&PULL_SIGNED.replace("pub.pem", "other.pem")).fails(2, &["other.pem", "public key"]);

    let signed = folder.run("model sign avoid@1 --key key.pem --json").ok();
    assert!(signed.stdout().contains("avoid@1: signature attached"), "{}", signed.stdout());
    assert_eq!(signed.json()["changed"], true);
    assert_eq!(signed.json()["attachment"]["number"], 2);
    assert_eq!(folder.run("model sign avoid@1 --key key.pem --json").ok().json()["changed"], false);
    assert_eq!(folder.run(&format!("{VERIFY_SIGNED} --json")).ok().json()["attachment"], 2);
    folder.run(PULL_SIGNED).ok();
    assert_eq!(
        std::fs::read_to_string(folder.path("pulled/weights.safetensors")).unwrap(),
        safetensors("first")
    );
    folder.run("model verify avoid --public-key pub.pem").fails(1, &["avoid@2", "no signature"]);
}

#[test]
fn a_version_shows_when_it_was_published_and_what_is_attached() {
    let folder = signed_twice();
    let shown = folder.run("model show avoid@1 --json").ok();
    let (text, shown) = (shown.stdout(), shown.json());
    assert!(text.contains("  2 signatures\n"), "{text}");
    let created = &shown["manifest"]["annotations"]["org.opencontainers.image.created"];
    assert!(text.contains(&format!("published {}", created.as_str().unwrap())), "{text}");
    let hint = |i: usize| shown["attachments"][i]["signature"]["key_hint"].as_str().unwrap().to_owned();
    assert_ne!(hint(0), hint(1));
    for i in 0..2 {
        let line = format!("  attachment {}: signature by key {} (2", i + 1, hint(i));
        assert!(text.contains(&line), "{line} in\n{text}");
    }
    // The same files published at another time are not another version.
    folder.run("model publish first avoid").ok();
    assert_eq!(folder.run("model show avoid@1 --json").ok().json(), shown);
}

#[test]
fn signatures_from_files_are_attached_where_they_belong() {
    let folder = signed_twice();
    let again = folder.run("model attach avoid@1 --signature other.sig").ok().stdout();
    assert!(again.contains("already has this signature"), "{again}");
    folder
        .run("model attach avoid@2 --signature other.sig")
        .fails(1, &["other files were signed", "model.json"]);
    let none = "model attach avoid@2 --signature first/config.toml";
    folder.run(none).fails(1, &["first/config.toml", "not a Sigstore bundle"]);
    folder.run("model attach avoid@2").fails(2, &["--evaluation", "--signature"]);
    folder.run("model publish first same").ok();
    folder.run("model attach same@1 --signature other.sig --reason copied --by ann").ok();
    let shown = folder.run("model show same").ok().stdout();
    assert!(shown.contains(": copied (ann, 2"), "{shown}");
    folder.run("model gc --older-than 0s --delete").ok();
    let verified = folder.run("model verify --json").ok().json();
    assert_eq!((&verified["events"], &verified["versions"]), (&3.into(), &3.into()));
}

#[test]
fn a_damaged_signature_is_found_and_does_not_hide_another() {
    let folder = signed_twice();
    let shown = folder.run("model show avoid@1 --json").ok().json();
    let digest = shown["attachments"][0]["attached"]["digest"].as_str().unwrap()[7..].to_owned();
    let blob = folder.path(&format!("models/blobs/sha256/{}/{digest}", &digest[..2]));
    let mut bytes = std::fs::read(&blob).unwrap();
    bytes[100] ^= 1;
    std::fs::write(&blob, bytes).unwrap();
    for all in ["", " avoid@1"] {
        let found = folder.run(&format!("model verify{all}"));
        found.fails(1, &["damaged"]);
        assert!(found.stdout().contains("avoid@1/events: "), "{}", found.stdout());
    }
    folder.run(VERIFY_SIGNED).ok();
    folder.run(PULL_SIGNED).ok();
    // Signing again with the same key repairs it.
    folder.run("model sign avoid@1 --key other.pem").ok();
    folder.run("model verify").ok();
}

/// The other registry has the versions with their digests, signatures and yanks, also if one command is repeated.
#[test]
fn versions_are_copied_to_another_registry() {
    let folder = with_keys();
    folder.run("model sign avoid@1 --key key.pem").ok();
    folder.run("model yank avoid@2 --reason leaked").ok();
    folder.run("model alias avoid champion 1").ok();
    let digest = |reference: &str, registry: &str| {
        let shown = format!("model show {reference} --registry {registry} --json");
        folder.run(&shown).ok().json()["digest"].clone()
    };
    folder.run("model copy avoid --all --aliases --to lab --json").ok();
    for reference in ["avoid@1", "avoid@2", "avoid:champion"] {
        assert_eq!(digest(reference, "lab"), digest(reference, "models"), "{reference}");
    }
    folder.run(&format!("{VERIFY_SIGNED} --registry lab")).ok();
    let shown = folder.run("model show avoid@2 --registry lab --json").ok().json();
    assert_eq!(shown["yanked"]["reason"], "leaked");
    let again = folder.run("model copy avoid --all --aliases --to lab --json").ok();
    assert!(again.stdout().contains("avoid@1: already exists as avoid@1"), "{}", again.stdout());
    assert_eq!(again.json()[1]["copied"]["is_new"], false);

    // Numbers have no gaps, so the second version alone is the first one there.
    let alone = folder.run("model copy avoid@2 --to other --json").ok();
    assert!(alone.stdout().contains("avoid@2: copied as avoid@1"), "{}", alone.stdout());
    assert_eq!(
        (&alone.json()[0]["from"], &alone.json()[0]["copied"]["version"]["version"]),
        (&2.into(), &1.into())
    );
    assert_eq!(digest("avoid@1", "other"), digest("avoid@2", "models"));
    folder.run("model copy avoid@1 --to other").ok();
    folder.run("model pull avoid@2 --registry other --out pulled --public-key pub.pem").ok();
    for registry in ["lab", "other"] {
        folder.run(&format!("model verify --registry {registry}")).ok();
    }
    folder.run("model copy avoid@9 --to new").fails(1, &["avoid@9"]);
    folder.run("model copy other --all --to new").fails(1, &["no model `other`", "avoid"]);
    folder.run("model copy avoid@1 --all --to new").fails(2, &["avoid@1"]);
    assert!(!folder.path("new").exists(), "nothing is created for a wrong name");
}
