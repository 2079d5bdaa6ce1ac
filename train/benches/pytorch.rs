//! The flowservo half of the comparison with PyTorch. `train/benches/pytorch.sh` runs both halves. This one reads commands as
//! lines of JSON from standard input, answers each with a line on standard output, and sleeps in between:
//!
//! ```text
//! {"setup": {"device": "cpu", "batch": 32, "network": {"trunk": "flownet_s", "symmetry": "none", "width": 0.25,
//!            "input": [128, 96], "head": 512}}}    a new network and a batch of noise
//! {"train": 10}        ten steps: {"seconds": total, "loss": before the last step}
//! {"infer": 10}        ten outputs: {"seconds": total}
//! {"export": "DIR"}    weights, gradients, inputs, targets and output as safetensors: {"loss": of the batch}
//! ```
//!
//! The answer to an error is `{"error": "..."}`. `RAYON_NUM_THREADS` sets the number of threads.
#![allow(clippy::print_stdout, missing_docs)]

use std::error::Error;
use std::io::{IsTerminal, stdin};
use std::path::{Path, PathBuf};
use std::time::Instant;

use burn::module::{Module, ModuleMapper, Param};
use burn::optim::GradientsParams;
use burn::tensor::{Device, Tensor, TensorData};
use burn_store::{ModuleSnapshot, SafetensorsStore};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use serde::Deserialize;
use serde_json::{Value, json};
use train::network::{ApproachConfig, Images, Network};
use train::optimizer::adamw::AdamW;
use train::optimizer::gradients::Gradients;
use train::optimizer::loss::mean_squared_error;

/// Answer to a command.
type Answer = Result<Value, Box<dyn Error>>;

// As in configs/train/ and in pytorch.py.
const LEARNING_RATE: f64 = 1e-3;
const WEIGHT_DECAY: f64 = 0.01;
const GRADIENT_CLIP: f64 = 1.0;

#[derive(Deserialize)]
#[serde(rename_all = "snake_case")]
enum Command {
    Setup(Setup),
    Train(usize),
    Infer(usize),
    Export(PathBuf),
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Setup {
    device: String,
    batch: usize,
    network: ApproachConfig,
}

fn main() -> Result<(), Box<dyn Error>> {
    train::memory::keep_freed();
    if stdin().is_terminal() {
        println!("this is one half of a benchmark; run train/benches/pytorch.sh");
        return Ok(());
    }
    let mut subject = None;
    for line in stdin().lines() {
        let answer = handle(&mut subject, &line?);
        println!("{}", answer.unwrap_or_else(|error| json!({ "error": error.to_string() })));
    }
    Ok(())
}

fn handle(subject: &mut Option<Subject>, line: &str) -> Answer {
    let command = serde_json::from_str(line)?;
    if let Command::Setup(setup) = &command {
        let made = subject.insert(Subject::new(setup)?);
        return Ok(json!({ "parameters": made.network.num_params() }));
    }
    let made = subject.take().ok_or("the first command must be `setup`")?;
    let (made, answer) = match command {
        Command::Train(steps) => made.train(steps),
        Command::Infer(outputs) => made.infer(outputs),
        Command::Export(directory) => made.export(&directory),
        Command::Setup(_) => unreachable!("handled above"),
    }?;
    *subject = Some(made);
    Ok(answer)
}

/// A network and the batch that all commands use.
struct Subject {
    device: Device,
    network: Network,
    optimizer: AdamW,
    images: Images,
    targets: Tensor<2>,
}

impl Subject {
    fn new(setup: &Setup) -> Result<Self, Box<dyn Error>> {
        setup.network.validate()?;
        let device = device(&setup.device)?.autodiff();
        let mut random = ChaCha8Rng::seed_from_u64(1);
        let [width, height] = setup.network.input;
        let [current, goal] =
            [(); 2].map(|()| noise(&mut random, [setup.batch, height, width, 3], &device) * 2.0 - 1.0);
        let network = Network::new(setup.network.architecture(), 1, &device);
        Ok(Self {
            optimizer: AdamW::new(&network, WEIGHT_DECAY),
            network,
            images: Images { current, goal: Some(goal) },
            targets: noise(&mut random, [setup.batch, 6], &device),
            device,
        })
    }

    fn train(self, steps: usize) -> Result<(Self, Value), Box<dyn Error>> {
        let Self { device, mut network, mut optimizer, images, targets } = self;
        let (start, mut loss) = (Instant::now(), f64::NAN);
        for _ in 0..steps {
            let outputs = network.forward(images.clone());
            let error = mean_squared_error(outputs, targets.clone());
            let gradients = Gradients::backward(&network, error).clipped(GRADIENT_CLIP);
            loss = gradients.loss();
            network = optimizer.step(network, gradients, LEARNING_RATE);
        }
        device.sync()?;
        let answer = json!({ "seconds": start.elapsed().as_secs_f64(), "loss": loss });
        Ok((Self { device, network, optimizer, images, targets }, answer))
    }

    fn infer(self, outputs: usize) -> Result<(Self, Value), Box<dyn Error>> {
        let (network, Images { current, goal }) = (self.network.valid(), self.images.clone());
        let images = Images { current: current.inner(), goal: goal.map(Tensor::inner) };
        let start = Instant::now();
        for _ in 0..outputs {
            network.forward(images.clone()).try_into_data()?;
        }
        let answer = json!({ "seconds": start.elapsed().as_secs_f64() });
        Ok((self, answer))
    }

    fn export(self, directory: &Path) -> Result<(Self, Value), Box<dyn Error>> {
        let output = self.network.forward(self.images.clone());
        let loss = mean_squared_error(output.clone(), self.targets.clone());
        let gradients = GradientsParams::from_grads(loss.backward(), &self.network);
        let goal = self.images.goal.clone().ok_or("no goal images")?;
        let [current, goal] = [self.images.current.clone(), goal].map(Param::from_tensor);
        let [target, output] = [self.targets.clone(), output.detach()].map(Param::from_tensor);
        let store = |name| SafetensorsStore::from_file(directory.join(name));
        self.network.save_into(&mut store("weights.safetensors"))?;
        let gradients = self.network.valid().map(&mut ReplaceByGradients(gradients));
        gradients.save_into(&mut store("gradients.safetensors"))?;
        Sample { current, goal, target, output }.save_into(&mut store("sample.safetensors"))?;
        let answer = json!({ "loss": loss.into_scalar::<f32>() });
        Ok((self, answer))
    }
}

/// Inputs, targets and outputs, named for the store.
#[derive(Module, Debug)]
struct Sample {
    current: Param<Tensor<4>>,
    goal: Param<Tensor<4>>,
    target: Param<Tensor<2>>,
    output: Param<Tensor<2>>,
}

/// Replaces weights by their gradients, so that they are stored under the same names.
struct ReplaceByGradients(GradientsParams);

impl ModuleMapper for ReplaceByGradients {
    fn map_float<const D: usize>(&mut self, param: Param<Tensor<D>>) -> Param<Tensor<D>> {
        let (id, weight, mapper) = param.consume();
        let gradient = self.0.remove(id).unwrap_or_else(|| weight.zeros_like());
        Param::from_mapped_value(id, gradient, mapper)
    }
}

/// Returns values from 0 to 1.
fn noise<const D: usize>(random: &mut ChaCha8Rng, shape: [usize; D], device: &Device) -> Tensor<D> {
    let values: Vec<f32> = (0..shape.iter().product()).map(|_| random.random()).collect();
    Tensor::from_data(TensorData::new(values, shape), device)
}

fn device(name: &str) -> Result<Device, String> {
    match name {
        "cpu" => Ok(Device::flex()),
        #[cfg(feature = "cuda")]
        "cuda" => Ok(Device::cuda(0)),
        #[cfg(feature = "wgpu")]
        "wgpu" => Ok(Device::wgpu(burn::tensor::DeviceKind::DiscreteGpu(0))),
        _ => Err(format!("this build has no device {name:?}; build with --features wgpu or cuda")),
    }
}
