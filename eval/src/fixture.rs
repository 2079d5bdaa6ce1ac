//! Sessions made by hand, for the tests of tables, figures and report.

use crate::deflect::Course;
use crate::mediate::QpStatus;
use crate::trace::{ContactCounts, Outcome, SessionRecord, StageSeconds, Step, Touched};
use nalgebra::{Isometry3, Vector3};
use world::arm::JointVector;
use world::environment::Environment;
use world::pose::HandPose;
use world::units::{deg, mm};
use world::{LabelForm, PoseChange, Shape, WorldConfig};

/// The environment of `configs/world.toml`.
pub(crate) fn environment() -> Environment {
    let config: WorldConfig = toml::from_str(include_str!("../../configs/world.toml")).unwrap();
    Environment::new(&config).unwrap()
}

/// A session over a cuboid with `index % 4` obstacles that nears its goal by 30 % a step and stops `0.2 (1 + index)` mm away
/// in x after `12 + index` steps; every step takes 20 ms in the approach policy.
pub(crate) fn session(index: usize) -> SessionRecord {
    let environment = environment();
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
    let mut seconds = StageSeconds::default();
    for step in &steps {
        seconds += step.seconds;
    }
    SessionRecord {
        index,
        seed: 1,
        outcome: Outcome::Converged,
        scene,
        robot_from_start: start,
        start_joints,
        robot_from_goal: goal,
        robot_from_final: end,
        final_error: LabelForm::Difference.label(&goal, &end).to_array(),
        position_error: (end.translation.vector - goal.translation.vector).norm(),
        orientation_error: end.rotation.angle_to(&goal.rotation),
        contacts: ContactCounts::default(),
        target_lost_steps: 0,
        limit_violations: 0,
        seconds,
        steps,
    }
}

fn step(robot_from_hand: Isometry3<f64>, joints: JointVector) -> Step {
    Step {
        desired: PoseChange::zero(),
        deflected: PoseChange::zero(),
        course: Course::Kept,
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
