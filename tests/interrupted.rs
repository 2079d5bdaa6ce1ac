//! Ctrl-C and a full disk: what is finished stays, and the same command goes on.

use crate::support::{Folder, repository};

fn generate(count: usize) -> String {
    let config = repository().join("configs/datasets/a.toml");
    format!(
        "dataset generate {} --out data --json --set count={count} --set rows_per_shard=128 \
         --set world.camera.width=160 --set world.camera.height=120",
        config.display()
    )
}

#[test]
fn a_dataset_goes_on_after_ctrl_c() {
    let folder = Folder::new();
    let stopped = folder.run_until("data/data/train-00000-of-00032.parquet", &generate(4096));
    stopped.fails(1, &["stopped after", "the same command continues"]);
    assert!(!folder.path("data/dataset.json").exists(), "an incomplete dataset must not look complete");
    let result = folder.run(&generate(4096)).ok().json();
    let made = result["rows_made"].as_u64().unwrap();
    assert!(made > 0 && made < 4096, "{made} rows were made again");
    let whole = Folder::new();
    let undisturbed = whole.run(&generate(4096)).ok().json();
    assert_eq!(result["digest"], undisturbed["digest"]);
}

#[test]
fn training_goes_on_after_ctrl_c_and_ends_alike() {
    let folder = Folder::new();
    folder.run(&generate(64)).ok();
    let config = repository().join("configs/train/approach.toml");
    let train = |out: &str| {
        format!(
            "train {} --data data --out {out} --device cpu --json --set network.width=0.02 --set network.head=8 \
             --set network.input=[32,24] --set optimizer.batch=4 --set validation=0.25 --set optimizer.epochs=150",
            config.display()
        )
    };
    folder.run_until("run/last", &train("run")).fails(1, &["--resume"]);
    let resumed = folder.run(&format!("{} --resume", train("run"))).ok().json();
    let undisturbed = folder.run(&train("other")).ok().json();
    assert_eq!(resumed["best"], undisturbed["best"]);
    let weights = |run: &str| std::fs::read(folder.path(run).join("last/weights.safetensors")).unwrap();
    assert!(weights("run") == weights("other"), "the same weights to the bit");
}

#[test]
fn a_full_disk_is_an_error_and_the_same_command_goes_on() {
    let folder = Folder::new();
    folder.run_with_little_space(64, &generate(256)).fails(1, &["data/data"]);
    assert!(!folder.path("data/dataset.json").exists());
    folder.run(&generate(256)).ok();
    folder.run("dataset verify data").ok();
}
