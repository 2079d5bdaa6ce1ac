//! `flowservo train --from MODEL`: from a published model to its next version.

use crate::support::{Folder, repository};
use serde_json::Value;
use std::fs;

/// A folder with a dataset `a` and a run `first` on it, published as approach@1 and approach:champion.
fn published() -> Folder {
    let folder = Folder::new();
    let dataset = repository().join("configs/datasets/a.toml");
    let camera = "--set world.camera.width=32 --set world.camera.height=24";
    folder.run(&format!("dataset generate {} --out a --set count=16 {camera}", dataset.display())).ok();
    folder.run(&train("--out first")).ok();
    folder.run("model publish first/best approach").ok();
    folder.run("model alias approach champion 1").ok();
    folder
}

/// Trains a tiny network.
fn train(further: &str) -> String {
    let config = repository().join("configs/train/approach.toml");
    format!(
        "train {} --data a --device cpu --set network.width=0.02 --set network.head=8 --set network.input=[32,24] \
         --set optimizer.batch=4 --set validation=0.25 --set phases.0.epochs=2 {further}",
        config.display()
    )
}

fn lineage(folder: &Folder, model: &str) -> (Value, Value) {
    let shown = folder.run(&format!("model show {model} --json")).ok().json();
    (shown["manifest"]["lineage"].clone(), shown["digest"].clone())
}

#[test]
fn a_folder_without_a_checkpoint_does_not_hide_a_model() {
    let folder = published();
    folder.write("approach/notes.md", "our plans");
    let began = folder.run(&train("--from approach --out second")).ok();
    assert!(began.stderr().contains("starts from approach@1"), "{}", began.stderr());
    folder
        .run(&train("--from first --out third"))
        .fails(2, &["no model `first`: the folder has no model.json", "no model `first`"]);
}

#[test]
fn the_next_version_names_its_parent() {
    let folder = published();
    let second = folder.run(&train("--from approach:champion --out second")).ok();
    assert!(second.stderr().contains("starts from approach@1"), "{}", second.stderr());
    folder.run("model publish second/best approach").ok();
    let ((first, digest), (second, _)) = (lineage(&folder, "approach@1"), lineage(&folder, "approach@2"));
    assert_eq!((&first["parent"], &second["parent"]), (&Value::Null, &digest));
    let shown = folder.run("model show approach@2").ok().stdout();
    assert!(shown.contains(&format!("started from {}", digest.as_str().unwrap())), "{shown}");
    // The software is that of the training run, not that of the publisher.
    for lineage in [first, second] {
        assert_eq!(lineage["device"], "CPU");
        for software in ["flowservo", "burn", "rustc"] {
            let version = lineage["software"][software].as_str().unwrap();
            assert!(version.starts_with(|c: char| c.is_ascii_digit()), "{software} {version}");
        }
    }

    // The configuration in the run reproduces it, even after the alias has moved.
    folder.run("model alias approach champion 2").ok();
    folder.run("train second/config.toml --device cpu --out again").ok();
    for file in ["config.toml", "best/weights.safetensors", "best/model.json"] {
        let [once, again] = ["second", "again"].map(|run| fs::read(folder.path(run).join(file)).unwrap());
        assert!(once == again, "{file}");
    }
    // A run resumes without the registry, but not from another parent.
    fs::remove_dir_all(folder.path("models")).unwrap();
    folder.run(&train("--from approach:champion --out second --resume")).ok();
    folder.run(&train("--from approach@1 --out second --resume")).ok();
    folder.run("train second/config.toml --device cpu --out second --resume").ok();
    let exact = format!("parent = \"approach@{}\"", digest.as_str().unwrap());
    folder.run(&train("--from approach@2 --out second --resume")).fails(1, &[&exact, "approach@2"]);
    folder.run(&train("--out second --resume")).fails(1, &[&exact, "absent"]);
    // A checkpoint folder has no version to record.
    folder.run(&train("--from first/best --out third")).ok();
    folder.run("model publish third/best approach").ok();
    assert_eq!(lineage(&folder, "approach@1").0["parent"], Value::Null);
    let reported = fs::read_to_string(folder.path("third/best/model.json")).unwrap();
    let reported: Value = serde_json::from_str(&reported).unwrap();
    let first = fs::read_to_string(folder.path("first/best/model.json")).unwrap();
    let first: Value = serde_json::from_str(&first).unwrap();
    assert_eq!(reported["parent"], serde_json::json!({ "weights_sha256": first["weights_sha256"] }));
}

#[test]
fn unusable_parents_are_refused_before_anything_is_written() {
    let folder = published();
    let begin = |from: &str| folder.run(&train(&format!("--out run --from {from}")));
    for unknown in ["approach@7", "approach:challenger", "nowhere", "no/where"] {
        begin(unknown).fails(2, &[&format!("no model `{unknown}`: not a checkpoint folder")]);
    }
    begin("approach --registry elsewhere").fails(2, &["approach", "elsewhere"]);
    begin("approach --set network.width=0.04").fails(1, &["approach@1 has network.width = 0.02", "has 0.04"]);
    let both = fs::read_to_string(folder.path("first/config.toml")).unwrap();
    folder.write("both.toml", &format!("pretrained = \"flownets.safetensors\"\n{both}"));
    folder
        .run("train both.toml --from approach --out run")
        .fails(2, &["both.toml", "pretrained", "`parent`"]);

    // Damage in the registry, in a pulled copy, and in a folder.
    let damage = |file: &str| {
        let path = folder.path(file);
        let mut bytes = fs::read(&path).unwrap();
        *bytes.last_mut().unwrap() ^= 1;
        fs::write(path, bytes).unwrap();
    };
    damage("models/pulled/approach-1/weights.safetensors");
    begin("approach").fails(1, &["models/pulled/approach-1", "something else"]);
    fs::remove_dir_all(folder.path("models/pulled")).unwrap();
    let shown = folder.run("model show approach --json").ok().json();
    let layers = shown["manifest"]["layers"].as_array().unwrap();
    let weights = layers.iter().find(|layer| layer["annotations"].to_string().contains("weights")).unwrap();
    let digest = weights["digest"].as_str().unwrap().strip_prefix("sha256:").unwrap();
    let blob = format!("blobs/sha256/{}/{digest}", &digest[..2]);
    damage(&format!("models/{blob}"));
    begin("approach").fails(1, &["weights.safetensors", &blob]);
    damage("first/best/weights.safetensors");
    begin("first/best").fails(1, &["first/best/weights.safetensors is damaged"]);
    assert!(!folder.path("run").exists());
}
