//! Ctrl-C, SIGKILL and a full disk: what is finished stays, and the same command goes on.

use crate::support::{Folder, repository};
use serde_json::Value;
use std::collections::BTreeSet;
use std::fs;
use std::path::Path;
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
    stopped.fails(1, &["stopped after", "of 32 files finished; the same command continues"]);
    folder.run("dataset verify data").fails(1, &["of 32 files are finished", "data/config.toml --out data"]);
    assert!(!folder.path("data/dataset.json").exists(), "an incomplete dataset must not look complete");
    let result = folder.run(&generate(4096)).ok().json();
    let made = result["rows_made"].as_u64().unwrap();
    assert!(made > 0 && made < 4096, "{made} rows were made again");
    let whole = Folder::new();
    let undisturbed = whole.run(&generate(4096)).ok().json();
    assert_eq!(result["digest"], undisturbed["digest"]);
}

/// A dataset of 48 files of two groups of tiny images.
fn generate_many(out: &str) -> String {
    let config = repository().join("configs/datasets/a.toml");
    format!(
        "dataset generate {} --out {out} --json --set count=7680 --set rows_per_shard=160 \
         --set world.camera.width=32 --set world.camera.height=24",
        config.display()
    )
}

/// Names in a folder of the dataset that end so.
fn names(folder: &Path, end: &str) -> BTreeSet<String> {
    let Ok(entries) = fs::read_dir(folder) else { return BTreeSet::new() };
    let names = entries.map(|entry| entry.unwrap().file_name().into_string().unwrap());
    names.filter(|name| name.ends_with(end)).collect()
}

/// When to kill the making of a dataset.
#[derive(Debug)]
enum Step {
    /// So long after it began.
    After(Duration),
    /// In the midst of a file, of which a group is written.
    Within,
    /// When a file has got its name, and not yet its record.
    Named,
    /// When a file is finished.
    Recorded,
}

#[cfg(unix)]
#[test]
fn a_dataset_goes_on_after_being_killed_at_any_moment_and_ends_alike() {
    use std::os::unix::fs::MetadataExt as _;
    let folder = Folder::new();
    let (data, records) = (folder.path("data/data"), folder.path("data/shards"));
    let finished = || names(&records, ".json");
    // The file that a record is of. Made again, it would be another.
    let inode = |record: &String| {
        let file = data.join(record.replace(".json", ".parquet"));
        (record.clone(), fs::metadata(file).unwrap().ino())
    };
    let (mut kills, mut within, mut random) = (0, 0, 7_u64);
    let mut committed: BTreeSet<(String, u64)> = BTreeSet::new();
    for round in 0..28 {
        random = random.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        let step = match round % 4 {
            0 => Step::After(Duration::from_micros((random >> 33) % 150_000)),
            1 => Step::Within,
            2 => Step::Named,
            _ => Step::Recorded,
        };
        let (begun, before) = (Instant::now(), (finished().len(), names(&data, ".parquet").len()));
        let killed = folder.run_and_kill(&generate_many("data"), || match step {
            Step::After(delay) => begun.elapsed() >= delay,
            Step::Within => names(&data, ".partial")
                .iter()
                .any(|name| fs::metadata(data.join(name)).is_ok_and(|partial| partial.len() > 1000)),
            Step::Named => names(&data, ".parquet").len() > before.1,
            Step::Recorded => finished().len() > before.0,
        });
        assert!(killed, "round {round}: the dataset was finished before {step:?}");
        kills += 1;
        within += usize::from(!names(&data, ".partial").is_empty());
        let now = finished().iter().map(inode).collect();
        assert!(committed.is_subset(&now), "{step:?}: what was finished is gone or was made again");
        committed = now;
    }
    assert!(within >= 5, "{within} of {kills} kills were in the midst of a file");
    kills += kill_at_the_end(&folder);
    let result = folder.run(&generate_many("data")).ok().json();
    assert!(result["rows_made"].as_u64().unwrap() <= 7680 - 160 * committed.len() as u64);
    for (record, inode) in &committed {
        let file = data.join(record.replace(".json", ".parquet"));
        assert_eq!(fs::metadata(file).unwrap().ino(), *inode, "{record} was made again");
    }
    folder.run(&generate_many("whole")).ok();
    assert!(folder.files("data") == folder.files("whole"), "differs after {kills} kills");
}

/// Kills the run that has all files, in the midst of what it writes last; returns how often.
#[cfg(unix)]
fn kill_at_the_end(folder: &Folder) -> usize {
    let there = |name: &str| folder.path("data").join(name).exists();
    folder.run(&format!("{} --shard 1/1", generate_many("data"))).ok();
    let moments: [&dyn Fn() -> bool; 4] = [
        &|| there(".README.md.partial"),
        &|| there("README.md"),
        &|| there(".dataset.json.partial"),
        &|| there("dataset.json"),
    ];
    let kill = |moment: &&dyn Fn() -> bool| folder.run_and_kill(&generate_many("data"), moment);
    moments.iter().filter(|moment| kill(moment)).count()
}

#[test]
fn half_written_leftovers_do_not_block() {
    let folder = Folder::new();
    folder.run(&generate_many("whole")).ok();
    folder.run(&format!("{} --shard 1/2", generate_many("data"))).ok();
    for name in
        [".config.toml.partial", "data/.train-00001-of-00048.parquet.partial", ".dataset.json.partial"]
    {
        folder.write(&format!("data/{name}"), "what a killed process left");
    }
    // Records cut short: of a file that is there, and of one that is not; and a file without a record.
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
    let name = "data/data/train-00000-of-00002.parquet";
    folder.run_with_little_space(64, &generate(256)).fails(1, &[name, "File too large"]);
    assert!(!folder.path("data/dataset.json").exists());
    folder.run(&generate(256)).ok();
    folder.run("dataset verify data").ok();
}

#[cfg(target_os = "linux")]
#[test]
fn a_full_disk_is_an_error_whatever_is_written() {
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
        // Where the file is written before it gets its name, nothing can be written.
        let (inside, file) = name.rsplit_once('/').unwrap_or(("", name));
        let inside = folder.path("data").join(inside);
        fs::create_dir_all(&inside).unwrap();
        std::os::unix::fs::symlink("/dev/full", inside.join(format!(".{file}.partial"))).unwrap();
        folder.run(&generate(256)).fails(1, &[&format!("data/{name}"), "No space left on device"]);
        assert!(!folder.path("data/dataset.json").exists());
        made.push(names(&folder.path("data/shards"), ".json").len());
    }
    assert_eq!(made, [0, 0, 1, 2, 2], "what was committed stays");
    assert_eq!(folder.run(&generate(256)).ok().json()["rows_made"], 0);
    assert!(folder.files("data") == folder.files("whole"));
}
