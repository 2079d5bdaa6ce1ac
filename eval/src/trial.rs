//! What a session is given: a scene, a start and a goal (paper, Section 6.4), drawn as datasets draw theirs.

use crate::config::EvalConfig;
use crate::error::{Error, Result};
use datagen::Sampler;
use datagen::config::ObstacleConfig;
use datagen::scene::stream;
use image::RgbImage;
use nalgebra::{Isometry3, Translation3};
use rand::RngExt;
use world::Scene;
use world::arm::JointVector;
use world::environment::Environment;

/// One session's task.
#[derive(Debug, Clone, PartialEq)]
pub struct Trial {
    /// Its index.
    pub index: usize,
    /// Seed of the evaluation.
    pub seed: u64,
    /// What stands on the table.
    pub scene: Scene,
    /// Joint angles at the start \[rad\].
    pub start_joints: JointVector,
    /// Where the goal image was taken.
    pub robot_from_goal: Isometry3<f64>,
    /// What the wrist camera sees there.
    pub goal_image: RgbImage,
}

impl Trial {
    /// Draws trial `index`, a pure function of configuration and index: start and goal are within reach, touch nothing that
    /// `config.rejection` names and keep `config.clearance_mm` from them and
    /// the table, and the target is in view from both.
    pub fn draw(environment: &Environment, config: &EvalConfig, index: usize) -> Result<Self> {
        let mut rng = stream(config.seed, index as u64);
        // Drawn once, so that rejection does not favor the empty table.
        let [fewest, most] = config.obstacles.count;
        let count = rng.random_range(fewest..=most);
        let obstacles = ObstacleConfig { count: [count; 2], ..config.obstacles.clone() };
        let EvalConfig { target, motions, rejection, .. } = config;
        let sampler = Sampler::new(environment, target, &obstacles, motions, rejection);
        for _ in 0..rejection.tries {
            let drawn = sampler.draw(&mut rng);
            let placement = drawn.map_err(|source| Error::Trial { index, source })?;
            // A validated motion has a current and a goal pose, in this order.
            let [start, goal] = [placement.hands[0], placement.hands[1]];
            let hands = [start.pose, goal.pose].map(|pose| pose.robot_from_hand());
            let scene = placement.scene;
            if hands.iter().all(|hand| is_clear(environment, hand, &scene, config.clearance())) {
                let [_, robot_from_goal] = hands;
                let goal_image = environment.wrist_image(&scene, &robot_from_goal);
                return Ok(Self {
                    index,
                    seed: config.seed,
                    scene,
                    start_joints: start.joints,
                    robot_from_goal,
                    goal_image,
                });
            }
        }
        Err(Error::Crowded { index, tries: rejection.tries })
    }
}

/// Does a hand keep a distance from the obstacles, and above the table?
fn is_clear(
    environment: &Environment,
    robot_from_hand: &Isometry3<f64>,
    scene: &Scene,
    clearance: f64,
) -> bool {
    let lowered = Translation3::new(0.0, 0.0, -clearance) * robot_from_hand;
    let hand = &environment.hand;
    hand.clearance(robot_from_hand, scene) >= clearance && !hand.contacts(&lowered, scene).table
}

#[cfg(test)]
mod tests {
    use super::*;

    fn config() -> EvalConfig {
        let mut table: toml::Table = toml::from_str(include_str!("../../configs/eval/table1.toml")).unwrap();
        let world: toml::Table = toml::from_str(include_str!("../../configs/world.toml")).unwrap();
        table.insert("world".into(), world.into());
        let mut config: EvalConfig = table.try_into().unwrap();
        (config.world.camera.width, config.world.camera.height) = (64, 48);
        config
    }

    #[test]
    fn a_trial_is_a_function_of_configuration_and_index() {
        let config = config();
        let environment = Environment::new(&config.world).unwrap();
        let draw = |index| Trial::draw(&environment, &config, index).unwrap();
        assert_eq!(draw(3), draw(3));
        assert_ne!(draw(3).scene, draw(4).scene);
    }

    #[test]
    fn start_and_goal_are_within_reach_in_view_and_clear() {
        let config = config();
        let environment = Environment::new(&config.world).unwrap();
        let mut counts = [0; 4];
        for index in 0..30 {
            let trial = Trial::draw(&environment, &config, index).unwrap();
            counts[trial.scene.obstacles.len()] += 1;
            assert!(environment.arm.within_limits(&trial.start_joints));
            for hand in [environment.arm.robot_from_hand(&trial.start_joints), trial.robot_from_goal] {
                assert!(environment.hand.clearance(&hand, &trial.scene) >= config.clearance());
                assert!(!environment.hand.contacts(&hand, &trial.scene).any());
                assert!(environment.camera.sees(&hand, &trial.scene.target_center()));
            }
            assert_eq!(trial.goal_image, environment.wrist_image(&trial.scene, &trial.robot_from_goal));
        }
        assert!(counts.iter().all(|&count| count >= 2), "obstacles per trial: {counts:?}");
    }

    #[test]
    fn obstacles_that_leave_no_room_are_an_error_that_says_so() {
        let mut config = config();
        config.obstacles.count = [1, 1];
        config.rejection.tries = 20;
        config.clearance_mm = 900.0;
        let environment = Environment::new(&config.world).unwrap();
        let error = Trial::draw(&environment, &config, 5).unwrap_err().to_string();
        assert!(error.contains("session 5") && error.contains("clearance_mm"), "{error}");
    }
}
