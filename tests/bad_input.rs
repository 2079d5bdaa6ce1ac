//! Bad input causes an error that names the place and the remedy, before any work is done where possible.

use crate::support::{Folder, repository};

fn config(name: &str) -> String {
    repository().join("configs").join(name).display().to_string()
}

/// Generates a dataset of a few tiny images with further arguments.
fn dataset(changes: &str) -> String {
    let size = "--set count=3 --set world.camera.width=32 --set world.camera.height=24";
    format!("dataset generate {} --out data {size} {changes}", config("datasets/c.toml"))
}

#[test]
fn bad_usage() {
    let folder = Folder::new();
    folder.run("frobnicate").fails(2, &["frobnicate", "Usage"]);
    folder.run("dataset generate").fails(2, &["--out"]);
    folder.run("reproduce --preset huge").fails(2, &["huge", "quick"]);
    folder.run("reproduce").fails(2, &["quick.toml does not exist", "--configs"]);
    folder.run("dataset generate nowhere.toml --out data").fails(2, &["nowhere.toml"]);
    folder.run("--threads 0 dataset info data").fails(2, &["--threads"]);
}

#[test]
fn bad_configurations() {
    let folder = Folder::new();
    folder.run(&dataset("--set cuont=4")).fails(2, &["--set cuont=4", "count"]);
    folder.run(&dataset("--set count=-1")).fails(2, &["c.toml", "count"]);
    folder.run(&dataset("--set count=many")).fails(2, &["c.toml", "many"]);
    folder
        .run(&dataset("--set world.camera.horizontal_fov_deg=180"))
        .fails(2, &["c.toml", "horizontal_fov_deg = 180"]);
    folder.run(&dataset("--set motions.0.share=0.7")).fails(2, &["motions", "add up"]);
    let base = std::fs::read_to_string(config("datasets/a.toml")).unwrap();
    let base = base.replace("\"../", &format!("\"{}", config("")));
    for (changed, words) in [
        (base.replace("seed = ", "sed = "), ["bad.toml", "`sed`"]),
        (base.replace("[rejection]", "[rejections]"), ["bad.toml", "`rejections`"]),
        (base.replace("seed = ", "seed = = "), ["bad.toml", "seed"]),
        (
            base.lines().filter(|line| !line.starts_with("seed")).collect::<Vec<_>>().join("\n"),
            ["bad.toml", "`seed`"],
        ),
    ] {
        folder.write("bad.toml", &changed);
        folder.run("dataset generate bad.toml --out data").fails(2, &words);
    }
    assert!(!folder.path("data").exists(), "nothing is written before the configuration has been checked");
    let train = config("train/approach.toml");
    folder
        .run(&format!("train {train} --out run --set optimizer.batch=0"))
        .fails(2, &["optimizer.batch = 0"]);
    folder
        .run(&format!("train {train} --out run --set network.trunk=resnet"))
        .fails(2, &["resnet", "flownet_s"]);
    folder
        .run(&format!("train {} --out run --set network.trunk=flownet_c", config("train/avoid.toml")))
        .fails(2, &["network.trunk", "flownet_c", "one image"]);
    let table1 = config("eval/oracle.toml");
    folder.run(&format!("eval {table1} --out e --set servo.gain=0")).fails(2, &["servo.gain = 0"]);
}

#[test]
fn scenes_that_cannot_be_placed_or_reached() {
    let folder = Folder::new();
    let bounded = "--set rejection.tries=50";
    let far = dataset(&format!("{bounded} --set target.x_mm=[900.0,900.0]"));
    let refused = folder.run(&far);
    refused.fails(1, &["no acceptable scene", "rejection.tries", "reach"]);
    assert_eq!(refused.stderr().matches("no acceptable scene").count(), 1, "the error is reported once");
    let crowded = dataset(&format!("{bounded} --set obstacles.count=[30,30]"));
    folder.run(&crowded).fails(1, &["no acceptable scene", "too close to the target or each other"]);
    assert!(!folder.path("data/dataset.json").exists());
}

#[test]
fn damaged_and_foreign_datasets() {
    let folder = Folder::new();
    folder.run("dataset info nowhere").fails(1, &["nowhere", "dataset.json"]);
    folder.run(&dataset("")).ok();
    folder.run(&dataset("--set seed=99")).fails(1, &["another configuration"]);
    let train = format!("train {} --data data --out run", config("train/approach.toml"));
    let tiny = "--set network.width=0.02 --set network.head=8 --set network.input=[32,24] --set optimizer.batch=2 \
                --set validation=0.5 --set phases.0.epochs=1";
    folder.run(&format!("{train} --set network.input=[64,48]")).fails(1, &["64", "32"]);
    let avoid =
        format!("train {} --data data --out run --set network.input=[32,24]", config("train/avoid.toml"));
    folder.run(&avoid).fails(1, &["data", "approach", "avoidance"]);
    folder.run(&format!("{train} {tiny} --resume")).fails(1, &["run", "resume"]);
    let shard = folder.path("data/data/train-00000-of-00001.parquet");
    let whole = std::fs::read(&shard).unwrap();
    for damaged in [&whole[..whole.len() - 20], b"not a Parquet file"] {
        std::fs::write(&shard, damaged).unwrap();
        folder.run(&format!("{train} {tiny}")).fails(1, &["train-00000-of-00001.parquet"]);
    }
    std::fs::write(&shard, whole).unwrap();
    folder.run(&format!("{train} {tiny}")).ok();
    folder.run(&format!("{train} {tiny}")).fails(1, &["run", "--resume"]);
}

#[test]
fn a_loss_that_is_not_a_number() {
    let folder = Folder::new();
    folder.run(&dataset("--set count=8")).ok();
    let wild = "--set network.width=0.02 --set network.head=8 --set network.input=[32,24] --set optimizer.batch=2 \
                --set validation=0.5 --set phases.0.epochs=400 --set phases.0.learning_rate=1.0 \
                --set phases.0.warmup=0.0 --set optimizer.weight_decay=0.0";
    let train = format!("train {} --data data --out run {wild}", config("train/approach.toml"));
    folder.run(&train).fails(1, &["epoch", "batch", "learning_rate"]);
}

#[test]
fn missing_and_unsuitable_models() {
    let folder = Folder::new();
    let eval = format!("eval {} --out e --set sessions=1", config("eval/table1.toml"));
    folder.run(&eval).fails(
        2,
        &["no model `approach`: not a checkpoint folder", "there is no registry at `models`", "model init"],
    );
    folder.write("empty/readme.txt", "not a checkpoint");
    folder
        .run(&format!("{eval} --approach empty --avoid oracle"))
        .fails(2, &["no model `empty`: the folder has no model.json"]);
    let tiny = "--set network.width=0.02 --set network.head=8 --set network.input=[32,24] --set optimizer.batch=2 \
                --set validation=0.5 --set phases.0.epochs=1";
    folder.run(&dataset("")).ok();
    folder.run(&format!("train {} --data data --out run {tiny}", config("train/approach.toml"))).ok();
    let camera = "--set world.camera.width=32 --set world.camera.height=24";
    let swapped = format!("{eval} {camera} --approach oracle --avoid run/best");
    folder.run(&swapped).fails(1, &["run/best", "avoidance"]);
    let other = format!(
        "{eval} {camera} --set world.camera.horizontal_fov_deg=50 --approach run/best --avoid oracle"
    );
    folder.run(&other).fails(1, &["run/best", "horizontal_fov_deg"]);
    let weights = folder.path("run/best/weights.safetensors");
    let mut bytes = std::fs::read(&weights).unwrap();
    *bytes.last_mut().unwrap() ^= 1;
    std::fs::write(&weights, bytes).unwrap();
    let damaged = format!("{eval} {camera} --approach run/best --avoid oracle");
    folder.run(&damaged).fails(1, &["weights.safetensors"]);
}

#[cfg(not(any(feature = "wgpu-software", feature = "cuda")))]
#[test]
fn a_missing_device() {
    let folder = Folder::new();
    for device in ["wgpu", "cuda"] {
        let eval = format!("eval {} --out e --device {device}", config("eval/oracle.toml"));
        folder.run(&eval).fails(2, &[device, &format!("--features {device}"), "--device cpu"]);
    }
}

#[test]
fn a_folder_that_cannot_be_written() {
    let folder = Folder::new();
    folder.write("file", "not a folder");
    let into = |out: &str| dataset("").replace("--out data", &format!("--out {out}"));
    folder.run(&into("file/data")).fails(1, &["file/data"]);
    let eval = format!("eval {} --out file/e --set sessions=1", config("eval/oracle.toml"));
    folder.run(&eval).fails(1, &["file/e"]);
}

#[test]
fn a_closed_pipe() {
    let folder = Folder::new();
    // The work is done even if nobody reads the progress.
    folder.run_unread(&dataset(""), true).fails(141, &[]);
    assert!(folder.path("data/dataset.json").exists());
    let unread = folder.run_unread("dataset info data", false);
    unread.fails(141, &[]);
    assert_eq!(unread.stderr(), "");
    folder.run_unread("model verify --registry models", true).fails(1, &[]);
}
