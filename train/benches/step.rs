//! Training steps (forward, backward, AdamW) a second. `cargo bench -p train --bench step`
#![allow(clippy::print_stdout, missing_docs)]

use std::time::Instant;

use burn::optim::{AdamWConfig, GradientsParams};
use burn::tensor::{Device, Distribution, Tensor};
use train::loss::mean_squared_error;
use train::net::{ApproachConfig, Symmetry, TrunkKind};

/// Samples a second of the best of several steps.
fn samples_a_second(config: &ApproachConfig, batch: usize) -> f64 {
    let device = Device::flex().autodiff();
    let mut net = config.init(1, &device);
    let mut optimizer = AdamWConfig::new().init();
    let [width, height] = config.input;
    let images = || Tensor::<4>::random([batch, height, width, 3], Distribution::Uniform(-1.0, 1.0), &device);
    let (current, goal) = (images(), images());
    let target = Tensor::random([batch, 6], Distribution::Default, &device);
    let mut best = f64::INFINITY;
    for _ in 0..12 {
        let start = Instant::now();
        let loss = mean_squared_error(net.forward(current.clone(), goal.clone()), target.clone());
        let gradients = GradientsParams::from_grads(loss.backward(), &net);
        net = optimizer.step(1e-3, net, gradients);
        best = best.min(start.elapsed().as_secs_f64());
    }
    batch as f64 / best
}

fn main() {
    println!("trunk      symmetry       width input     batch  samples/s");
    for (input, batch, width) in [([128, 96], 32, 0.25), ([64, 48], 64, 0.25), ([128, 96], 8, 1.0)] {
        for trunk in [TrunkKind::FlowNetS, TrunkKind::Definet] {
            for symmetry in [Symmetry::None, Symmetry::Antisymmetric] {
                let config = ApproachConfig { trunk, symmetry, width, input, head: 512 };
                let rate = samples_a_second(&config, batch);
                println!("{trunk:<10?} {symmetry:<14?} {width:<5} {input:<9?} {batch:>5} {rate:>10.1}");
            }
        }
    }
}
