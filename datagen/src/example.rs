//! One example: what a row of a dataset holds, made from its index alone.

use crate::config::{DatasetConfig, Kind};
use crate::error::{Error, Result};
use crate::placement::{Placement, Sampler};
use crate::png;
use crate::range::stream;
use world::environment::Environment;

/// One example.
#[derive(Debug, Clone, PartialEq)]
pub struct Example {
    /// Its index in the dataset, and the number of its random stream.
    pub index: u64,
    /// Scene and hand poses.
    pub placement: Placement,
    /// The wrist image of each hand pose, as PNG.
    pub images: Vec<Vec<u8>>,
    /// Avoidance map of the only hand pose, Eq. (1); empty for an approach.
    pub avoidance: Vec<f32>,
}

/// Makes the examples of one configuration.
pub struct Collector<'a> {
    config: &'a DatasetConfig,
    environment: Environment,
}

impl<'a> Collector<'a> {
    /// Builds the environment.
    pub fn new(config: &'a DatasetConfig) -> Result<Self> {
        config.validate()?;
        Ok(Self { config, environment: Environment::new(&config.world)? })
    }

    /// The configuration.
    pub fn config(&self) -> &DatasetConfig {
        self.config
    }

    /// The environment of the dataset.
    pub fn environment(&self) -> &Environment {
        &self.environment
    }

    /// Makes one example: a pure function of the configuration and `index`.
    pub fn example(&self, index: u64) -> Result<Example> {
        self.collect(index).map_err(|source| Error::Example { index, source: Box::new(source) })
    }

    fn collect(&self, index: u64) -> Result<Example> {
        let DatasetConfig { target, obstacles, motions, rejection, .. } = self.config;
        let sampler = Sampler::new(&self.environment, target, obstacles, motions, rejection);
        let (placement, images) = sampler.draw(&mut stream(self.config.seed, index))?;
        let images = images.iter().map(png::encode).collect::<Result<_>>()?;
        let avoidance = match self.config.kind {
            Kind::Approach => Vec::new(),
            Kind::Avoidance => self.avoidance(&placement),
        };
        Ok(Example { index, placement, images, avoidance })
    }

    fn avoidance(&self, placement: &Placement) -> Vec<f32> {
        let robot_from_hand = placement.hands[0].pose.robot_from_hand();
        let map = self.environment.avoidance_map(&placement.scene, &robot_from_hand);
        map.values.iter().map(|&value| value as f32).collect()
    }
}
