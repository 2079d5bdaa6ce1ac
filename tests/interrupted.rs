//! Ctrl-C, SIGKILL and a full disk: finished work is kept, and the same command resumes.

use crate::support::{Folder, repository};
use serde_json::Value;
use std::collections::BTreeSet;
use std::fs;
use std::path::Path;

fn generate(count: usize) -> String {
    let config = repository().join("configs/datasets/a.toml");
    format!(
        "dataset generate {} --out data --json --set count={count} --set rows_per_shard=128 \
         --set world.camera.width=160 --set world.camera.height=120",
        config.display()
    )
}

#[test]
fn a_dataset_resumes_after_ctrl_c() {
    let folder = Folder::new();
    folder.run(&format!("{} --shard 1/32", generate(4096))).ok();
    // The program waits for the lock on this record, so that it cannot get further before Ctrl-C.
    let held = folder.hold("data/shards/train-00003-of-00032.json");
    let reached = folder.path("data/data/train-00003-of-00032.parquet");
    let stopped = folder.run_and_interrupt(&generate(4096), || reached.exists(), || drop(held));
    stopped.fails(1, &["stopped after", "of 32 files finished; the same command continues"]);
    folder.run("dataset verify data").fails(1, &["of 32 files are finished", "data/config.toml --out data"]);
    assert!(!folder.path("data/dataset.json").exists(), "an incomplete dataset must not look complete");
    let result = folder.run(&generate(4096)).ok().json();
    assert_eq!(result["rows_made"], 4096 - 4 * 128);
    let whole = Folder::new();
    let undisturbed = whole.run(&generate(4096)).ok().json();
    assert_eq!(result["digest"], undisturbed["digest"]);
}

/// Generates a dataset of tiny images in 48 files of two row groups each.
fn generate_many(out: &str) -> String {
    let config = repository().join("configs/datasets/a.toml");
    format!(
        "dataset generate {} --out {out} --json --set count=7680 --set rows_per_shard=160 \
         --set world.camera.width=32 --set world.camera.height=24",
        config.display()
    )
}

/// Names in a folder with this ending.
fn names(folder: &Path, end: &str) -> BTreeSet<String> {
    let Ok(entries) = fs::read_dir(folder) else { return BTreeSet::new() };
    let names = entries.map(|entry| entry.unwrap().file_name().into_string().unwrap());
    names.filter(|name| name.ends_with(end)).collect()
}

/// Moment at which the generation of a dataset is killed.
#[derive(Debug)]
enum Moment {
    /// When the next file reaches this size, in blocks of 512 bytes.
    AtSize(u32),
    /// When the next file is finished, and the one after it is complete but has no record.
    BeforeRecord,
}

#[test]
fn a_killed_dataset_resumes_and_ends_with_the_same_bytes() {
    use std::os::unix::fs::MetadataExt as _;
    let folder = Folder::new();
    let (data, records) = (folder.path("data/data"), folder.path("data/shards"));
    // A file that is written again has a different inode.
    let inode = |record: &String| {
        let file = data.join(record.replace(".json", ".parquet"));
        (record.clone(), fs::metadata(file).unwrap().ino())
    };
    let mut committed: BTreeSet<(String, u64)> = BTreeSet::new();
    for round in 0..24 {
        let moment = if round % 2 == 0 { Moment::AtSize(round * 20) } else { Moment::BeforeRecord };
        let killed = match moment {
            Moment::AtSize(blocks) => folder.run_and_kill_at_size(blocks, &generate_many("data")),
            Moment::BeforeRecord => {
                let name = format!("train-{:05}-of-00048", committed.len() + 1);
                let _held = folder.hold(&format!("data/shards/{name}.json"));
                let file = data.join(format!("{name}.parquet"));
                folder.run_and_kill(&generate_many("data"), || file.exists())
            }
        };
        assert!(killed, "round {round}: finished before {moment:?}");
        let now: BTreeSet<_> = names(&records, ".json").iter().map(inode).collect();
        assert!(committed.is_subset(&now), "{moment:?}: a finished file is gone or was written again");
        match moment {
            Moment::AtSize(0) => {}
            Moment::AtSize(_) => assert_eq!(names(&data, ".partial").len(), 1),
            Moment::BeforeRecord => assert_eq!(now.len(), committed.len() + 1),
        }
        committed = now;
    }
    let rest = folder.run(&format!("{} --shard 1/1", generate_many("data"))).ok().json();
    assert_eq!(rest["rows_made"], 7680 - 160 * committed.len() as u64);
    // Kills before the card is written, and before the manifest is.
    for (written, held) in [("shards", "README.md"), ("README.md", "dataset.json")] {
        let (_held, written) = (folder.hold(&format!("data/{held}")), folder.path("data").join(written));
        assert!(folder.run_and_kill(&generate_many("data"), || written.exists()));
        assert!(!folder.path("data").join(held).exists());
    }
    assert_eq!(folder.run(&generate_many("data")).ok().json()["rows_made"], 0);
    for (record, inode) in &committed {
        let file = data.join(record.replace(".json", ".parquet"));
        assert_eq!(fs::metadata(file).unwrap().ino(), *inode, "the file of {record} was written again");
    }
    folder.run(&generate_many("whole")).ok();
    assert!(folder.files("data") == folder.files("whole"));
}

#[test]
fn half_written_files_do_not_block() {
    let folder = Folder::new();
    folder.run(&generate_many("whole")).ok();
    folder.run(&format!("{} --shard 1/2", generate_many("data"))).ok();
    for name in
        [".config.toml.partial", "data/.train-00001-of-00048.parquet.partial", ".dataset.json.partial"]
    {
        folder.write(&format!("data/{name}"), "what a killed process left");
    }
    // Truncated records, of a file that exists and of one that does not, and a file without a record.
    let record = fs::read_to_string(folder.path("data/shards/train-00002-of-00048.json")).unwrap();
    for i in [2, 3] {
        folder.write(&format!("data/shards/train-{i:05}-of-00048.json"), &record[..record.len() / 2]);
    }
    fs::remove_file(folder.path("data/shards/train-00004-of-00048.json")).unwrap();
    folder.run("dataset finish data").fails(
        1,
        &[
            "22 of 48 files are there",
            "train-00001-of-00048.parquet: missing",
            "train-00002-of-00048.parquet: no record in shards/",
            "train-00004-of-00048.parquet: no record in shards/",
        ],
    );
    let result = folder.run(&generate_many("data")).ok().json();
    assert_eq!(result["rows_made"], 160 * 26);
    assert!(folder.files("data") == folder.files("whole"));
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
fn training_resumes_after_ctrl_c_and_ends_with_the_same_weights() {
    let folder = Folder::new();
    folder.run(&generate(64)).ok();
    folder.interrupt_training("run", &train("run", 150)).fails(1, &["--resume"]);
    let resumed = folder.run(&format!("{} --resume", train("run", 150))).ok();
    assert!(resumed.stderr().contains("resumed after"), "{}", resumed.stderr());
    let undisturbed = folder.run(&train("other", 150)).ok().json();
    assert_eq!(resumed.json()["best"], undisturbed["best"]);
    let weights = |run: &str| fs::read(folder.path(run).join("last/weights.safetensors")).unwrap();
    assert!(weights("run") == weights("other"), "the weights must be bit-identical");
}

/// Moment at which a training run is killed.
#[derive(Debug)]
enum Due {
    /// At this checkpoint, counted from the start of the program.
    AtCheckpoint(u32),
    /// While this exists.
    While(&'static str),
}

#[test]
fn killed_training_resumes_and_ends_with_the_same_weights() {
    let folder = Folder::new();
    folder.run(&generate(64)).ok();
    let command = format!("{} --set checkpoint_steps=1", train("run", 30));
    let path = |name: &str| folder.path("run").join(name);
    let moments = [
        Due::AtCheckpoint(1),
        Due::While("last.partial"),
        Due::AtCheckpoint(2),
        Due::While("last.partial/optimizer.safetensors"),
        Due::While("best.partial"),
        Due::AtCheckpoint(5),
        Due::While("last.previous"),
    ];
    let mut tries = 0;
    let mut kills = 0;
    while kills < moments.len() {
        let (mut state, mut checkpoints) = (fs::read(path("last/training.json")).unwrap_or_default(), 0);
        let due = || {
            let now = fs::read(path("last/training.json")).unwrap_or_default();
            if !now.is_empty() && now != state {
                (state, checkpoints) = (now, checkpoints + 1);
            }
            // Each run of the program gets further than the one before.
            checkpoints > 0
                && match moments[kills] {
                    Due::AtCheckpoint(number) => checkpoints >= number,
                    Due::While(name) => path(name).exists(),
                }
        };
        let resume = if path("last").exists() || path("last.previous").exists() { " --resume" } else { "" };
        if folder.run_and_kill(&format!("{command}{resume}"), due) {
            kills += 1;
            // A crash of the machine can also leave these.
            folder.write("run/last.partial/weights.safetensors", "half a fi");
            let torn = fs::read_to_string(path("metrics.jsonl")).unwrap() + "{\"epoch\":99,\"tra";
            folder.write("run/metrics.jsonl", &torn);
        } else {
            // The run finished before it could be killed.
            fs::remove_dir_all(folder.path("run")).unwrap();
            tries += 1;
            assert!(tries < 20, "finished 20 times before {:?}", moments[kills]);
        }
    }
    folder.run(&format!("{command} --resume")).ok();
    folder.run(&train("other", 30)).ok();
    for file in ["last/weights.safetensors", "last/model.json", "best/weights.safetensors", "best/model.json"]
    {
        let [resumed, undisturbed] =
            ["run", "other"].map(|run| fs::read(folder.path(run).join(file)).unwrap());
        assert!(resumed == undisturbed, "{file} differs");
    }
    assert_eq!(metrics(&folder, "run"), metrics(&folder, "other"));
}

/// The lines of `metrics.jsonl` without measurements of time and memory.
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
fn a_full_disk_is_an_error_and_the_same_command_resumes() {
    let folder = Folder::new();
    let name = "data/data/train-00000-of-00002.parquet";
    folder.run_with_little_space(64, &generate(256)).fails(1, &[name, "File too large"]);
    assert!(!folder.path("data/dataset.json").exists());
    folder.run(&generate(256)).ok();
    folder.run("dataset verify data").ok();
}

#[cfg(target_os = "linux")]
#[test]
fn a_full_disk_is_an_error_for_every_file() {
    let folder = Folder::new();
    folder.run(&generate(256).replace("--out data", "--out whole")).ok();
    let mut made = Vec::new();
    for name in [
        "config.toml",
        "shards/train-00000-of-00002.json",
        "shards/train-00001-of-00002.json",
        "README.md",
        "dataset.json",
    ] {
        // The partial file leads to a full device.
        let (inside, file) = name.rsplit_once('/').unwrap_or(("", name));
        let inside = folder.path("data").join(inside);
        fs::create_dir_all(&inside).unwrap();
        std::os::unix::fs::symlink("/dev/full", inside.join(format!(".{file}.partial"))).unwrap();
        folder.run(&generate(256)).fails(1, &[&format!("data/{name}"), "No space left on device"]);
        assert!(!folder.path("data/dataset.json").exists());
        made.push(names(&folder.path("data/shards"), ".json").len());
    }
    assert_eq!(made, [0, 0, 1, 2, 2], "committed files are kept");
    assert_eq!(folder.run(&generate(256)).ok().json()["rows_made"], 0);
    assert!(folder.files("data") == folder.files("whole"));
}
