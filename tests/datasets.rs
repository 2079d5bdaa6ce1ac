//! `flowservo dataset`: the same bytes however they are made, and what `info` and `verify` say of them.

use crate::support::{Folder, repository};
use approx::assert_relative_eq;
use datagen::row::Row;
use datagen::{ApproachRow, AvoidanceRow, DatasetReader, SceneRow};
use std::path::Path;
use world::LabelForm;

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

/// The rows of a dataset.
fn rows<R: Row>(folder: &Path) -> Vec<R> {
    DatasetReader::open(folder).unwrap().all().unwrap().collect::<Result<_, _>>().unwrap()
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

#[test]
fn info_describes_approaches_in_words_and_numbers() {
    let folder = Folder::new();
    folder.run(&generate("c.toml", 14, "data")).ok();
    let told = folder.run("dataset info data --json").ok();
    let text = told.stdout();
    for words in [
        "3 files",
        "range 2b to range 2b",
        "(asked 50.0 %)",
        "cuboid",
        "obstacles",
        "joint 6",
        "nearer to a limit",
    ] {
        assert!(text.contains(words), "{words:?} in\n{text}");
    }
    // A page of a terminal; the last line is for scripts.
    assert!(text.lines().count() <= 41, "{} lines", text.lines().count());
    let statistics = &told.json()["statistics"];
    let rows: Vec<ApproachRow> = rows(&folder.path("data"));
    let lengths: Vec<f64> = rows
        .iter()
        .map(|row| LabelForm::Twist.label(&row.robot_from_current, &row.robot_from_goal).translation.norm())
        .collect();
    let found = &statistics["labels"]["twist"]["translation_m"];
    assert_relative_eq!(found["mean"].as_f64().unwrap(), lengths.iter().sum::<f64>() / 14.0, epsilon = 1e-9);
    assert_relative_eq!(
        found["max"].as_f64().unwrap(),
        lengths.iter().copied().fold(0.0, f64::max),
        epsilon = 1e-9
    );
    assert!(text.contains(&format!("{:9.2}", lengths.iter().copied().fold(0.0, f64::max) * 1e3)), "{text}");
    let files = files(&folder.path("data/data"));
    let size: usize = files.iter().map(|(_, bytes)| bytes.len()).sum();
    assert_eq!(statistics["bytes"]["total"].as_u64(), Some(size as u64));
}

#[test]
fn info_describes_avoidance_maps() {
    let folder = Folder::new();
    folder.run(&generate("avoid.toml", 12, "data")).ok();
    let told = folder.run("dataset info data --json").ok();
    let values: Vec<f32> =
        rows::<AvoidanceRow>(&folder.path("data")).into_iter().flat_map(|row| row.values).collect();
    let free = values.iter().filter(|&&value| value == 0.0).count() as f64 / values.len() as f64;
    let found = &told.json()["statistics"]["labels"]["values"];
    assert_relative_eq!(found["free"].as_f64().unwrap(), free, epsilon = 1e-12);
    let text = told.stdout();
    assert!(text.contains(&format!("free (0) {:.1} %", free * 100.0)), "{text}");
    assert!(text.lines().count() <= 41, "{} lines", text.lines().count());
}

#[test]
fn show_draws_the_rows_that_are_asked_for() {
    let folder = Folder::new();
    folder.run(&generate("c.toml", 14, "data")).ok();
    let drawing = |file: &str| std::fs::read_to_string(folder.path(file)).unwrap();
    let shown = folder.run("dataset show data --rows 13,0,5 --json").ok();
    let result = shown.json();
    assert_eq!(
        (&result["sheet"], &result["rows"]),
        (&"approach_c-sheet.svg".into(), &serde_json::json!([13, 0, 5]))
    );
    let sheet = drawing("approach_c-sheet.svg");
    assert_eq!(sheet.matches("data:image/png;base64,").count(), 6);
    let places: Vec<_> = [13, 0, 5].map(|row| sheet.find(&format!(">row {row}<"))).into();
    assert!(places.is_sorted() && places[0].is_some(), "{places:?}");
    folder.run("dataset show data").ok();
    assert_eq!(drawing("approach_c-sheet.svg").matches("data:image/png;base64,").count(), 24);
    let [seven, again, eight] = [7, 7, 8].map(|seed| {
        folder.run(&format!("dataset show data --count 3 --seed {seed} --out some/drawn.svg")).ok();
        drawing("some/drawn.svg")
    });
    assert!(seven == again && seven != eight);
    folder.run("dataset show data --rows 3,14").fails(2, &["--rows 14", "rows 0 to 13"]);
    folder.run("dataset show data --rows 3 --seed 1").fails(2, &["--rows", "--seed"]);
    folder.run("dataset show nowhere").fails(1, &["nowhere", "dataset.json"]);
}

#[test]
fn show_draws_avoidance_maps() {
    let folder = Folder::new();
    folder.run(&generate("avoid.toml", 7, "data")).ok();
    folder.run("dataset show data").ok();
    let sheet = std::fs::read_to_string(folder.path("avoidance-sheet.svg")).unwrap();
    assert_eq!(sheet.matches("data:image/png;base64,").count(), 7);
    // All measuring points, the rims of two hemispheres, and two circles for a ring.
    let circles = sheet.matches("<circle").count();
    let scenes: Vec<SceneRow> = rows(&folder.path("data"));
    let obstacles: usize = scenes.iter().map(|row| row.scene.obstacles.len()).sum();
    let rings = sheet.matches("fill=\"none\" stroke=\"#0072b2\"").count();
    assert_eq!(rings, obstacles);
    assert_eq!(circles, 7 * (180 + 2) + 2 * obstacles);
}
