//! The columns of a dataset: name, unit, description, type and content, each defined once.

use super::example::{Example, ExampleGenerator};
use crate::config::{DatasetConfig, Kind};
use crate::error::Result;
use nalgebra::Isometry3;
use world::LabelForm;
use world::pose::HandPose;

/// A column of a dataset.
pub struct Column {
    /// Name.
    pub name: &'static str,
    /// Unit of the numbers, or empty.
    pub unit: &'static str,
    /// Short description.
    pub description: &'static str,
    /// Type and content.
    pub content: Content,
}

/// Function that extracts a value from an example.
type Extract<T> = fn(&ExampleGenerator<'_>, &Example) -> T;

/// Type and content of a column.
pub enum Content {
    /// The PNG image at a hand pose: index of the pose, and suffix of the logical file name.
    Image(usize, &'static str),
    /// An unsigned integer.
    Count(Extract<u64>),
    /// A class label: the names of all classes, and an index into them.
    Class(Vec<String>, Extract<u32>),
    /// A string.
    Text(Extract<Result<String>>),
    /// A list of fixed length in double precision.
    Doubles(u16, Extract<Vec<f64>>),
    /// A list of fixed length in single precision, as networks use it.
    Floats(u16, Extract<Vec<f32>>),
}

/// Returns the columns of a dataset, in order.
pub fn columns(config: &DatasetConfig) -> Vec<Column> {
    let mut columns = identity(config);
    columns.extend(match config.kind {
        Kind::Approach => approach(),
        Kind::Avoidance => avoidance(config),
    });
    columns.extend(surroundings());
    columns
}

fn identity(config: &DatasetConfig) -> Vec<Column> {
    let motions = config.motions.iter().map(|motion| motion.name.clone()).collect();
    vec![
        column("index", "", "row number, and number of the random stream", Content::Count(|_, e| e.index)),
        column("seed", "", "seed of the dataset", Content::Count(|generator, _| generator.config().seed)),
        column(
            "motion",
            "",
            "pose ranges of the motion",
            Content::Class(motions, |_, e| e.placement.motion as u32),
        ),
    ]
}

fn approach() -> Vec<Column> {
    vec![
        column("image_current", "", "wrist image at the current pose", Content::Image(0, "_current")),
        column("image_goal", "", "wrist image at the goal pose", Content::Image(1, "_goal")),
        column(
            "twist",
            "m, rad",
            "log(current^-1 goal) in se(3), in the current hand frame, translation first",
            Content::Doubles(6, |_, e| label_of(LabelForm::Twist, e)),
        ),
        column(
            "difference",
            "m, rad",
            "goal pose minus current pose",
            Content::Doubles(6, |_, e| label_of(LabelForm::Difference, e)),
        ),
        column("pose_current", "m, rad", POSE, Content::Doubles(6, |_, e| pose_of(e, 0))),
        column("pose_goal", "m, rad", POSE, Content::Doubles(6, |_, e| pose_of(e, 1))),
        column("joints_current", "rad", JOINTS, Content::Doubles(6, |_, e| joints_of(e, 0))),
        column("joints_goal", "rad", JOINTS, Content::Doubles(6, |_, e| joints_of(e, 1))),
    ]
}

fn avoidance(config: &DatasetConfig) -> Vec<Column> {
    let values = config.world.avoidance.measuring_points as u16;
    vec![
        column("image", "", "wrist image", Content::Image(0, "")),
        column(
            "values",
            "",
            "avoidance map, from 0 (free) to 1 (blocked)",
            Content::Floats(values, |_, e| e.avoidance.clone()),
        ),
        column("pose", "m, rad", POSE, Content::Doubles(6, |_, e| pose_of(e, 0))),
        column("joints", "rad", JOINTS, Content::Doubles(6, |_, e| joints_of(e, 0))),
    ]
}

fn surroundings() -> Vec<Column> {
    vec![
        column(
            "target_shape",
            "",
            "cuboid, cylinder or sphere",
            Content::Text(|_, e| Ok(e.placement.scene.target.shape.name().to_owned())),
        ),
        column(
            "target_size",
            "m",
            "size along the x, y and z axes of the target",
            Content::Doubles(3, |_, e| {
                (2.0 * e.placement.scene.target.shape.half_extents()).as_slice().to_vec()
            }),
        ),
        column(
            "target_position",
            "m",
            "center of the target in the robot frame",
            Content::Doubles(3, |_, e| e.placement.scene.target_center().coords.as_slice().to_vec()),
        ),
        column(
            "obstacles",
            "",
            "number of obstacles",
            Content::Count(|_, e| e.placement.scene.obstacles.len() as u64),
        ),
        column(
            "scene",
            "m, rad",
            "complete scene as JSON",
            Content::Text(|_, e| Ok(serde_json::to_string(&e.placement.scene)?)),
        ),
        column(
            "camera",
            "pixels",
            "focal lengths fx, fy and principal point cx, cy",
            Content::Doubles(4, |generator, _| {
                let camera = &generator.environment().camera;
                vec![camera.focal, camera.focal, camera.center.x, camera.center.y]
            }),
        ),
        column(
            "hand_from_camera",
            "m",
            "camera mount on the hand: x y z, quaternion x y z w",
            Content::Doubles(7, |_, e| {
                let Isometry3 { translation, rotation } = &e.hand_from_camera;
                translation.vector.iter().chain(rotation.coords.iter()).copied().collect()
            }),
        ),
        column(
            "sensor",
            "pixels, 1",
            "standard deviations of blur (pixels) and noise (share of full scale)",
            Content::Doubles(2, |_, e| vec![e.sensor.blur, e.sensor.noise]),
        ),
    ]
}

const POSE: &str = "hand pose in the robot frame: x y z, and the angles phi theta psi about x y z";
const JOINTS: &str = "joint angles of the left arm";

fn column(name: &'static str, unit: &'static str, description: &'static str, content: Content) -> Column {
    Column { name, unit, description, content }
}

fn label_of(form: LabelForm, example: &Example) -> Vec<f64> {
    let [current, goal] = [0, 1].map(|i| example.placement.hands[i].pose.robot_from_hand());
    form.label(&current, &goal).to_array().to_vec()
}

fn pose_of(example: &Example, hand: usize) -> Vec<f64> {
    let HandPose { position, angles } = example.placement.hands[hand].pose;
    position.iter().chain(angles.iter()).copied().collect()
}

fn joints_of(example: &Example, hand: usize) -> Vec<f64> {
    example.placement.hands[hand].joints.as_slice().to_vec()
}
