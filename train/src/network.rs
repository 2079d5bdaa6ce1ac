//! Either network, behind one face for training and checkpoints.

use burn::module::Module;
use burn::tensor::{Device, Tensor};

use crate::batch::Images;
use crate::config::Task;
use crate::net::{ApproachNet, AvoidNet};

/// A network with its weights.
#[derive(Module, Debug)]
pub enum Network {
    /// `CNN_approach`.
    Approach(ApproachNet),
    /// `CNN_avoid`.
    Avoidance(AvoidNet),
}

impl Network {
    /// The untrained network of a task: a pure function of the seed.
    pub fn new(task: &Task, seed: u64, device: &Device) -> Self {
        match task {
            Task::Approach { network, .. } => Self::Approach(network.init(seed, device)),
            Task::Avoidance { network } => Self::Avoidance(network.init(seed, device)),
        }
    }

    /// # Panics
    /// If the images are those of the other task.
    ///
    /// # Shapes
    /// - `images`: those of a batch, of the task that the network was made for
    /// - result: `[batch, outputs]`
    pub fn forward(&self, images: Images) -> Tensor<2> {
        match (self, images) {
            (Self::Approach(network), Images { current, goal: Some(goal) }) => network.forward(current, goal),
            (Self::Avoidance(network), Images { current, goal: None }) => network.forward(current),
            _ => panic!("images of the other task"),
        }
    }
}
