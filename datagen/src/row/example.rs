//! One example: what a row of a dataset holds, made from its index alone.

use crate::config::{DatasetConfig, Kind};
use crate::error::{Error, Result};
use crate::placement::{HandPlacement, Placement, Sampler};
use crate::png;
use crate::randomization::Randomizer;
use crate::range::stream;
use nalgebra::Isometry3;
use world::Sensor;
use world::environment::Environment;

/// One example.
#[derive(Debug, Clone, PartialEq)]
pub struct Example {
    /// Its index in the dataset, and the number of its random stream.
    pub index: u64,
    /// Scene and hand poses.
    pub placement: Placement,
    /// The camera's mount on the hand.
    pub hand_from_camera: Isometry3<f64>,
    /// What the camera's sensor did to the images.
    pub sensor: Sensor,
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
        let mut randomizer = Randomizer::new(self.config, index);
        let hand_from_camera = randomizer.mount(&self.environment.camera.hand_from_camera);
        let sensor = randomizer.sensor();
        let sampler = Sampler::new(&self.environment, target, obstacles, motions, rejection);
        let sampler = sampler.mounted(&hand_from_camera);
        let mut placement = sampler.draw(&mut stream(self.config.seed, index))?;
        randomizer.dress(&mut placement.scene);
        let image = |hand: &HandPlacement| {
            let robot_from_camera = hand.pose.robot_from_hand() * hand_from_camera;
            let mut image = self.environment.renderer.color(&placement.scene, &robot_from_camera);
            sensor.expose(&mut image, randomizer.seed());
            png::encode(&image)
        };
        let images = placement.hands.iter().map(image).collect::<Result<_>>()?;
        let avoidance = match self.config.kind {
            Kind::Approach => Vec::new(),
            Kind::Avoidance => self.avoidance(&placement),
        };
        Ok(Example { index, placement, hand_from_camera, sensor, images, avoidance })
    }

    fn avoidance(&self, placement: &Placement) -> Vec<f32> {
        let robot_from_hand = placement.hands[0].pose.robot_from_hand();
        let map = self.environment.avoidance_map(&placement.scene, &robot_from_hand);
        map.values.iter().map(|&value| value as f32).collect()
    }
}
