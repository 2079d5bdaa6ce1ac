//! The whole pipeline on the command line: from datasets to Table 1 and the report.

use crate::support::{Folder, Run, repository};
use serde_json::Value;

fn reproduce(folder: &Folder, further: &str) -> Run {
    let configs = repository().join("tests/testdata");
    folder
        .run(&format!("reproduce --configs {} --out run --device cpu --json {further}", configs.display()))
        .ok()
}

/// Evaluation results without timings.
fn measured(results: &Value) -> Vec<(String, Value)> {
    let systems = results["evaluation"].as_array().unwrap();
    let untimed = |system: &Value| {
        system
            .as_object()
            .unwrap()
            .clone()
            .into_iter()
            .filter(|(key, _)| key != "ms_per_step")
            .collect::<Vec<_>>()
    };
    systems.iter().flat_map(untimed).collect()
}

/// Asserts that the network has exactly one evaluation in the run's registry: the figures of this system, without timings.
#[track_caller]
fn figures_are_in_the_registry(folder: &Folder, results: &Value, version: &str, system: usize) {
    let shown = folder.run(&format!("model show {version} --registry run/registry --json")).ok();
    let (shown, text) = (shown.json(), shown.stdout());
    let figures = results["evaluation"][system].as_object().unwrap();
    let numbers: Vec<_> = figures.iter().filter(|(_, value)| value.is_number()).collect();
    assert!(numbers.len() > 20, "{figures:?}");
    for (key, value) in numbers {
        let metric = &shown["metrics"][format!("table1_{key}")];
        assert_eq!(metric["value"].as_f64(), value.as_f64(), "{version}: {key}");
        assert_eq!(metric["attachment"], 1, "{version}: {key}");
    }
    assert!(text.contains("attachment 1: evaluation (2"), "{text}");
    assert!(!text.contains("ms_per_step"), "{text}");
    let attachments = shown["attachments"].as_array().unwrap();
    assert_eq!(attachments.len(), 1, "{version}");
    let configuration = &attachments[0]["evaluation"]["configuration"];
    assert_eq!(configuration["sessions"], 4);
    // Both networks are named by the digests of their weights.
    let weights = |model: &str| {
        let shown = folder.run(&format!("model show {model} --registry run/registry --json")).ok().json();
        let layers = shown["manifest"]["layers"].as_array().unwrap().clone();
        let is_weights = |layer: &&Value| layer["annotations"].to_string().contains("weights.safetensors");
        layers.iter().find(is_weights).unwrap()["digest"].clone()
    };
    assert_eq!(configuration["policies"]["avoid"], weights("avoid@1"));
    if !version.starts_with("avoid") {
        assert_eq!(configuration["policies"]["approach"], weights(version));
    }
}

#[test]
fn reproduce_is_deterministic_and_reuses_finished_stages() {
    let folder = Folder::new();
    let first = reproduce(&folder, "");
    let results = first.json();
    assert_eq!(results["datasets"].as_array().unwrap().len(), 4);
    for network in ["approach", "plain"] {
        for key in ["samples_per_s", "seconds", "position_error_mm", "orientation_error_deg"] {
            let value = &results["training"][network][key];
            assert!(value.as_f64().is_some_and(|value| value > 0.0), "{network}: {key} = {value}");
        }
    }
    for system in results["evaluation"].as_array().unwrap() {
        assert_eq!(system["sessions"], 4);
        for key in ["position_norm_mm", "orientation_norm_deg", "position_p95_mm", "collided_rate"] {
            assert!(system[key].as_f64().is_some(), "{key} in {system}");
        }
        for stage in ["render", "approach", "avoid", "deflect", "qp"] {
            assert!(system["ms_per_step"][stage].as_f64().is_some(), "{stage} in {system}");
        }
    }
    let table = first.stdout();
    assert!(table.contains("Table 1") && table.contains("the paper"), "{table}");
    for file in ["table1.txt", "table1.md", "table1.csv", "table1.json", "results.json", "config.toml"] {
        assert!(folder.path("run").join(file).exists(), "{file}");
    }
    let page = std::fs::read_to_string(folder.path("run/report.html")).unwrap();
    for part in ["Table 1", "Figure 6", "Figure 7", "Figure 8", "Figure 9", "<svg", "data:image/png;base64,"]
    {
        assert!(page.contains(part), "{part} is missing in the report");
    }
    assert!(
        !page.contains("src=\"http") && !page.contains("href=\"http"),
        "the page refers to nothing on the web"
    );

    figures_are_in_the_registry(&folder, &results, "approach@1", 0);
    figures_are_in_the_registry(&folder, &results, "plain@1", 1);
    figures_are_in_the_registry(&folder, &results, "avoid@1", 0);

    let again = reproduce(&folder, "");
    assert!(again.stderr().contains("training approach: already finished"), "{}", again.stderr());
    assert_eq!(measured(&again.json()), measured(&results));
    figures_are_in_the_registry(&folder, &results, "approach@1", 0);

    let anew = Folder::new();
    let anew = reproduce(&anew, "");
    assert_eq!(measured(&anew.json()), measured(&results), "the same seed gives the same table");

    let changed = reproduce(&folder, "--set training.plain.phases.0.learning_rate=5e-4");
    let reported = changed.stderr();
    assert!(
        reported.contains("training approach: already finished")
            && !reported.contains("training plain: already finished"),
        "{reported}"
    );
    figures_are_in_the_registry(&folder, &changed.json(), "plain@2", 1);
    figures_are_in_the_registry(&folder, &results, "avoid@1", 0);
    folder.run("model verify --registry run/registry").ok();
}

#[test]
fn a_model_is_trained_published_and_evaluated_by_name() {
    let folder = Folder::new();
    let configs = repository().join("configs");
    let camera = "--set world.camera.width=32 --set world.camera.height=24";
    let tiny = "--set network.width=0.02 --set network.head=8 --set network.input=[32,24] --set optimizer.batch=4 \
                --set validation=0.25 --set phases.0.epochs=2 --device cpu";
    let dataset = configs.join("datasets/a.toml");
    folder.run(&format!("dataset generate {} --out a --set count=16 {camera}", dataset.display())).ok();
    let train = configs.join("train/approach.toml");
    let trained =
        folder.run(&format!("train {} --data a --out run {tiny} --json", train.display())).ok().json();
    assert!(trained["position_error_mm"].as_f64().unwrap() > 0.0);
    folder.run("model publish run/best approach").ok();
    let eval = format!(
        "eval {} {camera} --set sessions=2 --set servo.max_steps=5",
        configs.join("eval/oracle.toml").display()
    );
    let by_name = folder.run(&format!("{eval} --approach approach@1 --out e1 --json")).ok().json();
    let by_path = folder.run(&format!("{eval} --approach run/best --out e2 --json")).ok().json();
    assert_eq!(by_name["position_norm_mm"], by_path["position_norm_mm"]);
    // The evaluation is published with the network. An evaluation of another network is refused.
    folder.run("model publish run/best measured --evaluation e2").ok();
    let metrics = &folder.run("model show measured --json").ok().json()["manifest"]["metrics"];
    assert_eq!(metrics["table1_position_norm_mm"], by_path["position_norm_mm"]);
    assert!(metrics["validation_position_error_mm"].as_f64().unwrap() > 0.0);
    // A network that was published before its evaluation gets it as an attachment, once.
    for (name, expected) in [
        ("measured", "measured@1 already has these metrics"),
        ("approach", "approach@1: evaluation attached"),
        ("approach", "approach@1 already has these metrics"),
    ] {
        let reported = folder.run(&format!("model publish run/best {name} --evaluation e2")).ok().stdout();
        assert!(reported.contains(expected), "{reported}");
    }
    let again = folder.run("model attach approach@1 --evaluation e2 --json").ok();
    assert_eq!(again.json()["changed"], false, "{}", again.stdout());
    let shown = folder.run("model show approach --json").ok().json();
    assert_eq!(shown["metrics"]["table1_position_norm_mm"]["value"], by_path["position_norm_mm"]);
    assert_eq!(shown["manifest"]["metrics"]["table1_position_norm_mm"], Value::Null);
    let compared = folder.run("model diff approach measured --json").ok().json();
    let same = |metric: &Value| metric["difference"] == 0.0;
    assert!(compared["metrics"].as_array().unwrap().iter().all(same), "{compared}");
    assert!(folder.path("e1/table1.md").exists() && folder.path("e1/config.toml").exists());
    // The same for the paper's label and network, the baseline and FlowNetC.
    for (run, network) in [
        ("paper", "--set network.label=difference --set network.symmetry=none"),
        ("definet", "--set network.trunk=definet --set network.symmetry=none"),
        ("flownet_c", "--set network.trunk=flownet_c"),
    ] {
        folder.run(&format!("train {} --data a --out {run} {tiny} {network}", train.display())).ok();
        let result = folder.run(&format!("{eval} --approach {run}/best --out e-{run} --json")).ok().json();
        assert!(result["position_norm_mm"].as_f64().is_some_and(f64::is_finite), "{result}");
        folder
            .run(&format!("model publish {run}/best other --evaluation e2"))
            .fails(2, &["e2/config.toml", "run/best"]);
        folder
            .run(&format!("model attach approach --evaluation e-{run}"))
            .fails(2, &[&format!("e-{run}/config.toml"), &format!("{run}/best")]);
    }
}

#[test]
fn ground_truth_converges_through_the_same_loop() {
    let folder = Folder::new();
    let oracle = repository().join("configs/eval/oracle.toml");
    let camera = "--set world.camera.width=32 --set world.camera.height=24";
    let result = folder.run(&format!("eval {} {camera} --out e --json", oracle.display())).ok().json();
    assert_eq!(result["sessions"], 40);
    assert_eq!(result["converged_rate"], 1.0);
    assert_eq!(result["collided_rate"], 0.0);
    assert!(result["position_max_mm"].as_f64().unwrap() < 0.1, "{result}");
}
