//! The registry under stress: unsuitable locations, simultaneous publishers with readers in between, SIGKILL.
//!
//! `FLOWSERVO_RACES` and `FLOWSERVO_KILLS` set the number of rounds. The default is small.

use crate::models::checkpoint;
use crate::support::{Folder, Run, safetensors};
use serde_json::Value;
use std::collections::BTreeSet;
use std::fs;
use std::path::Path;
use std::sync::Barrier;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};

/// Reads a number from the environment.
fn rounds_of(variable: &str, default: usize) -> usize {
    std::env::var(variable).map_or(default, |text| text.parse().unwrap())
}

#[test]
fn a_registry_is_created_only_in_an_empty_folder() {
    let folder = Folder::new();
    assert_eq!(folder.run("model init --json").ok().json()["created"], true);
    let again = folder.run("model init --json").ok();
    assert_eq!(again.json()["created"], false);
    assert_eq!(folder.files("models").keys().collect::<Vec<_>>(), ["registry.json"]);
    folder.write("other/notes.txt", "mine");
    folder.run("model init --registry other").fails(1, &["other", "notes.txt", "empty or new folder"]);
    folder.run("model list --registry nowhere").fails(1, &["nowhere", "model init"]);
    folder.run("model init --registry gs://lab/models").fails(2, &["gs://lab/models", "s3://BUCKET/PREFIX"]);
}

#[cfg(not(feature = "s3"))]
#[test]
fn without_s3_the_error_explains_how_to_build_with_it() {
    let folder = Folder::new();
    for command in ["list", "init", "publish run approach"] {
        let run = folder.run(&format!("model {command} --registry s3://lab/models"));
        run.fails(2, &["s3://lab/models", "cargo build --release --features s3"]);
    }
}

/// Number of simultaneous publishers.
const PUBLISHERS: usize = 16;

/// Additional rounds allowed until publishers and reader have met.
const MOST_EXTRA_ROUNDS: usize = 50;

#[test]
fn simultaneous_publishers_each_get_a_version_and_readers_see_complete_ones() {
    let wanted = rounds_of("FLOWSERVO_RACES", 3);
    let folder = Folder::new();
    let weights = |round: usize, publisher: usize| format!("{round} {publisher} ").repeat(5000);
    let mut published = Vec::new();
    let (racing, pulls) = (AtomicBool::new(true), AtomicUsize::new(0));
    let (mut rounds, mut overlaps) = (0, 0);
    let seen = std::thread::scope(|scope| {
        // Stops the reader even if an assertion fails here.
        let _stop = OnDrop(|| racing.store(false, Ordering::Relaxed));
        let reader = scope.spawn(|| read_all_the_time(&folder, &racing, &pulls));
        // The scheduler may let one process after the other run to its end. Rounds without a race do not count.
        while rounds < wanted || overlaps == 0 || pulls.load(Ordering::Relaxed) == 0 {
            let round = rounds;
            assert!(
                round < wanted + MOST_EXTRA_ROUNDS,
                "{overlaps} overlaps and {pulls:?} pulls in {round} rounds"
            );
            for publisher in 0..PUBLISHERS {
                checkpoint(&folder, &format!("run{publisher}"), &weights(round, publisher));
            }
            let runs = publish_at_once(&folder);
            published.extend(runs.into_iter().enumerate().map(|(publisher, run)| {
                let version = run.ok().json()["version"].as_u64().unwrap();
                (version, safetensors(&weights(round, publisher)))
            }));
            rounds += 1;
            overlaps = self::overlaps(&folder, rounds * PUBLISHERS);
        }
        racing.store(false, Ordering::Relaxed);
        reader.join().unwrap()
    });
    published.sort();
    let numbers: Vec<_> = published.iter().map(|(version, _)| *version).collect();
    assert_eq!(numbers, (1..=(rounds * PUBLISHERS) as u64).collect::<Vec<_>>(), "distinct, and none lost");
    for (version, weights) in &published {
        let stored = stored_weights(&folder, *version);
        assert!(stored == weights.as_bytes(), "approach@{version} has the weights of another");
    }
    for (version, pulled) in &seen {
        assert!(
            published[*version as usize - 1].1.as_bytes() == pulled,
            "approach@{version} was half visible"
        );
    }
    folder.run("model verify").ok();
    assert_eq!(unnamed_blobs(&folder, rounds * PUBLISHERS), 0);
    eprintln!("{} versions, {overlaps} overlaps, {} pulled in the meantime", published.len(), seen.len());
}

/// Calls a function when dropped.
struct OnDrop<F: Fn()>(F);

impl<F: Fn()> Drop for OnDrop<F> {
    fn drop(&mut self) {
        self.0();
    }
}

fn publish_at_once(folder: &Folder) -> Vec<Run> {
    let start = Barrier::new(PUBLISHERS);
    let publish = |publisher: usize| {
        start.wait();
        folder.run(&format!("model publish run{publisher} approach --json"))
    };
    std::thread::scope(|scope| {
        let publish = &publish;
        let threads: Vec<_> =
            (0..PUBLISHERS).map(|publisher| scope.spawn(move || publish(publisher))).collect();
        threads.into_iter().map(|thread| thread.join().unwrap()).collect()
    })
}

/// Lists, verifies and pulls until the race is over. Returns the pulled versions with their weights.
fn read_all_the_time(folder: &Folder, racing: &AtomicBool, pulls: &AtomicUsize) -> Vec<(u64, Vec<u8>)> {
    let (mut seen, mut newest) = (Vec::new(), 0);
    while racing.load(Ordering::Relaxed) {
        let listed = folder.run("model list --json");
        if !listed.succeeded() {
            listed.fails(1, &["there is no registry at"]);
            continue;
        }
        let listed = listed.json();
        let Some(versions) = listed[0]["versions"].as_array() else { continue };
        let versions: Vec<_> = versions.iter().map(|version| version.as_u64().unwrap()).collect();
        assert_eq!(versions, (1..=versions.len() as u64).collect::<Vec<_>>());
        assert!(versions.len() >= newest, "a version is gone");
        newest = versions.len();
        folder.run("model verify approach").ok();
        let out = format!("pulled{}", seen.len());
        let pulled = folder.run(&format!("model pull approach --out {out} --json")).ok().json();
        let weights = fs::read(folder.path(&out).join("weights.safetensors")).unwrap();
        seen.push((pulled["version"].as_u64().unwrap(), weights));
        pulls.fetch_add(1, Ordering::Relaxed);
    }
    seen
}

/// Path of the pointer to a version of `approach`.
fn pointer(version: u64) -> String {
    format!("models/models/approach/versions/{version:06}")
}

/// Path of the blob with a digest.
fn blob(digest: &str) -> String {
    let hex = digest.trim_end().strip_prefix("sha256:").unwrap();
    format!("models/blobs/sha256/{}/{hex}", &hex[..2])
}

/// Path of the manifest of a version.
fn manifest_path(folder: &Folder, version: u64) -> String {
    blob(&fs::read_to_string(folder.path(&pointer(version))).unwrap())
}

/// Reads the manifest of a version.
fn manifest(folder: &Folder, version: u64) -> Value {
    serde_json::from_slice(&fs::read(folder.path(&manifest_path(folder, version))).unwrap()).unwrap()
}

/// Path of the blob that a descriptor names.
fn described(descriptor: &Value) -> String {
    blob(descriptor["digest"].as_str().unwrap())
}

/// Reads the weights of a version from the store.
fn stored_weights(folder: &Folder, version: u64) -> Vec<u8> {
    let manifest = manifest(folder, version);
    let layers = manifest["layers"].as_array().unwrap();
    let layer = layers.iter().find(|layer| layer["annotations"].to_string().contains("weights")).unwrap();
    fs::read(folder.path(&described(layer))).unwrap()
}

/// Counts the publications whose manifest was stored before the previous version got its number.
fn overlaps(folder: &Folder, versions: usize) -> usize {
    let modified = |path: &str| fs::metadata(folder.path(path)).unwrap().modified().unwrap();
    let overlaps =
        |version: &u64| modified(&manifest_path(folder, version + 1)) < modified(&pointer(*version));
    (1..versions as u64).filter(overlaps).count()
}

/// Counts the blobs that no version names.
fn unnamed_blobs(folder: &Folder, versions: usize) -> usize {
    let mut named = BTreeSet::new();
    for version in 1..=versions as u64 {
        let manifest = manifest(folder, version);
        named.extend(manifest["layers"].as_array().unwrap().iter().map(described));
        named.insert(described(&manifest["config"]));
    }
    folder.files("models/blobs").len() - named.len() - versions
}

/// The publication to kill.
const PUBLISH: &str = "model publish run approach";

/// Largest size at which a kill interrupts the writing of a large blob, in blocks of 512 bytes.
const LARGEST_PARTIAL: u32 = 9_000_000 / 512;

/// When to kill a publication.
#[derive(Debug, Clone, Copy)]
enum Moment {
    /// When it has written this much of a blob, in blocks of 512 bytes.
    Size(u32),
    /// When it has started to write a blob.
    Begun,
    /// When it has written this many files.
    Files(usize),
    /// When the version has its number.
    Numbered,
}

#[test]
fn a_publication_may_be_killed_at_any_moment() {
    let folder = Folder::new();
    folder.run("model init").ok();
    let versions = folder.path("models/models/approach/versions");
    let blobs = folder.path("models/blobs");
    let numbered = || entries(&versions, &|name| !name.contains('#'));
    let (mut kills, mut random, mut halves) = (0, 11_u64, 0);
    let wanted = rounds_of("FLOWSERVO_KILLS", 20);
    for round in 0.. {
        if kills == wanted {
            break;
        }
        // Every fourth kill is certain; a publication may finish before one of the others.
        assert!(round < 4 * wanted + 4, "{kills} kills in {round} rounds");
        random = random.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        let moment = match round % 8 {
            0 | 4 => Moment::Size((random >> 33) as u32 % LARGEST_PARTIAL),
            1 | 2 => Moment::Begun,
            7 => Moment::Numbered,
            more => Moment::Files(more - 2),
        };
        let size = if matches!(moment, Moment::Size(_)) || round % 3 == 0 { 10_000_000 } else { 1000 };
        checkpoint(&folder, "run", &format!("{round:09}\n").repeat(size / 10));
        let before = (entries(&blobs, &|_| true), numbered());
        let kill_when = |now: &mut dyn FnMut() -> bool| folder.run_and_kill(PUBLISH, now);
        let killed = match moment {
            Moment::Size(blocks) => folder.run_and_kill_at_size(blocks, PUBLISH),
            Moment::Begun => kill_when(&mut || entries(&blobs, &|name| name.contains('#')) > halves),
            Moment::Files(more) => kill_when(&mut || entries(&blobs, &|_| true) >= before.0 + more),
            Moment::Numbered => kill_when(&mut || numbered() > before.1),
        };
        kills += usize::from(killed);
        halves = entries(&blobs, &|name| name.contains('#'));
        folder.run("model verify").ok();
        assert!(numbered() <= before.1 + 1);
        let again = folder.run("model publish run approach --json").ok().json();
        assert_eq!(again["version"].as_u64().unwrap() as usize, before.1 + 1, "after {moment:?}");
        assert_eq!(numbered(), before.1 + 1);
    }
    folder.run("model verify").ok();
    assert!(halves > 0, "no kill interrupted the writing of a blob");
    eprintln!("{kills} kills, {halves} half-written blobs left, {} versions", numbered());
}

/// Counts the files below a folder with matching names.
fn entries(folder: &Path, matches: &dyn Fn(&str) -> bool) -> usize {
    let Ok(found) = fs::read_dir(folder) else { return 0 };
    let count = |entry: fs::DirEntry| match entry.file_type() {
        Ok(kind) if kind.is_dir() => entries(&entry.path(), matches),
        _ => usize::from(matches(&entry.file_name().to_string_lossy())),
    };
    found.filter_map(Result::ok).map(count).sum()
}
