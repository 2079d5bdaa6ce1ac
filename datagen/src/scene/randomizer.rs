//! Domain randomization of light, colors, textures and camera. It goes beyond the paper, whose datasets leave it off.
//!
//! It has its own random stream and always draws all numbers in the same order. Objects and motions are therefore the same as
//! without it, unless a displaced camera loses sight of the target. For the same reason, turning on noise does not change any
//! color.

use super::random::{stream, uniform};
use crate::config::{DatasetConfig, RandomizationConfig, TextureRange};
use nalgebra::{Isometry3, UnitQuaternion, UnitVector3, Vector3};
use rand::RngExt;
use rand_chacha::ChaCha8Rng;
use std::f64::consts::TAU;
use world::scene::Color;
use world::units::{deg, mm};
use world::{Light, Scene, Sensor, Texture};

/// First stream for randomization. The streams of placements are numbered by row, and stay below it.
const FIRST_STREAM: u64 = 1 << 40;

/// Randomization of one example.
#[derive(Debug)]
pub struct Randomizer<'a> {
    config: &'a RandomizationConfig,
    rng: ChaCha8Rng,
}

impl<'a> Randomizer<'a> {
    /// Starts the random stream of one example.
    pub fn new(config: &'a DatasetConfig, index: u64) -> Self {
        Self { config: &config.randomization, rng: stream(config.seed, FIRST_STREAM + index) }
    }

    /// Draws the error of the camera mount, and returns the resulting mount.
    pub fn mount(&mut self, hand_from_camera: &Isometry3<f64>) -> Isometry3<f64> {
        let shift = self.vector(mm(self.config.camera.shift_mm));
        let turn = self.vector(deg(self.config.camera.turn_deg));
        let error = Isometry3::from_parts(shift.into(), UnitQuaternion::from_scaled_axis(turn));
        // A product with the identity could change the last bits.
        if error == Isometry3::identity() { *hand_from_camera } else { hand_from_camera * error }
    }

    /// Draws the blur and noise of the sensor.
    pub fn sensor(&mut self) -> Sensor {
        let camera = &self.config.camera;
        let blur = uniform(camera.blur, &mut self.rng);
        Sensor { blur, noise: uniform(camera.noise, &mut self.rng) }
    }

    /// Draws light, colors and textures of a scene.
    pub fn dress(&mut self, scene: &mut Scene) {
        scene.light = self.light(&scene.light);
        let (colors, textures) = (&self.config.colors, &self.config.texture);
        scene.background = self.color(scene.background, colors.background);
        scene.table.color = self.color(scene.table.color, colors.table);
        // The pattern of the table is stretched along x or y only, because the table is flat.
        scene.table.texture = self.texture(&textures.table, 2);
        let spreads = std::iter::once(colors.target).chain(std::iter::repeat(colors.obstacles));
        for (body, spread) in std::iter::once(&mut scene.target).chain(&mut scene.obstacles).zip(spreads) {
            body.material.color = self.color(body.material.color, spread);
            body.material.texture = self.texture(&textures.objects, 3);
            if let Some(cross) = &mut body.material.cross {
                cross.color = self.color(cross.color, colors.cross);
            }
        }
    }

    /// Draws the seed of the noise in one image.
    pub fn seed(&mut self) -> u64 {
        self.rng.random()
    }

    fn light(&mut self, light: &Light) -> Light {
        let spread = &self.config.light;
        let cone = deg(self.config.light.cone_deg);
        // A uniform distribution on a spherical cap is uniform in height (Archimedes).
        let height = 1.0 - self.rng.random::<f64>() * (1.0 - libm::cos(cone));
        let (sin, cos) = libm::sincos(TAU * self.rng.random::<f64>());
        let ambient =
            (light.ambient + uniform([-spread.ambient, spread.ambient], &mut self.rng)).clamp(0.0, 1.0);
        let aside = (1.0 - height * height).max(0.0).sqrt();
        let towards_light = if cone > 0.0 {
            let around =
                UnitQuaternion::rotation_between(&Vector3::z(), &light.towards_light).unwrap_or_default();
            UnitVector3::new_normalize(around * Vector3::new(aside * cos, aside * sin, height))
        } else {
            light.towards_light
        };
        Light { towards_light, ambient }
    }

    fn color(&mut self, color: Color, spread: f64) -> Color {
        color.map(|channel| (channel + uniform([-spread, spread], &mut self.rng)).clamp(0.0, 1.0))
    }

    fn texture(&mut self, config: &TextureRange, axes: usize) -> Option<Texture> {
        let contrast = uniform(config.contrast, &mut self.rng);
        let mut grain = Vector3::repeat(mm(uniform(config.grain_mm, &mut self.rng)));
        grain[self.rng.random_range(0..axes)] *= uniform(config.stretch, &mut self.rng);
        let seed = self.rng.random();
        (contrast > 0.0).then_some(Texture { grain, contrast, seed })
    }

    fn vector(&mut self, half: f64) -> Vector3<f64> {
        Vector3::from_fn(|_, _| uniform([-half, half], &mut self.rng))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::ShapeName;
    use crate::fixture::{config, make};
    use crate::read::DatasetReader;
    use crate::row::{Example, ExampleGenerator, SceneRow, png};
    use world::units::{to_deg, to_mm};
    use world::{Camera, Renderer, Shape};

    /// A dataset with all randomization that does not move the camera.
    fn dressed(name: &str) -> DatasetConfig {
        let mut config = config(name, 1);
        let RandomizationConfig { light, colors, texture, camera } = &mut config.randomization;
        (light.cone_deg, light.ambient) = (40.0, 0.2);
        (colors.table, colors.target, colors.cross, colors.obstacles, colors.background) =
            (0.1, 0.1, 0.2, 0.3, 0.4);
        (texture.table.contrast, texture.objects.contrast) = ([0.2, 0.6], [0.1, 0.5]);
        (camera.blur, camera.noise) = ([0.2, 1.0], [0.01, 0.05]);
        config
    }

    fn example(config: &DatasetConfig, index: u64) -> Example {
        ExampleGenerator::new(config).unwrap().example(index).unwrap()
    }

    #[test]
    fn without_randomization_everything_is_as_configured() {
        let config = config("c", 1);
        let generator = ExampleGenerator::new(&config).unwrap();
        for index in 0..5 {
            let Example { placement, hand_from_camera, sensor, .. } = generator.example(index).unwrap();
            let bodies = |body: &world::Body| (body.shape, body.robot_from_body);
            let [target, obstacles @ ..] = &placement.scene.bodies().map(bodies).collect::<Vec<_>>()[..]
            else {
                panic!("no target")
            };
            assert_eq!(placement.scene, generator.environment().scene(*target, obstacles.to_vec()));
            assert_eq!(hand_from_camera, generator.environment().camera.hand_from_camera);
            assert_eq!((sensor.blur, sensor.noise), (0.0, 0.0));
        }
    }

    #[test]
    fn appearance_changes_and_scenes_and_motions_do_not() {
        let (plain, dressed) = (config("c", 1), dressed("c"));
        for index in 0..5 {
            let [a, b] = [&plain, &dressed].map(|config| example(config, index));
            assert_eq!((a.placement.hands, a.placement.motion), (b.placement.hands, b.placement.motion));
            for (a, b) in a.placement.scene.bodies().zip(b.placement.scene.bodies()) {
                assert_eq!((a.shape, a.robot_from_body), (b.shape, b.robot_from_body));
                assert_ne!(a.material, b.material);
            }
            assert_ne!(a.images, b.images);
        }
        let mut quiet = dressed.clone();
        quiet.randomization.camera.noise = [0.0, 0.0];
        assert_eq!(example(&quiet, 3).placement, example(&dressed, 3).placement, "noise changes no color");
    }

    #[test]
    fn draws_stay_within_their_range_and_fill_it() {
        let config = dressed("c");
        let nominal = Light::new(&config.world.light);
        let drawn: Vec<Example> = (0..200).map(|index| example(&config, index)).collect();
        let scenes = || drawn.iter().map(|example| &example.placement.scene);
        let fills = |values: &mut dyn Iterator<Item = f64>, [from, to]: [f64; 2]| {
            let (least, greatest) =
                values.fold((f64::INFINITY, f64::NEG_INFINITY), |(a, b), v| (a.min(v), b.max(v)));
            let margin = 0.05 * (to - from);
            assert!(from <= least && least < from + margin, "{least} of {from} to {to}");
            assert!(to - margin < greatest && greatest <= to, "{greatest} of {from} to {to}");
        };
        fills(&mut scenes().map(|s| s.light.ambient), [0.3, 0.7]);
        let table = config.world.table.color[1];
        fills(&mut scenes().map(|s| s.table.color[1]), [table - 0.1, table + 0.1]);
        fills(&mut scenes().map(|s| s.table.texture.unwrap().contrast), [0.2, 0.6]);
        fills(&mut scenes().map(|s| to_mm(s.target.material.texture.unwrap().grain.min())), [2.0, 20.0]);
        fills(&mut drawn.iter().map(|example| example.sensor.noise), [0.01, 0.05]);
        // White is 0.95 and cannot exceed 1.
        assert!(scenes().all(|s| s.target.material.color[0] <= 1.0));
        // Uniformly on a cap, the mean cosine is halfway between the axis and the rim.
        let cosines: Vec<f64> = scenes().map(|s| s.light.towards_light.dot(&nominal.towards_light)).collect();
        let rim = libm::cos(deg(40.0));
        fills(&mut cosines.iter().copied(), [rim, 1.0]);
        let mean = cosines.iter().sum::<f64>() / 200.0;
        assert!((mean - 0.5 * (1.0 + rim)).abs() < 0.02, "{mean}");
    }

    #[test]
    fn the_error_of_a_mount_is_bounded_and_the_target_stays_in_view() {
        let mut config = config("a", 1);
        (config.randomization.camera.shift_mm, config.randomization.camera.turn_deg) = (5.0, 3.0);
        let generator = ExampleGenerator::new(&config).unwrap();
        let nominal = generator.environment().camera.clone();
        let mut greatest = (0.0, 0.0);
        for index in 0..100 {
            let Example { placement, hand_from_camera, .. } = generator.example(index).unwrap();
            let error = nominal.hand_from_camera.inv_mul(&hand_from_camera);
            let (shift, turn) =
                (to_mm(error.translation.vector.amax()), to_deg(error.rotation.scaled_axis().amax()));
            assert!(shift <= 5.0 && turn <= 3.0 + 1e-9, "{shift} {turn}");
            greatest = (f64::max(greatest.0, shift), f64::max(greatest.1, turn));
            let camera = Camera { hand_from_camera, ..nominal.clone() };
            for hand in &placement.hands {
                assert!(camera.sees(&hand.pose.robot_from_hand(), &placement.scene.target_center()));
            }
        }
        assert!(greatest.0 > 4.5 && greatest.1 > 2.7, "{greatest:?}");
    }

    /// The images can be reproduced from the row alone.
    #[test]
    fn a_row_records_everything_that_its_images_show() {
        let mut config = dressed("c");
        (config.randomization.camera.shift_mm, config.randomization.camera.turn_deg) = (3.0, 1.0);
        config.randomization.camera.noise = [0.0, 0.0];
        let dir = tempfile::tempdir().unwrap();
        make(&config, dir.path()).unwrap();
        let stored =
            DatasetReader::open(dir.path()).unwrap().all::<SceneRow>().unwrap().next().unwrap().unwrap();
        let Example { placement, hand_from_camera, sensor, images, .. } = example(&config, 0);
        assert_eq!(stored.scene, placement.scene);
        let renderer = Renderer::new(Camera::new(&config.world.camera));
        for (hand, png) in placement.hands.iter().zip(&images) {
            let mut image = renderer.color(&stored.scene, &(hand.pose.robot_from_hand() * hand_from_camera));
            sensor.expose(&mut image, 0);
            assert_eq!(png::decode(png).unwrap(), image);
        }
    }

    #[test]
    fn spheres_and_any_yaw_are_drawn() {
        let mut config = config("c", 1);
        config.target.shapes = vec![ShapeName::Sphere];
        config.obstacles.shapes = vec![ShapeName::Sphere];
        for index in 0..5 {
            let scene = example(&config, index).placement.scene;
            for body in scene.bodies() {
                let Shape::Sphere { radius } = body.shape else { panic!("{:?}", body.shape) };
                assert!((15.0..=30.0).contains(&to_mm(radius)));
                assert!((body.robot_from_body.translation.z - radius - scene.table.height()).abs() < 1e-12);
            }
        }
        let mut config = crate::fixture::config("b", 1);
        (config.target.yaw_deg, config.target.hand_follows_yaw) = ([-60.0, 60.0], true);
        let mut turned = 0.0;
        for index in 0..30 {
            let placement = example(&config, index).placement;
            let (_, _, yaw) = placement.scene.target.robot_from_body.rotation.euler_angles();
            assert!(to_deg(yaw).abs() <= 60.0);
            turned = f64::max(turned, to_deg(yaw));
            let range = config.motions[placement.motion].current.psi_deg;
            assert!(to_deg(placement.hands[0].pose.angles.z - yaw).abs() <= range + 1e-9);
        }
        assert!(turned > 40.0, "{turned}");
    }

    #[test]
    fn an_invalid_value_is_named() {
        type Change = fn(&mut RandomizationConfig);
        let refused = |change: Change| {
            let mut config = config("a", 1);
            change(&mut config.randomization);
            config.validate().unwrap_err().to_string()
        };
        let low = refused(|r| r.light.cone_deg = 64.0);
        assert!(
            low.contains("randomization.light.cone_deg = 64") && low.contains("above the table"),
            "{low}"
        );
        let cases: [(Change, &str); 4] = [
            (|r| r.colors.cross = 1.5, "randomization.colors.cross = 1.5: expected 0 to 1"),
            (|r| r.texture.table.grain_mm = [0.0, 5.0], "randomization.texture.table.grain_mm = [0.0, 5.0]"),
            (|r| r.camera.blur = [2.0, 1.0], "randomization.camera.blur = [2.0, 1.0]"),
            (|r| r.camera.turn_deg = f64::NAN, "randomization.camera.turn_deg = NaN"),
        ];
        for (change, expected) in cases {
            let message = refused(change);
            assert!(message.starts_with(expected), "{message}");
        }
    }
}
