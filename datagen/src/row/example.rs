//! One example: the content of a row, generated from its index alone.

use super::png;
use crate::config::{ConfigError, DatasetConfig, Kind};
use crate::error::{Error, Result};
use crate::scene::{HandPlacement, Placement, Randomizer, Sampler, stream};
use nalgebra::Isometry3;
use world::Sensor;
use world::environment::Environment;

/// The content of one row.
#[derive(Debug, Clone, PartialEq)]
pub struct Example {
    /// Index in the dataset, and number of the random stream.
    pub index: u64,
    /// Scene and hand poses.
    pub placement: Placement,
    /// Mount of the camera on the hand.
    pub hand_from_camera: Isometry3<f64>,
    /// Blur and noise of the camera.
    pub sensor: Sensor,
    /// Wrist image at each hand pose, as PNG.
    pub images: Vec<Vec<u8>>,
    /// Avoidance map at the single hand pose, Eq. (1); empty for an approach.
    pub avoidance: Vec<f32>,
}

/// Generates the examples of one configuration.
pub struct ExampleGenerator<'a> {
    config: &'a DatasetConfig,
    environment: Environment,
}

impl<'a> ExampleGenerator<'a> {
    /// Validates the configuration and builds its environment.
    pub fn new(config: &'a DatasetConfig) -> Result<Self> {
        config.validate()?;
        let environment = Environment::new(&config.world).map_err(ConfigError::from)?;
        Ok(Self { config, environment })
    }

    /// Returns the configuration.
    pub fn config(&self) -> &DatasetConfig {
        self.config
    }

    /// Returns the environment.
    pub fn environment(&self) -> &Environment {
        &self.environment
    }

    /// Generates one example: a pure function of the configuration and `index`.
    pub fn example(&self, index: u64) -> Result<Example> {
        self.try_example(index).map_err(|source| Error::Example { index, source: Box::new(source) })
    }

    fn try_example(&self, index: u64) -> Result<Example> {
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
