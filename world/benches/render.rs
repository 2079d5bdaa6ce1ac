//! Time per image, avoidance map, contact test and inverse kinematics: `cargo bench -p world`.
#![allow(clippy::unwrap_used)]

use divan::Bencher;
use divan::counter::ItemsCount;
use nalgebra::{Isometry3, Vector3};
use world::config::CameraConfig;
use world::pose::HandPose;
use world::{Arm, Camera, Environment, Renderer, Scene, Shape, WorldConfig};

fn main() {
    divan::main();
}

/// Scene of a benchmark.
#[derive(Debug, Clone, Copy)]
enum Table {
    /// A cuboid, as in Dataset A.
    Cuboid,
    /// A cylinder and three obstacles, as in Dataset C.
    Obstacles,
    /// The same, with the arm seen from outside: balls and slanted cylinders.
    Arm,
}

const TABLES: [Table; 3] = [Table::Cuboid, Table::Obstacles, Table::Arm];

/// Size of the images in which the area of the target is measured \[pixels\].
const JUDGED: (u32, u32) = (64, 48);

fn environment() -> Environment {
    let config: WorldConfig = toml::from_str(include_str!("../../configs/world.toml")).unwrap();
    Environment::new(&config).unwrap()
}

fn cuboid(sides_mm: [f64; 3]) -> Shape {
    Shape::Cuboid { half_extents: Vector3::from(sides_mm) * 0.5e-3 }
}

fn scene(environment: &Environment, table: Table) -> Scene {
    let on_table = |shape: Shape, x: f64, y: f64, yaw: f64| {
        let place = Vector3::new(x, y, shape.half_extents().z - 0.02);
        (shape, Isometry3::new(place, Vector3::z() * yaw))
    };
    let can = Shape::Cylinder { radius: 0.025, half_height: 0.02 };
    let target = if matches!(table, Table::Cuboid) { cuboid([60.0, 40.0, 40.0]) } else { can };
    let obstacles = [
        on_table(cuboid([120.0, 40.0, 50.0]), 0.36, 0.27, 0.4),
        on_table(cuboid([80.0, 50.0, 30.0]), 0.45, 0.17, -1.1),
        on_table(can, 0.31, 0.11, 0.0),
    ];
    let count = if matches!(table, Table::Cuboid) { 0 } else { 3 };
    let mut scene = environment.scene(on_table(target, 0.36, 0.18, 0.0), obstacles[..count].to_vec());
    if matches!(table, Table::Arm) {
        let joints = environment.arm.joints_for(&hand().robot_from_hand()).unwrap();
        scene.obstacles.extend(environment.arm.bodies(&joints, [0.5; 3]));
    }
    scene
}

/// A slightly turned and tilted pose 80 mm above the target.
fn hand() -> HandPose {
    HandPose { position: Vector3::new(0.37, 0.17, 0.08), angles: Vector3::new(0.05, -0.04, 0.1) }
}

/// Returns the camera pose: at the wrist, or beside the table to see the arm.
fn view(environment: &Environment, table: Table) -> Isometry3<f64> {
    match table {
        Table::Arm => {
            let beside = Vector3::new(1.1, -0.5, 0.6);
            Isometry3::face_towards(&beside.into(), &Vector3::new(0.3, 0.1, 0.1).into(), &-Vector3::z())
        }
        _ => hand().robot_from_hand() * environment.camera.hand_from_camera,
    }
}

/// A color image of 640 x 480 pixels.
#[divan::bench(args = TABLES)]
fn color_vga(bencher: Bencher, table: Table) {
    let environment = environment();
    let (scene, view) = (scene(&environment, table), view(&environment, table));
    bencher.counter(ItemsCount::new(1_u32)).bench(|| environment.renderer.color(&scene, &view));
}

/// Color, depth and instance maps of 64 x 48 pixels.
#[divan::bench(args = TABLES)]
fn frame_judged(bencher: Bencher, table: Table) {
    let environment = environment();
    let (scene, view) = (scene(&environment, table), view(&environment, table));
    let (width, height) = JUDGED;
    let camera = CameraConfig { width, height, ..environment.config.camera.clone() };
    let judge = Renderer::new(Camera::new(&camera));
    bencher.counter(ItemsCount::new(1_u32)).bench(|| judge.frame(&scene, &view));
}

/// Eq. (1) for three obstacles and 180 measuring points.
#[divan::bench]
fn avoidance_map(bencher: Bencher) {
    let environment = environment();
    let (scene, hand) = (scene(&environment, Table::Obstacles), hand().robot_from_hand());
    bencher.counter(ItemsCount::new(1_u32)).bench(|| environment.avoidance_map(&scene, &hand));
}

/// Contacts of the hand with the scene.
#[divan::bench]
fn contacts(bencher: Bencher) {
    let environment = environment();
    let (scene, hand) = (scene(&environment, Table::Obstacles), hand().robot_from_hand());
    bencher.counter(ItemsCount::new(1_u32)).bench(|| environment.hand.contacts(&hand, &scene));
}

/// Inverse kinematics for a reachable and an unreachable pose.
#[divan::bench(args = [0.37, 0.60])]
fn joints(bencher: Bencher, x: f64) {
    let arm: Arm = environment().arm;
    let mut pose = hand();
    pose.position.x = x;
    let pose = pose.robot_from_hand();
    bencher.counter(ItemsCount::new(1_u32)).bench(|| arm.joints_for(&pose));
}
