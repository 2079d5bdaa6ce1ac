//! `flowservo model`: publish, list, show, pull, verify.

use crate::support::Folder;

/// A folder that holds what a checkpoint holds, with these weights.
pub(crate) fn checkpoint(folder: &Folder, name: &str, weights: &str) {
    let info = r#"{
        "format": 2,
        "task": { "kind": "avoidance", "network": { "trunk": "flownet_s", "width": 0.1, "input": [32, 24], "head": 8 } },
        "standardization": null,
        "camera": { "width": 32, "height": 24, "horizontal_fov_deg": 60.0, "behind_hand_mm": 100.0 },
        "datasets": [{ "name": "avoid", "digest": "DIGEST", "rows": 4 }],
        "seed": 5,
        "epoch": null,
        "weights_sha256": ""
    }"#;
    folder.write(&format!("{name}/model.json"), &info.replace("DIGEST", &"ab".repeat(32)));
    folder.write(&format!("{name}/config.toml"), "seed = 5\n");
    folder.write(&format!("{name}/weights.safetensors"), weights);
}

#[test]
fn what_is_pulled_is_what_was_published() {
    let folder = Folder::new();
    checkpoint(&folder, "first", "one");
    checkpoint(&folder, "second", "two");
    assert!(folder.run("model publish first avoid").ok().stdout().contains("published avoid@1"));
    assert!(folder.run("model publish second avoid").ok().stdout().contains("published avoid@2"));
    let again = folder.run("model publish first avoid").ok().stdout();
    assert!(again.contains("avoid@1 has this content already"), "{again}");
    assert!(folder.run("model list").ok().stdout().contains("avoid  versions 1, 2"));
    let shown = folder.run("model show avoid@1 --json").ok().json();
    assert_eq!(shown["manifest"]["lineage"]["seed"], 5);
    assert_eq!(shown["manifest"]["lineage"]["datasets"]["avoid"], format!("sha256:{}", "ab".repeat(32)));
    folder.run("model pull avoid@1 --out pulled").ok();
    assert_eq!(std::fs::read_to_string(folder.path("pulled/weights.safetensors")).unwrap(), "one");
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
    std::fs::write(&blob, "The weights").unwrap();
    let verified = folder.run("model verify");
    verified.fails(1, &["damaged"]);
    assert!(verified.stdout().contains("weights.safetensors"), "{}", verified.stdout());
    folder.run("model pull avoid@1 --out pulled").fails(1, &["weights.safetensors"]);
    assert!(!folder.path("pulled").exists());
}

#[test]
fn names_that_are_none_are_refused() {
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
