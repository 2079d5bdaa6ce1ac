//! Bodies, scenes and poses for unit tests.

use crate::pose::HandPose;
use crate::scene::{Body, Light, Material, Scene, Shape, Table};
use nalgebra::{Isometry3, Point3, Vector3};
use proptest::prelude::*;

/// A cuboid with these sides \[m\].
pub(crate) fn cuboid(sides: [f64; 3]) -> Shape {
    Shape::Cuboid { half_extents: Vector3::from(sides) / 2.0 }
}

/// A gray body, turned by a rotation vector.
pub(crate) fn body(shape: Shape, position: [f64; 3], turn: [f64; 3]) -> Body {
    let robot_from_body = Isometry3::new(position.into(), turn.into());
    Body { shape, robot_from_body, material: Material { color: [0.5; 3], cross: None, texture: None } }
}

/// A gray cuboid parallel to the robot's axes.
pub(crate) fn block(sides: [f64; 3], center: [f64; 3]) -> Body {
    body(cuboid(sides), center, [0.0; 3])
}

/// A 40 mm cube as the target, in the middle of a table at height 0, and obstacles.
pub(crate) fn scene(obstacles: Vec<Body>) -> Scene {
    Scene {
        table: Table { center: Point3::origin(), half_size: [0.5; 2], color: [0.5; 3], texture: None },
        target: block([0.04; 3], [0.0, 0.0, 0.02]),
        obstacles,
        light: Light { towards_light: Vector3::z_axis(), ambient: 0.5 },
        background: [0.0; 3],
    }
}

/// Hand poses anywhere near the robot, away from the gimbal lock of their angles.
pub(crate) fn poses() -> impl Strategy<Value = HandPose> {
    (prop::array::uniform3(-0.5..0.5f64), prop::array::uniform3(-1.2..1.2f64))
        .prop_map(|(p, a)| HandPose { position: p.into(), angles: a.into() })
}
