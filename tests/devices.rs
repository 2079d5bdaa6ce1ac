//! `wgpu` on a Vulkan driver that runs on the CPU. Only in builds with `--features wgpu-software`, which `.ci/run` does not
//! make; see CONTRIBUTING.md.

use crate::support::{Folder, Run, repository};
use serde_json::Value;

/// Mesa's software driver, under its older and its newer name.
const SOFTWARE: &str = "/usr/share/vulkan/icd.d/lvp_icd.x86_64.json:/usr/share/vulkan/icd.d/lvp_icd.json";
const NONE: &str = "/nonexistent.json";

fn train(kind: &str, out: &str, device: &str, further: &str) -> String {
    let config = repository().join(format!("configs/train/{kind}.toml"));
    format!(
        "train {} --data {kind} --out {out} --device {device} --json --set network.width=0.1 --set network.head=32 \
         --set network.input=[32,24] --set optimizer.batch=8 --set validation=0.25 --set phases.0.epochs=2 {further}",
        config.display()
    )
}

const CAMERA: &str = "--set world.camera.width=32 --set world.camera.height=24";

/// A folder with one dataset of each kind.
fn with_datasets() -> Folder {
    let folder = Folder::new();
    for (kind, config) in [("approach", "a"), ("avoid", "avoid")] {
        let config = repository().join(format!("configs/datasets/{config}.toml"));
        folder
            .run(&format!("dataset generate {} --out {kind} --set count=64 {CAMERA}", config.display()))
            .ok();
    }
    folder
}

/// The epoch records of a run.
fn epochs(folder: &Folder, run: &str) -> Vec<Value> {
    let lines = std::fs::read_to_string(folder.path(run).join("metrics.jsonl")).unwrap();
    lines.lines().map(|line| serde_json::from_str(line).unwrap()).collect()
}

/// Relative tolerance of losses and gradients.
const TOLERANCE: f64 = 1e-4;

#[track_caller]
fn agree(folder: &Folder, [ours, theirs]: [&str; 2]) {
    let (ours, theirs) = (epochs(folder, ours), epochs(folder, theirs));
    assert_eq!((ours.len(), theirs.len()), (2, 2));
    for (ours, theirs) in ours.iter().zip(&theirs) {
        for key in ["training_loss", "gradient_norm", "validation_loss"] {
            let [a, b] = [ours, theirs].map(|epoch| epoch[key].as_f64().unwrap());
            assert!((a - b).abs() <= TOLERANCE * b.abs(), "epoch {}, {key}: {a} and {b}", ours["epoch"]);
        }
    }
}

#[track_caller]
fn on(run: &Run, device: &str) {
    assert!(run.stderr().contains(&format!("on {device}")), "{}", run.stderr());
}

#[test]
fn networks_train_resume_and_servo_through_vulkan_as_on_the_cpu() {
    let folder = with_datasets();
    for kind in ["approach", "avoid"] {
        let [cpu, gpu] = ["cpu", "gpu"].map(|device| format!("{kind}-{device}"));
        on(&folder.run(&train(kind, &cpu, "cpu", "")).ok(), "CPU");
        let run = folder.run_with_driver(SOFTWARE, &train(kind, &gpu, "wgpu-software", "")).ok();
        on(&run, "wgpu-software: llvmpipe");
        agree(&folder, [&gpu, &cpu]);
    }

    let stopped = folder.interrupt_training("resumed", &train("approach", "resumed", "wgpu-software", ""));
    stopped.fails(1, &["--resume"]);
    folder.run_with_driver(SOFTWARE, &train("approach", "resumed", "wgpu-software", "--resume")).ok();
    agree(&folder, ["resumed", "approach-cpu"]);

    let eval = |device: &str| {
        let config = repository().join("configs/eval/table1.toml");
        let eval = format!(
            "eval {} --approach approach-cpu/best --avoid avoid-cpu/best --out eval-{device} {CAMERA} --json \
             --set sessions=1 --set servo.max_steps=5 --device {device}",
            config.display()
        );
        folder.run_with_driver(SOFTWARE, &eval).ok().json()["position_norm_mm"].as_f64().unwrap()
    };
    let [cpu, gpu] = ["cpu", "wgpu-software"].map(eval);
    assert!((cpu - gpu).abs() <= TOLERANCE * cpu, "{cpu} and {gpu}");
}

#[test]
fn a_software_rasterizer_is_not_selected_as_a_gpu() {
    let folder = with_datasets();
    let auto = folder.run_with_driver(SOFTWARE, &train("approach", "auto", "auto", "")).ok();
    on(&auto, "CPU");
    let wgpu = folder.run_with_driver(SOFTWARE, &train("approach", "wgpu", "wgpu", ""));
    wgpu.fails(
        2,
        &["--device wgpu: this machine has no such device; it has wgpu-software: llvmpipe", "; CPU"],
    );
}

#[test]
fn without_a_driver_auto_silently_selects_the_cpu() {
    let folder = with_datasets();
    let plain = folder.run(&train("approach", "plain", "cpu", "")).ok();
    let auto = folder.run_with_driver(NONE, &train("approach", "auto", "auto", "")).ok();
    on(&auto, "CPU");
    assert_eq!(auto.stderr().lines().count(), plain.stderr().lines().count(), "{}", auto.stderr());
    for device in ["wgpu", "wgpu-software"] {
        let run = folder.run_with_driver(NONE, &train("approach", "wgpu", device, ""));
        run.fails(2, &[&format!("--device {device}: this machine has no such device; it has CPU")]);
    }
}
