//! The paper's numbered equations and ranges, each against an independent oracle: a closed form, finite differences, brute
//! force, or the printed numbers.

use crate::support::repository;
use approx::assert_relative_eq;
use datagen::DatasetConfig;
use datagen::config::RangeConfig;
use eval::config::{DeflectionConfig, DeflectionMode, MediationConfig};
use eval::mediate::Mediator;
use eval::mediate::field_of_view::interaction_matrix;
use eval::session::deflect::{DeflectionKind, Deflector};
use nalgebra::{Isometry3, Matrix6, Point3, UnitQuaternion, UnitVector3, Vector3, Vector6};
use world::arm::JointVector;
use world::pose::{HandPose, adjoint};
use world::{AvoidanceMap, Environment, MeasuringPoints, PoseChange, Shape, WorldConfig, hiro};

fn environment() -> Environment {
    let text = std::fs::read_to_string(repository().join("configs/world.toml")).unwrap();
    Environment::new(&toml::from_str::<WorldConfig>(&text).unwrap()).unwrap()
}

fn looking_down(x: f64, y: f64, z: f64) -> Isometry3<f64> {
    HandPose { position: Vector3::new(x, y, z), angles: Vector3::zeros() }.robot_from_hand()
}

#[test]
fn eq_1_a_single_element_gives_the_cosine_to_it() {
    // Eq. (1)
    let environment = environment();
    let at = |x: f64, y: f64, z: f64| Isometry3::translation(x, y, z);
    let element = Shape::Cuboid { half_extents: Vector3::repeat(0.005) };
    let place = Point3::new(0.40, 0.25, 0.05);
    let scene =
        environment.scene((element, at(0.36, 0.18, 0.0)), vec![(element, at(place.x, place.y, place.z))]);
    let hand = looking_down(0.36, 0.18, 0.15);
    let mut origins = vec![Point3::from(hand.translation.vector)];
    origins.extend(environment.hand.reference_points().iter().map(|point| hand * point));
    let map = environment.avoidance_map(&scene, &hand);
    for (g, value) in environment.measuring_points.directions().iter().zip(&map.values) {
        let cosine = |origin: &Point3<f64>| g.dot(&(place - origin)) / (place - origin).norm();
        let expected = origins.iter().map(cosine).fold(0.0, f64::max);
        assert_relative_eq!(*value, expected, epsilon = 1e-12);
    }
}

/// A map with 0.9 within 60 degrees of straight down, and 0.1 elsewhere.
fn blocked_below(points: &MeasuringPoints) -> AvoidanceMap {
    let value = |g: &UnitVector3<f64>| if g.z < -0.5 { 0.9 } else { 0.1 };
    AvoidanceMap { values: points.directions().iter().map(value).collect() }
}

fn deflection(mode: DeflectionMode) -> DeflectionConfig {
    DeflectionConfig { mode, threshold: 0.5, epsilon: 0.05, max_threshold: 0.95, min_progress: 0.0 }
}

#[test]
fn eq_2_keeps_length_and_rotation_and_takes_the_best_admitted_direction() {
    // Eq. (2)
    let points = MeasuringPoints::spiral(180);
    let map = blocked_below(&points);
    let hand = UnitQuaternion::from_euler_angles(0.1, -0.2, 0.7);
    let wanted = Vector3::new(0.004, 0.001, -0.012);
    let desired =
        PoseChange { translation: hand.inverse() * wanted, rotation: Vector3::new(0.01, 0.02, 0.03) };
    for mode in [DeflectionMode::Paper, DeflectionMode::Keep] {
        let deflected = Deflector::new(&deflection(mode), &points).deflect(&desired, &map, &hand).unwrap();
        let mut best = (f64::NEG_INFINITY, Vector3::zeros());
        for g in points.directions().iter().filter(|g| g.z >= -0.5) {
            if g.dot(&wanted) > best.0 {
                best = (g.dot(&wanted), g.into_inner());
            }
        }
        assert_eq!(deflected.kind, DeflectionKind::Turned);
        assert_relative_eq!(hand * deflected.motion.translation, best.1 * wanted.norm(), epsilon = 1e-12);
        assert_relative_eq!(deflected.motion.rotation, desired.rotation);
    }
}

#[test]
fn eq_3_raises_the_threshold_where_no_admitted_direction_leads_forward() {
    // Eq. (3)
    let points = MeasuringPoints::spiral(180);
    let forward_blocked = |g: &UnitVector3<f64>| if g.x > -0.05 { 0.9 } else { 0.1 };
    let map = AvoidanceMap { values: points.directions().iter().map(forward_blocked).collect() };
    let mut deflector = Deflector::new(&deflection(DeflectionMode::Paper), &points);
    let mut thresholds = |x: f64| -> Vec<f64> {
        let desired = PoseChange { translation: Vector3::new(x, 0.0, 0.0), rotation: Vector3::zeros() };
        let mut deflect = || deflector.deflect(&desired, &map, &UnitQuaternion::identity()).unwrap();
        (0..3).map(|_| deflect().threshold).collect()
    };
    assert_relative_eq!(thresholds(-0.01)[..], [0.5, 0.5, 0.5], epsilon = 1e-12);
    assert_relative_eq!(thresholds(0.01)[..], [0.5, 0.55, 0.6], epsilon = 1e-12);
}

fn mediation() -> MediationConfig {
    MediationConfig {
        rotation_weight_mm: 100.0,
        damping: 1e-6,
        period_s: 1.0,
        image_margin: 0.02,
        slack_weight: 1.0,
    }
}

/// A point in the center of the image.
fn in_sight(environment: &Environment, joints: &JointVector) -> Point3<f64> {
    environment.arm.robot_from_hand(joints) * Point3::new(0.0, 0.0, 0.1)
}

#[test]
fn eq_4_5_6_without_active_constraints_the_program_is_weighted_least_squares() {
    // Eq. (4), Eq. (5), Eq. (6)
    let environment = environment();
    let joints = hiro::init();
    let mediator = Mediator::new(&mediation(), &environment.camera);
    let v = PoseChange::from_array([0.004, -0.003, 0.005, 0.01, -0.02, 0.015]);
    let command = mediator.solve(&environment.arm, &joints, &v, &in_sight(&environment, &joints));
    let j = environment.arm.jacobian(&joints);
    let w = Matrix6::from_diagonal(&Vector6::new(1.0, 1.0, 1.0, 0.01, 0.01, 0.01));
    let normal = j.transpose() * w * j + Matrix6::identity() * 1e-6;
    let expected = normal.lu().solve(&(j.transpose() * w * v.to_vector())).unwrap();
    assert_relative_eq!(command.displacement, expected, epsilon = 1e-6);
    // The hand moves toward its goal; with the printed sign of c it would move away.
    let moved = environment
        .arm
        .robot_from_hand(&joints)
        .inv_mul(&environment.arm.robot_from_hand(&(joints + expected)));
    assert_relative_eq!(PoseChange::log(&moved).to_vector(), v.to_vector(), epsilon = 1e-3);
}

#[test]
fn eq_7_joints_stop_at_their_limits_and_at_their_speed() {
    // Eq. (7)
    let environment = environment();
    let limits = environment.arm.limits();
    let mut joints = hiro::init();
    joints[2] = limits.lower[2] + 0.01;
    let mediator = Mediator::new(&MediationConfig { period_s: 0.05, ..mediation() }, &environment.camera);
    for seed in 0..20 {
        let direction = Vector6::from_fn(|i, _| (f64::from(seed) * 1.7 + i as f64 * 2.3).sin());
        let v = PoseChange::from_array((direction * 0.5).into());
        let command = mediator.solve(&environment.arm, &joints, &v, &in_sight(&environment, &joints));
        assert!(command.status.is_solved());
        assert!(environment.arm.within_limits(&(joints + command.displacement)), "{command:?}");
        for joint in 0..6 {
            assert!(
                command.displacement[joint].abs() <= limits.max_velocity[joint] * 0.05 + 1e-9,
                "{command:?}"
            );
        }
    }
}

#[test]
fn eq_8_the_image_of_the_target_moves_as_predicted_and_stays_in_the_image() {
    // Eq. (8)
    let environment = environment();
    let joints = hiro::init();
    let target = environment.arm.robot_from_hand(&joints) * Point3::new(0.03, -0.05, 0.1);
    let image = |joints: &JointVector| {
        let robot_from_camera = environment.arm.robot_from_hand(joints) * environment.camera.hand_from_camera;
        let point = robot_from_camera.inverse_transform_point(&target);
        (point.xy().coords / point.z, point.z)
    };
    let (e, depth) = image(&joints);
    let camera_from_hand = adjoint(&environment.camera.hand_from_camera.inverse());
    let predicted = interaction_matrix(&e, depth) * camera_from_hand * environment.arm.jacobian(&joints);
    for joint in 0..6 {
        let mut nudge = JointVector::zeros();
        nudge[joint] = 1e-6;
        let central = (image(&(joints + nudge)).0 - image(&(joints - nudge)).0) / 2e-6;
        assert_relative_eq!(predicted.column(joint).into_owned(), central, epsilon = 1e-7);
    }
    // A motion that would lose the target sideways is followed only while the target stays in view.
    let mediator = Mediator::new(&mediation(), &environment.camera);
    let lose = PoseChange::from_array([0.0, 0.08, 0.0, 0.0, 0.0, 0.0]);
    let mut now = joints;
    for _ in 0..10 {
        now += mediator.solve(&environment.arm, &now, &lose.capped(0.02, 0.1), &target).displacement;
        assert!(environment.camera.sees(&environment.arm.robot_from_hand(&now), &target));
    }
    assert!((now - joints).norm() > 1e-3, "the part of the motion that keeps the target in view is followed");
}

/// The numbers of a range, in the order of the paper.
fn numbers(range: &RangeConfig) -> [f64; 7] {
    [range.reference_mm, range.x_mm, range.y_mm, range.z_mm, range.phi_deg, range.theta_deg, range.psi_deg]
}

fn dataset(name: &str) -> DatasetConfig {
    let read = |name: &str| std::fs::read_to_string(repository().join("configs").join(name)).unwrap();
    let mut table: toml::Table = read(&format!("datasets/{name}.toml")).parse().unwrap();
    for extended in ["world", "randomization"] {
        let below = read(&format!("{extended}.toml")).parse().unwrap();
        table.insert(extended.to_owned(), toml::Value::Table(below));
    }
    DatasetConfig::from_table(table).unwrap()
}

#[test]
fn section_6_2_ranges_sizes_and_counts_are_the_papers() {
    let range_1 = [150.0, 100.0, 100.0, 100.0, 5.0, 5.0, 30.0];
    let range_2a = [80.0, 50.0, 50.0, 30.0, 5.0, 5.0, 10.0];
    let range_2b = [80.0, 10.0, 10.0, 10.0, 5.0, 5.0, 5.0];
    let range_b = [80.0, 30.0, 30.0, 20.0, 5.0, 5.0, 10.0];
    let ranges = |config: &DatasetConfig| -> Vec<[f64; 7]> {
        config.motions.iter().flat_map(|motion| motion.ranges().map(numbers).collect::<Vec<_>>()).collect()
    };
    let [a, b, c, avoid] = ["a", "b", "c", "avoid"].map(dataset);
    assert_eq!([a.count, b.count, c.count], [20_000, 20_000, 12_000]);
    assert_eq!(ranges(&a), [range_1, range_1, range_2a, range_2b]);
    assert_eq!(ranges(&b), [range_b, range_b, range_2b, range_2b]);
    assert_eq!(ranges(&c), ranges(&b));
    for config in [&b, &c, &avoid] {
        let target = &config.target;
        let sides = [target.short_side_mm, target.long_side_mm, target.height_mm];
        assert_eq!(sides, [[30.0, 60.0], [40.0, 150.0], [20.0, 60.0]]);
    }
    assert_eq!((avoid.obstacles.count, avoid.obstacles.distance_mm), ([0, 3], [70.0, 120.0]));
    assert_eq!(a.obstacles.count, [0, 0]);
    assert!(c.obstacles.count[0] >= 1);
    let camera = &a.world.camera;
    assert_eq!((camera.width, camera.height, a.world.avoidance.measuring_points), (640, 480, 180));
}
