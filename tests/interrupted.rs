//! Ctrl-C and a full disk: what is finished stays, and the same command goes on.

use crate::support::{Folder, repository};
use serde_json::Value;
use std::fs;
use std::time::{Duration, Instant};

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

/// Trains a tiny network on `data`.
fn train(out: &str, epochs: usize) -> String {
    let config = repository().join("configs/train/approach.toml");
    format!(
        "train {} --data data --out {out} --device cpu --json --set network.width=0.02 --set network.head=8 \
         --set network.input=[32,24] --set optimizer.batch=4 --set validation=0.25 --set phases.0.epochs={epochs}",
        config.display()
    )
}

#[test]
fn training_goes_on_after_ctrl_c_and_ends_alike() {
    let folder = Folder::new();
    folder.run(&generate(64)).ok();
    folder.run_until("run/last", &train("run", 150)).fails(1, &["--resume"]);
    let resumed = folder.run(&format!("{} --resume", train("run", 150))).ok();
    assert!(resumed.stderr().contains("resumed after"), "{}", resumed.stderr());
    let undisturbed = folder.run(&train("other", 150)).ok().json();
    assert_eq!(resumed.json()["best"], undisturbed["best"]);
    let weights = |run: &str| fs::read(folder.path(run).join("last/weights.safetensors")).unwrap();
    assert!(weights("run") == weights("other"), "the same weights to the bit");
}

/// When to kill a run.
enum Moment {
    /// So long after it got further than the run before.
    After(Duration),
    /// While this is there.
    While(&'static str),
}

#[cfg(unix)]
#[test]
fn training_goes_on_after_being_killed_at_any_moment_and_ends_alike() {
    let folder = Folder::new();
    folder.run(&generate(64)).ok();
    let killed = format!("{} --set checkpoint_steps=1", train("run", 30));
    let state = || fs::read(folder.path("run/last/training.json")).unwrap_or_default();
    let moments = [
        Moment::After(Duration::ZERO),
        Moment::While("last.partial"),
        Moment::After(Duration::from_millis(7)),
        Moment::While("last.partial/optimizer.safetensors"),
        Moment::While("best.partial"),
        Moment::After(Duration::from_millis(31)),
        Moment::While("last.previous"),
    ];
    let mut kills = 0;
    for moment in moments {
        let there = ["run/last", "run/last.previous"].iter().any(|name| folder.path(name).exists());
        let (before, mut further) = (state(), None);
        let due = || {
            if further.is_none() {
                let now = state();
                further = (!now.is_empty() && now != before).then(Instant::now);
            }
            further.is_some_and(|since| match moment {
                Moment::After(delay) => since.elapsed() >= delay,
                Moment::While(name) => folder.path("run").join(name).exists(),
            })
        };
        let resume = if there { " --resume" } else { "" };
        kills += usize::from(folder.run_and_kill(&format!("{killed}{resume}"), due));
        // What a crash of the machine may leave besides.
        folder.write("run/last.partial/weights.safetensors", "half a fi");
        let torn = fs::read_to_string(folder.path("run/metrics.jsonl")).unwrap() + "{\"epoch\":99,\"tra";
        folder.write("run/metrics.jsonl", &torn);
    }
    assert!(kills >= 5, "the run was at its end after {kills} kills");
    folder.run(&format!("{killed} --resume")).ok();
    folder.run(&train("other", 30)).ok();
    for file in ["last/weights.safetensors", "last/model.json", "best/weights.safetensors", "best/model.json"]
    {
        let [resumed, undisturbed] =
            ["run", "other"].map(|run| fs::read(folder.path(run).join(file)).unwrap());
        assert!(resumed == undisturbed, "{file} differs after {kills} kills");
    }
    assert_eq!(metrics(&folder, "run"), metrics(&folder, "other"));
}

/// The lines of `metrics.jsonl` without what no two runs have the same.
fn metrics(folder: &Folder, run: &str) -> Vec<Value> {
    let text = fs::read_to_string(folder.path(run).join("metrics.jsonl")).unwrap();
    let untimed = |line: &str| {
        let mut line: Value = serde_json::from_str(line).unwrap();
        for key in ["seconds", "samples_per_s", "peak_memory_mb"] {
            line.as_object_mut().unwrap().remove(key).unwrap_or_else(|| panic!("{key} is missing"));
        }
        line
    };
    text.lines().map(untimed).collect()
}

#[test]
fn a_full_disk_is_an_error_and_the_same_command_goes_on() {
    let folder = Folder::new();
    folder.run_with_little_space(64, &generate(256)).fails(1, &["data/data"]);
    assert!(!folder.path("data/dataset.json").exists());
    folder.run(&generate(256)).ok();
    folder.run("dataset verify data").ok();
}
