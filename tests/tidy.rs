//! The house rules in CONTRIBUTING.md that a machine can check.

mod cycles;
mod spelling;

use crate::support::repository;
use std::fs;
use std::path::Path;

/// A file of the repository.
struct Source {
    /// Path below the repository, with `/`.
    name: String,
    text: String,
}

impl Source {
    fn read(path: &Path) -> Self {
        let name = path.strip_prefix(repository()).unwrap().display().to_string();
        Self { name, text: fs::read_to_string(path).unwrap() }
    }

    /// The text before the unit tests.
    fn code(&self) -> &str {
        self.text.split("mod tests {").next().unwrap()
    }
}

/// Files below a folder with one of these extensions, in the order of their names.
fn collect(folder: &Path, extensions: &[&str], found: &mut Vec<Source>) {
    let Ok(entries) = fs::read_dir(folder) else { return };
    let mut paths: Vec<_> = entries.map(|entry| entry.unwrap().path()).collect();
    paths.sort();
    for path in paths {
        if path.is_dir() {
            collect(&path, extensions, found);
        } else if path.extension().is_some_and(|found| extensions.iter().any(|extension| found == *extension))
        {
            found.push(Source::read(&path));
        }
    }
}

/// Sources of the binary and the library crates, without tests and benches.
fn sources() -> Vec<Source> {
    let mut found = Vec::new();
    for folder in ["src", "world/src", "datagen/src", "train/src", "eval/src", "report/src", "registry/src"] {
        collect(&repository().join(folder), &["rs"], &mut found);
    }
    assert!(found.len() > 40, "only {} source files were found", found.len());
    found
}

#[track_caller]
fn none(what: &str, offenders: &[String]) {
    assert!(offenders.is_empty(), "{what}:\n  {}", offenders.join("\n  "));
}

/// Lines of code for which `offends` holds, with file and number, in files that are not `allowed`.
fn lines(allowed: impl Fn(&str) -> bool, offends: impl Fn(&str) -> bool) -> Vec<String> {
    let mut offenders = Vec::new();
    for source in sources().iter().filter(|source| !allowed(&source.name)) {
        for (number, line) in source.code().lines().enumerate() {
            if offends(line) {
                offenders.push(format!("{}:{}: {}", source.name, number + 1, line.trim()));
            }
        }
    }
    offenders
}

#[test]
fn no_source_file_is_longer_than_400_lines() {
    let mut long = sources();
    long.retain(|source| source.code().lines().count() > 400);
    let long: Vec<_> = long.into_iter().map(|source| source.name).collect();
    none("longer than 400 lines without tests", &long);
}

#[test]
fn no_file_name_is_vague() {
    let drawers =
        ["util", "utils", "helper", "helpers", "common", "misc", "base", "types", "manager", "core"];
    let is_drawer = |name: &str| name.trim_end_matches(".rs").split('/').any(|part| drawers.contains(&part));
    let named: Vec<_> =
        sources().into_iter().map(|source| source.name).filter(|name| is_drawer(name)).collect();
    none("names that do not describe the contents", &named);
}

#[test]
fn millimeters_and_degrees_stay_at_the_edges() {
    let edges = [
        "config",
        "commands/train",
        "commands/model/provenance",
        "commands/dataset/inspect",
        "error",
        "units",
        "metric",
        "table",
        "report",
        "accuracy",
        "paper",
        "result",
        "figure",
        "range",
        "placement",
        "scene",
        "camera",
        "hiro",
        "hand",
        "card",
        "curve",
    ];
    let at_the_edge = |name: &str| edges.iter().any(|edge| name.contains(edge));
    let offends = |line: &str| {
        // Quoted text is for people, and a line that reads a configuration counts as an edge.
        let code: String = line.split("//").next().unwrap().split('"').step_by(2).collect();
        let reads = code.contains("config.");
        !reads
            && code
                .split(|c: char| !c.is_ascii_alphanumeric() && c != '_')
                .any(|word| (word.ends_with("_mm") || word.ends_with("_deg")) && !word.starts_with("to_"))
    };
    none("millimeters or degrees inside the program; use SI units", &lines(at_the_edge, offends));
}

#[test]
fn each_numbered_equation_has_one_implementation_and_a_test() {
    let tests = fs::read_to_string(repository().join("tests/paper.rs")).unwrap();
    for number in 1..=8 {
        let citation = format!("Eq. ({number})");
        // The comment that begins with the number marks the implementation. Others may refer to it.
        let begins = |line: &str| {
            let comment = line.trim().trim_start_matches('/').trim_start();
            line.trim().starts_with("//")
                && (comment.starts_with(&format!("{citation}:"))
                    || comment.starts_with(&format!("{citation},")))
        };
        let places = lines(|_| false, begins);
        assert_eq!(
            places.len(),
            1,
            "{citation} must begin exactly one comment, at its implementation; found {places:?}"
        );
        assert!(tests.contains(&citation), "tests/paper.rs has no test of {citation}");
    }
}

#[test]
fn backends_and_parry_stay_in_their_files() {
    let backend =
        |line: &str| ["Device::flex", "Device::wgpu", "Device::cuda"].iter().any(|name| line.contains(name));
    let may = |name: &str| ["src/device.rs", "train/src/network/cpu.rs"].contains(&name);
    none("only src/device.rs and train/src/network/cpu.rs may name a backend", &lines(may, backend));
    let parry = |line: &str| line.contains("parry3d") || line.contains("glam");
    let may = |name: &str| name.starts_with("world/") && name.ends_with("geometry.rs");
    none("only world/src/geometry.rs may use parry or glam", &lines(may, parry));
}

#[test]
fn dependencies_point_one_way() {
    let order = ["world", "datagen", "train", "eval", "report"];
    for (rank, krate) in order.iter().enumerate() {
        let manifest = fs::read_to_string(repository().join(krate).join("Cargo.toml")).unwrap();
        for later in order[rank + 1..].iter().chain(&["registry"]) {
            assert!(!manifest.contains(&format!("{later}.workspace")), "{krate} must not depend on {later}");
        }
    }
    let registry = fs::read_to_string(repository().join("registry/Cargo.toml")).unwrap();
    for ours in order {
        assert!(!registry.contains(&format!("{ours}.workspace")), "registry must not depend on {ours}");
    }
    let world = fs::read_to_string(repository().join("world/Cargo.toml")).unwrap();
    for foreign in ["burn", "arrow", "parquet", "rayon"] {
        assert!(!world.contains(foreign), "world must not depend on {foreign}");
    }
}

#[test]
fn nothing_is_unfinished() {
    let marks = ["todo!", "unimplemented!", "allow(dead_code)", "#[ignore", "TODO", "FIXME"];
    none("unfinished", &lines(|_| false, |line| marks.iter().any(|mark| line.contains(mark))));
}

/// The last bits of these functions depend on the machine in the standard library, but not in `libm`.
#[test]
fn code_that_determines_dataset_bytes_is_portable() {
    let functions = [
        "sin", "cos", "tan", "sin_cos", "asin", "acos", "atan", "atan2", "sinh", "cosh", "tanh", "exp",
        "exp2", "exp_m1", "ln", "ln_1p", "log", "log2", "log10", "powi", "powf", "hypot", "cbrt", "mul_add",
    ];
    let decides = |name: &str| name.starts_with("world/") || name.starts_with("datagen/");
    let calls = |line: &str| functions.iter().any(|name| line.contains(&format!(".{name}(")));
    none("calls to functions that are not portable; use `libm`", &lines(|name| !decides(name), calls));
}

#[test]
fn libraries_do_not_read_the_clock() {
    let clock = |line: &str| line.contains("Instant::now") || line.contains("SystemTime::now");
    let may = |name: &str| name.starts_with("src/") || name.starts_with("eval/");
    none("a result must not depend on the clock", &lines(may, clock));
}
