//! `flowservo dataset`: the same bytes however they are made, and what `info` and `verify` say of them.

use crate::support::{Folder, repository};
use std::path::Path;

/// Arguments that make a small dataset.
fn generate(config: &str, count: usize, out: &str) -> String {
    let configs = repository().join("configs/datasets").join(config);
    format!(
        "dataset generate {} --out {out} --json --set count={count} --set rows_per_shard=6 \
         --set world.camera.width=32 --set world.camera.height=24",
        configs.display()
    )
}

/// All files below a folder with their content.
fn files(folder: &Path) -> Vec<(String, Vec<u8>)> {
    let mut found = Vec::new();
    for entry in std::fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        if path.is_dir() {
            found.extend(files(&path));
        } else {
            found.push((path.display().to_string(), std::fs::read(&path).unwrap()));
        }
    }
    found.sort();
    found
}

#[test]
fn one_and_two_threads_write_the_same_bytes() {
    for config in ["c.toml", "avoid.toml"] {
        let [one, two] = [1, 2].map(|threads| {
            let folder = Folder::new();
            folder.run(&format!("{} --threads {threads}", generate(config, 14, "data"))).ok();
            let root = folder.path("data");
            let relative = |(path, bytes): (String, Vec<u8>)| {
                (path.strip_prefix(&root.display().to_string()).unwrap().to_owned(), bytes)
            };
            files(&root).into_iter().map(relative).collect::<Vec<_>>()
        });
        assert!(one.iter().any(|(path, _)| path.ends_with("data/train-00002-of-00003.parquet")));
        assert!(one == two, "{config}");
    }
}

#[test]
fn a_result_for_scripts_comes_on_the_last_line() {
    let folder = Folder::new();
    let result = folder.run(&generate("a.toml", 8, "data")).ok().json();
    assert_eq!((result["rows"].as_u64(), result["images"].as_u64()), (Some(8), Some(16)));
    for key in ["seconds", "images_per_s", "peak_rss_mb"] {
        assert!(result[key].as_f64().is_some_and(|value| value > 0.0), "{key} in {result}");
    }
    let again = folder.run(&generate("a.toml", 8, "data")).ok().json();
    assert_eq!((again["rows_made"].as_u64(), &again["digest"]), (Some(0), &result["digest"]));
    let used = std::fs::read_to_string(folder.path("data/config.toml")).unwrap();
    let used: datagen::DatasetConfig = toml::from_str(&used).unwrap();
    assert_eq!((used.count, used.world.camera.width), (8, 32));
}

#[test]
fn info_tells_and_verify_finds_a_flipped_byte() {
    let folder = Folder::new();
    folder.run(&generate("b.toml", 7, "data")).ok();
    let told = folder.run("dataset info data").ok().stdout();
    assert!(told.contains("7 in 2 files, 14 images") && told.contains("32 x 24 pixels"), "{told}");
    folder.run("dataset verify data").ok();
    let file = folder.path("data/data/train-00001-of-00002.parquet");
    let mut bytes = std::fs::read(&file).unwrap();
    let middle = bytes.len() / 2;
    bytes[middle] ^= 1;
    std::fs::write(&file, bytes).unwrap();
    folder.run("dataset verify data").fails(1, &["train-00001-of-00002.parquet", "SHA-256"]);
}

#[test]
fn a_row_is_made_again_and_compared() {
    let folder = Folder::new();
    folder.run(&generate("c.toml", 7, "data")).ok();
    let replayed = folder.run("dataset replay data 6 --out again --json").ok();
    assert!(replayed.stdout().contains("row        6 of approach_c"), "{}", replayed.stdout());
    let told = replayed.json();
    assert_eq!((&told["identical"], &told["row"]), (&true.into(), &6.into()));
    assert!(
        told["columns"].as_array().unwrap().iter().all(|column| column["difference"].is_null()),
        "{told}"
    );
    let image =
        |name: &str| std::fs::read(folder.path(&format!("again/00000006_image_goal_{name}.png"))).unwrap();
    assert!(image("made").starts_with(b"\x89PNG") && image("made") == image("stored"));

    // What another light would have made, said to be of another version.
    let description = folder.path("data/dataset.json");
    let told = std::fs::read_to_string(&description).unwrap();
    let brighter = told.replace("\"ambient\": 0.5", "\"ambient\": 0.75");
    assert_ne!(brighter, told);
    std::fs::write(&description, &brighter).unwrap();
    let other = folder.run("dataset replay data 6 --out again --json");
    let told = other.json();
    let column =
        |name| told["columns"].as_array().unwrap().iter().find(|column| column["column"] == name).unwrap();
    assert_eq!(column("image_goal")["difference"]["kind"], "pixels");
    assert!(column("joints_goal")["difference"].is_null());
    assert!(image("made") != image("stored"));
    other.fails(1, &["row 6 of data", "image_current, image_goal,", "dataset verify data"]);
    let version = format!("\"version\": \"{}\"", env!("CARGO_PKG_VERSION"));
    std::fs::write(&description, brighter.replace(&version, "\"version\": \"0.0.1\"")).unwrap();
    folder.run("dataset replay data 6").fails(1, &["written by flowservo 0.0.1"]);

    folder.run("dataset replay data 7").fails(1, &["rows 7 to 8 asked for, but the dataset has 7"]);
    std::fs::write(folder.path("data/data/train-00001-of-00002.parquet"), "short").unwrap();
    folder.run("dataset replay data 6").fails(1, &["train-00001-of-00002.parquet: expected"]);
    std::fs::remove_file(description).unwrap();
    folder.run("dataset replay data 6").fails(1, &["holds no complete dataset"]);
}
