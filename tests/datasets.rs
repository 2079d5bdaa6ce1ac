//! `flowservo dataset`: reproducible bytes, and the reports of the commands about them.

use crate::support::{Folder, Run, repository};
use approx::assert_relative_eq;
use datagen::row::Row;
use datagen::{ApproachRow, AvoidanceRow, DatasetReader, SceneRow};
use std::path::Path;
use world::LabelForm;

/// Arguments that generate a small dataset.
fn generate(config: &str, count: usize, out: &str) -> String {
    let configs = repository().join("configs/datasets").join(config);
    format!(
        "dataset generate {} --out {out} --json --set count={count} --set rows_per_shard=6 \
         --set world.camera.width=32 --set world.camera.height=24",
        configs.display()
    )
}

#[test]
fn one_and_two_threads_write_the_same_bytes() {
    for config in ["c.toml", "avoid.toml"] {
        let [one, two] = [1, 2].map(|threads| {
            let folder = Folder::new();
            folder.run(&format!("{} --threads {threads}", generate(config, 14, "data"))).ok();
            folder.files("data")
        });
        assert!(one.contains_key("data/train-00002-of-00003.parquet"));
        assert!(one == two, "{config}");
    }
}

#[test]
fn the_last_line_is_a_result_for_scripts() {
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

/// All rows of a dataset.
fn rows<R: Row>(folder: &Path) -> Vec<R> {
    DatasetReader::open(folder).unwrap().all().unwrap().collect::<Result<_, _>>().unwrap()
}

#[test]
fn info_reports_and_verify_finds_a_flipped_byte() {
    let folder = Folder::new();
    folder.run(&generate("b.toml", 7, "data")).ok();
    let reported = folder.run("dataset info data").ok().stdout();
    assert!(
        reported.contains("7 in 2 files, 14 images") && reported.contains("32 x 24 pixels"),
        "{reported}"
    );
    folder.run("dataset verify data").ok();
    let file = folder.path("data/data/train-00001-of-00002.parquet");
    let mut bytes = std::fs::read(&file).unwrap();
    let middle = bytes.len() / 2;
    bytes[middle] ^= 1;
    std::fs::write(&file, bytes).unwrap();
    folder.run("dataset verify data").fails(1, &["train-00001-of-00002.parquet", "SHA-256"]);
}

/// The manifest with a part replaced and a matching seal.
fn resealed(description: &Path, [found, replaced]: [&str; 2]) -> String {
    let reported = std::fs::read_to_string(description).unwrap();
    assert!(reported.contains(found), "{found} in\n{reported}");
    let seal: serde_json::Value = serde_json::from_str(&reported).unwrap();
    let unsealed = reported.replace(found, replaced).replace(seal["seal"].as_str().unwrap(), "");
    let seal = datagen::digest::digest(unsealed.as_bytes());
    unsealed.replace("\"seal\": \"\"", &format!("\"seal\": \"{seal}\""))
}

#[test]
fn a_row_is_regenerated_and_compared() {
    let folder = Folder::new();
    folder.run(&generate("c.toml", 7, "data")).ok();
    let replayed = folder.run("dataset replay data 6 --out again --json").ok();
    assert!(replayed.stdout().contains("row        6 of approach_c"), "{}", replayed.stdout());
    let reported = replayed.json();
    assert_eq!((&reported["identical"], &reported["row"]), (&true.into(), &6.into()));
    assert!(
        reported["columns"].as_array().unwrap().iter().all(|column| column["difference"].is_null()),
        "{reported}"
    );
    let image =
        |name: &str| std::fs::read(folder.path(&format!("again/00000006_image_goal_{name}.png"))).unwrap();
    assert!(image("made").starts_with(b"\x89PNG") && image("made") == image("stored"));

    // A row rendered with different light, first by this version, then by an older one.
    let description = folder.path("data/dataset.json");
    let brighter = resealed(&description, ["\"ambient\": 0.5", "\"ambient\": 0.75"]);
    std::fs::write(&description, &brighter).unwrap();
    let other = folder.run("dataset replay data 6 --out again --json");
    let reported = other.json();
    let column = |name| {
        reported["columns"].as_array().unwrap().iter().find(|column| column["column"] == name).unwrap()
    };
    assert_eq!(column("image_goal")["difference"]["kind"], "pixels");
    assert!(column("joints_goal")["difference"].is_null());
    assert!(image("made") != image("stored"));
    other.fails(1, &["row 6 of data", "image_current, image_goal,", "dataset verify data"]);
    let version = format!("\"version\": \"{}\"", env!("CARGO_PKG_VERSION"));
    let older = resealed(&description, [&version, "\"version\": \"0.0.1\""]);
    std::fs::write(&description, older).unwrap();
    folder.run("dataset replay data 6").fails(1, &["written by flowservo 0.0.1"]);

    folder
        .run("dataset replay data 7")
        .fails(1, &["requested rows 7 to 8 (exclusive), but the dataset has 7"]);
    std::fs::write(folder.path("data/data/train-00001-of-00002.parquet"), "short").unwrap();
    folder.run("dataset replay data 6").fails(1, &["train-00001-of-00002.parquet: expected"]);
    std::fs::remove_file(description).unwrap();
    folder.run("dataset replay data 6").fails(1, &["holds no complete dataset"]);
}

#[test]
fn info_describes_approaches_in_words_and_numbers() {
    let folder = Folder::new();
    folder.run(&generate("c.toml", 14, "data")).ok();
    let reported = folder.run("dataset info data --json").ok();
    let text = reported.stdout();
    for words in [
        "3 files",
        "range 2b to range 2b",
        "(configured 50.0 %)",
        "cuboid",
        "obstacles",
        "joint 6",
        "closer to a limit",
    ] {
        assert!(text.contains(words), "{words:?} in\n{text}");
    }
    // It fits on a terminal screen. The last line is for scripts.
    assert!(text.lines().count() <= 41, "{} lines", text.lines().count());
    let statistics = &reported.json()["statistics"];
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
    let size: usize = folder.files("data/data").values().map(Vec::len).sum();
    assert_eq!(statistics["bytes"]["total"].as_u64(), Some(size as u64));
}

#[test]
fn info_describes_avoidance_maps() {
    let folder = Folder::new();
    folder.run(&generate("avoid.toml", 12, "data")).ok();
    let reported = folder.run("dataset info data --json").ok();
    let values: Vec<f32> =
        rows::<AvoidanceRow>(&folder.path("data")).into_iter().flat_map(|row| row.values).collect();
    let free = values.iter().filter(|&&value| value == 0.0).count() as f64 / values.len() as f64;
    let found = &reported.json()["statistics"]["labels"]["values"];
    assert_relative_eq!(found["free"].as_f64().unwrap(), free, epsilon = 1e-12);
    let text = reported.stdout();
    assert!(text.contains(&format!("free (0) {:.1} %", free * 100.0)), "{text}");
    assert!(text.lines().count() <= 41, "{} lines", text.lines().count());
}

#[test]
fn show_draws_the_requested_rows() {
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
    // All measuring points, the outlines of two hemispheres, and two circles per ring.
    let circles = sheet.matches("<circle").count();
    let scenes: Vec<SceneRow> = rows(&folder.path("data"));
    let obstacles: usize = scenes.iter().map(|row| row.scene.obstacles.len()).sum();
    let rings = sheet.matches("fill=\"none\" stroke=\"#0072b2\"").count();
    assert_eq!(rings, obstacles);
    assert_eq!(circles, 7 * (180 + 2) + 2 * obstacles);
}

#[test]
fn verify_names_all_damage_and_generate_repairs_it() {
    let folder = Folder::new();
    folder.run(&generate("avoid.toml", 13, "data")).ok();
    let whole = folder.files("data");
    let reported = folder.run("dataset verify data --json").ok().json();
    assert_eq!(
        (reported["files"].as_u64(), reported["faults"].as_array().map(Vec::len)),
        (Some(3), Some(0)),
        "{reported}"
    );
    folder.write("data/data/train-00001-of-00003.parquet", "cut short");
    std::fs::remove_file(folder.path("data/data/train-00002-of-00003.parquet")).unwrap();
    folder.write("data/README.md", "# another");
    let run = folder.run("dataset verify data --json");
    let named =
        ["train-00001-of-00003.parquet: expected", "train-00002-of-00003.parquet: missing", "README.md"];
    run.fails(1, &named);
    assert_eq!(run.json()["faults"][1]["path"], "data/train-00002-of-00003.parquet");
    assert_eq!(run.json()["faults"][1]["problem"], "missing");
    assert_eq!(folder.run(&generate("avoid.toml", 13, "data")).ok().json()["rows_made"], 7);
    assert!(folder.files("data") == whole);
    // A damaged manifest cannot be trusted. The same configuration restores it.
    let described = String::from_utf8(whole["dataset.json"].clone()).unwrap();
    folder.write("data/dataset.json", &described.replace("\"rows\": 13", "\"rows\": 12"));
    for command in ["dataset verify data", "dataset info data"] {
        folder.run(command).fails(1, &["dataset.json: expected", "changed"]);
    }
    folder.run(&generate("avoid.toml", 13, "data")).ok();
    assert!(folder.files("data") == whole);
}

#[test]
fn parts_from_several_machines_complete_to_the_same_dataset() {
    let folder = Folder::new();
    folder.run(&generate("c.toml", 38, "whole")).ok();
    let part = |part: &str, out: &str| format!("{} --shard {part}", generate("c.toml", 38, out));
    let made = folder.run(&part("1/2", "data")).ok();
    assert!(
        made.stdout().contains("4 of 7 files are there; once all are, run: flowservo dataset finish data")
    );
    assert_eq!(
        (made.json()["rows_made"].as_u64(), made.json()["files_finished"].as_u64()),
        (Some(20), Some(4))
    );
    folder.run("dataset finish data").fails(
        1,
        &[
            "4 of 7 files are there",
            "data/train-00001-of-00007.parquet: missing (--shard 2/7)",
            "(--shard 6/7)",
        ],
    );
    for command in ["dataset info data", "dataset verify data"] {
        let go_on = "flowservo dataset generate data/config.toml --out data";
        folder.run(command).fails(1, &["4 of 7 files are finished", go_on]);
    }
    // A part from another machine is copied over.
    folder.run(&part("2/4", "other")).ok();
    for (path, bytes) in folder.files("other") {
        std::fs::write(folder.path("data").join(path), bytes).unwrap();
    }
    // The configuration in the folder works as well as the original.
    folder.run("dataset generate data/config.toml --out data --shard 4/4").ok();
    folder.run("dataset info data").fails(1, &["dataset finish data"]);
    let finished = folder.run("dataset finish data --json").ok().json();
    assert_eq!((finished["rows"].as_u64(), finished["finished_before"].as_bool()), (Some(38), Some(false)));
    assert!(folder.files("data") == folder.files("whole"));
    assert!(folder.run("dataset finish data").ok().stdout().contains("already finished"));
    folder.run("dataset verify data").ok();
    folder.run(&part("5/4", "data")).fails(2, &["--shard", "I/N"]);
    folder.run("dataset finish nowhere").fails(1, &["nowhere", "dataset generate"]);
    folder.run(&part("1/2", "data").replace("count=38", "count=39")).fails(1, &["another configuration"]);
}

#[test]
fn several_processes_in_one_folder_write_what_one_writes() {
    let folder = Folder::new();
    let command = |out: &str, part: &str| format!("{} --threads 1 {part}", generate("a.toml", 60, out));
    folder.run(&command("whole", "")).ok();
    let whole = folder.files("whole");
    for (round, parts) in [
        &["", "", ""][..],
        &["--shard 1/3", "--shard 2/3", "--shard 3/3"],
        &["--shard 1/2", "", "--shard 2/2"],
        &["--shard 1/2", "--shard 1/2", "--shard 2/2"],
    ]
    .into_iter()
    .enumerate()
    {
        let out = format!("out{round}");
        let runs = std::thread::scope(|scope| {
            let run = |part: &&str| {
                let (command, folder) = (command(&out, part), &folder);
                scope.spawn(move || folder.run(&command))
            };
            let runs: Vec<_> = parts.iter().map(run).collect();
            runs.into_iter().map(|run| run.join().unwrap()).collect::<Vec<_>>()
        });
        for run in runs.iter().filter(|run| !run.succeeded()) {
            assert_ne!(round, 1, "disjoint parts do not conflict: {}", run.stderr());
            run.fails(1, &["another process is writing this file", "--shard I/N"]);
        }
        assert!(runs.iter().any(Run::succeeded), "{parts:?}");
        let last = if round == 1 { format!("dataset finish {out}") } else { command(&out, "") };
        folder.run(&last).ok();
        folder.run(&format!("dataset verify {out}")).ok();
        assert!(folder.files(&out) == whole, "{parts:?}");
    }
}

#[test]
fn a_file_that_another_process_is_writing_is_refused() {
    let folder = Folder::new();
    folder.run(&format!("{} --shard 1/3", generate("a.toml", 14, "data"))).ok();
    let held = folder.hold("data/data/train-00001-of-00003.parquet");
    let generate = generate("a.toml", 14, "data");
    folder.run(&generate).fails(1, &["another process is writing this file", "--shard I/N"]);
    drop(held);
    assert_eq!(folder.run(&generate).ok().json()["rows_made"], 8);
}
