//! Configuration and handmade sessions for unit tests.

use crate::config::EvalConfig;
use crate::mediate::quadratic_program::QpStatus;
use crate::session::deflect::DeflectionKind;
use crate::session::displace::Touched;
use crate::session::outcome::Outcome;
use crate::session::record::{SessionRecord, Step};
use crate::session::timing::StageSeconds;
use crate::trial::Trial;
use image::RgbImage;
use nalgebra::{Isometry3, Vector3};
use world::arm::JointVector;
use world::pose::HandPose;
use world::units::{deg, mm};
use world::{Environment, PoseChange, Shape};

/// The sessions of Table 1 with a small camera, which does not matter to oracles.
pub(crate) fn eval_config(sessions: usize) -> EvalConfig {
    let mut table: toml::Table = toml::from_str(include_str!("../../configs/eval/table1.toml")).unwrap();
    let world: toml::Table = toml::from_str(include_str!("../../configs/world.toml")).unwrap();
    table.insert("world".into(), world.into());
    let mut config: EvalConfig = table.try_into().unwrap();
    (config.world.camera.width, config.world.camera.height) = (64, 48);
    config.sessions = sessions;
    config.validate().unwrap();
    config
}

/// A session with a cuboid as target and `index % 4` obstacles. The distance to the goal shrinks by 30 % per step. The session
/// ends `0.2 (1 + index)` mm away in x after `12 + index` steps. Each step spends 20 ms in the approach policy.
pub(crate) fn session(index: usize) -> SessionRecord {
    let environment = Environment::new(&eval_config(1).world).unwrap();
    let at = |x: f64, y: f64, z: f64| Isometry3::translation(mm(x), mm(y), mm(z));
    let cuboid =
        |x: f64, y: f64, z: f64| Shape::Cuboid { half_extents: Vector3::new(mm(x), mm(y), mm(z)) / 2.0 };
    let obstacles = [
        (cuboid(50.0, 70.0, 60.0), at(440.0, 120.0, 10.0)),
        (Shape::Cylinder { radius: mm(25.0), half_height: mm(30.0) }, at(300.0, 250.0, 10.0)),
        (cuboid(40.0, 40.0, 40.0), at(450.0, 250.0, 0.0)),
    ];
    let target = (cuboid(50.0, 90.0, 40.0), at(360.0, 180.0, 0.0));
    let scene = environment.scene(target, obstacles[..index % 4].to_vec());
    let pose = |x: f64, y: f64, z: f64, yaw: f64| HandPose {
        position: Vector3::new(mm(x), mm(y), mm(z)),
        angles: Vector3::new(0.0, deg(2.0), deg(yaw)),
    };
    let goal = pose(360.0, 180.0, 80.0, 3.0).robot_from_hand();
    let start = pose(300.0 + 10.0 * index as f64, 240.0, 190.0, 20.0).robot_from_hand();
    let end = pose(360.0 + 0.2 * (1.0 + index as f64), 180.0, 80.0, 3.0).robot_from_hand();
    let start_joints = environment.arm.joints_for(&start).unwrap();
    let way = PoseChange::log(&end.inv_mul(&start));
    let count = 12 + index;
    let steps: Vec<Step> = (1..=count)
        .map(|k| {
            let left = if k == count { 0.0 } else { 0.7f64.powi(i32::try_from(k).unwrap()) };
            let hand = end * way.scaled(left).exp();
            step(hand, environment.arm.joints_for(&hand).unwrap())
        })
        .collect();
    let goal_image = RgbImage::new(1, 1);
    let trial = Trial { index, seed: 1, scene, start_joints, robot_from_goal: goal, goal_image };
    SessionRecord::new(&environment, &trial, Outcome::Converged, steps)
}

fn step(robot_from_hand: Isometry3<f64>, joints: JointVector) -> Step {
    Step {
        desired: PoseChange::zero(),
        deflected: PoseChange::zero(),
        deflection: DeflectionKind::Kept,
        threshold: 0.7,
        displacement: JointVector::zeros(),
        qp: QpStatus::Solved,
        slack: 0.0,
        robot_from_hand,
        joints,
        touched: Touched::default(),
        target_in_view: true,
        within_limits: true,
        seconds: StageSeconds { render: 0.005, approach: 0.02, avoid: 0.01, deflect: 1e-5, qp: 2e-4 },
    }
}
