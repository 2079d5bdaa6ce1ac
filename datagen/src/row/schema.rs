//! What the columns of a dataset are: name, unit, meaning, type and content, each in one place.
//!
//! The types follow what Hugging Face's `datasets`, `DuckDB`, polars and pyarrow open without glue: every field is nullable
//! though it is never null, images are structs of `bytes` and `path` in this order, and the Arrow schema's metadata
//! describes the features.

use crate::config::{DatasetConfig, Kind};
use crate::error::Result;
use crate::example::{Collector, Example};
use crate::features;
use arrow_array::{
    ArrayRef, BinaryArray, FixedSizeListArray, Float32Array, Float64Array, Int64Array, RecordBatch,
    StringArray, StructArray, UInt64Array,
};
use arrow_schema::{DataType, Field, Fields, Schema};
use nalgebra::Isometry3;
use std::collections::HashMap;
use std::sync::Arc;
use world::LabelForm;
use world::pose::HandPose;

/// A column.
pub struct Column {
    /// Its name.
    pub name: &'static str,
    /// Unit of its numbers, or empty.
    pub unit: &'static str,
    /// What it holds, in a few words.
    pub meaning: &'static str,
    /// Its type and content.
    pub content: Content,
}

/// How a value is taken from an example.
type Of<T> = fn(&Collector<'_>, &Example) -> T;

/// Type and content of a column.
pub enum Content {
    /// The PNG of one of the example's hand poses, and the end of its logical name.
    Image(usize, &'static str),
    /// A whole number.
    Count(Of<u64>),
    /// An index into names.
    Class(Vec<String>, Of<u32>),
    /// A text.
    Text(Of<Result<String>>),
    /// A fixed number of numbers, exact.
    Doubles(u16, Of<Vec<f64>>),
    /// A fixed number of numbers, as networks take them.
    Floats(u16, Of<Vec<f32>>),
}

/// The columns of a dataset, in their order.
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
        column(
            "index",
            "",
            "row of the dataset, and number of its random stream",
            Content::Count(|_, e| e.index),
        ),
        column("seed", "", "seed of the dataset", Content::Count(|collector, _| collector.config().seed)),
        column(
            "motion",
            "",
            "pose ranges it was drawn from",
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
            "goal minus current pose",
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
            "avoidance map: 0 free, 1 blocked",
            Content::Floats(values, |_, e| e.avoidance.clone()),
        ),
        column("pose", "m, rad", POSE, Content::Doubles(6, |_, e| pose_of(e, 0))),
        column("joints", "rad", JOINTS, Content::Doubles(6, |_, e| joints_of(e, 0))),
    ]
}

fn surroundings() -> Vec<Column> {
    vec![
        column("target_shape", "", "cuboid or cylinder", {
            Content::Text(|_, e| Ok(e.placement.scene.target.shape.name().to_owned()))
        }),
        column("target_size", "m", "sides along the target's x, y and z", {
            Content::Doubles(3, |_, e| {
                (2.0 * e.placement.scene.target.shape.half_extents()).as_slice().to_vec()
            })
        }),
        column("target_position", "m", "the target's center in the robot frame", {
            Content::Doubles(3, |_, e| e.placement.scene.target_center().coords.as_slice().to_vec())
        }),
        column("obstacles", "", "number of obstacles", {
            Content::Count(|_, e| e.placement.scene.obstacles.len() as u64)
        }),
        column("scene", "m, rad", "the whole scene as JSON", {
            Content::Text(|_, e| Ok(serde_json::to_string(&e.placement.scene)?))
        }),
        column("camera", "pixels", "focal lengths fx, fy and principal point cx, cy", {
            Content::Doubles(4, |collector, _| {
                let camera = &collector.environment().camera;
                vec![camera.focal, camera.focal, camera.center.x, camera.center.y]
            })
        }),
        column("hand_from_camera", "m", "the camera on the hand: x y z, quaternion x y z w", {
            Content::Doubles(7, |_, e| {
                let Isometry3 { translation, rotation } = &e.hand_from_camera;
                translation.vector.iter().chain(rotation.coords.iter()).copied().collect()
            })
        }),
        column("sensor", "pixels, 1", "standard deviations of blur and of noise, a share of full scale", {
            Content::Doubles(2, |_, e| vec![e.sensor.blur, e.sensor.noise])
        }),
    ]
}

const POSE: &str = "hand in the robot frame: x y z, and the angles phi theta psi about x y z";
const JOINTS: &str = "joint angles of the left arm";

fn column(name: &'static str, unit: &'static str, meaning: &'static str, content: Content) -> Column {
    Column { name, unit, meaning, content }
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

/// The Arrow schema of a dataset.
pub fn schema(config: &DatasetConfig) -> Schema {
    let columns = columns(config);
    let fields: Fields = columns.iter().map(field).collect();
    let metadata = HashMap::from([(features::KEY.to_owned(), features::json(&columns))]);
    Schema::new_with_metadata(fields, metadata)
}

fn field(column: &Column) -> Field {
    let data_type = match &column.content {
        Content::Image(..) => DataType::Struct(image_fields()),
        Content::Count(_) => DataType::UInt64,
        Content::Class(..) => DataType::Int64,
        Content::Text(_) => DataType::Utf8,
        Content::Doubles(length, _) => list_of(DataType::Float64, *length),
        Content::Floats(length, _) => list_of(DataType::Float32, *length),
    };
    let field = Field::new(column.name, data_type, true);
    if column.unit.is_empty() {
        return field;
    }
    field.with_metadata(HashMap::from([("unit".to_owned(), column.unit.to_owned())]))
}

fn list_of(item: DataType, length: u16) -> DataType {
    DataType::FixedSizeList(Arc::new(Field::new("item", item, true)), i32::from(length))
}

fn image_fields() -> Fields {
    vec![Field::new("bytes", DataType::Binary, true), Field::new("path", DataType::Utf8, true)].into()
}

/// Examples as rows.
pub fn encode(collector: &Collector<'_>, examples: &[Example]) -> Result<RecordBatch> {
    let columns = columns(collector.config());
    let arrays = columns.iter().map(|column| array(column, collector, examples)).collect::<Result<_>>()?;
    Ok(RecordBatch::try_new(Arc::new(schema(collector.config())), arrays)?)
}

fn array(column: &Column, collector: &Collector<'_>, examples: &[Example]) -> Result<ArrayRef> {
    let list = |item: DataType, length: u16, values: ArrayRef| {
        FixedSizeListArray::try_new(Arc::new(Field::new("item", item, true)), i32::from(length), values, None)
    };
    Ok(match &column.content {
        Content::Image(view, suffix) => {
            let bytes = BinaryArray::from_iter_values(examples.iter().map(|e| &e.images[*view]));
            let name = &collector.config().name;
            let path = examples.iter().map(|e| format!("{name}/{:08}{suffix}.png", e.index));
            let path = StringArray::from_iter_values(path);
            Arc::new(StructArray::try_new(image_fields(), vec![Arc::new(bytes), Arc::new(path)], None)?)
        }
        Content::Count(of) => {
            Arc::new(UInt64Array::from_iter_values(examples.iter().map(|e| of(collector, e))))
        }
        Content::Class(_, of) => {
            Arc::new(Int64Array::from_iter_values(examples.iter().map(|e| i64::from(of(collector, e)))))
        }
        Content::Text(of) => {
            let texts = examples.iter().map(|e| of(collector, e)).collect::<Result<Vec<_>>>()?;
            Arc::new(StringArray::from_iter_values(texts))
        }
        Content::Doubles(length, of) => {
            let values = Float64Array::from_iter_values(examples.iter().flat_map(|e| of(collector, e)));
            Arc::new(list(DataType::Float64, *length, Arc::new(values))?)
        }
        Content::Floats(length, of) => {
            let values = Float32Array::from_iter_values(examples.iter().flat_map(|e| of(collector, e)));
            Arc::new(list(DataType::Float32, *length, Arc::new(values))?)
        }
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::tiny;
    use std::fmt::Write as _;

    fn described(schema: &Schema) -> String {
        schema.fields().iter().fold(String::new(), |mut text, field| {
            let unit = field.metadata().get("unit").map(|unit| format!(" [{unit}]")).unwrap_or_default();
            writeln!(text, "{}: {}{unit}", field.name(), field.data_type()).unwrap();
            text
        })
    }

    #[test]
    fn the_schemas_are_the_published_ones() {
        assert_eq!(described(&schema(&tiny::config("a", 1))), include_str!("../../testdata/approach.schema"));
        assert_eq!(
            described(&schema(&tiny::config("avoid", 1))),
            include_str!("../../testdata/avoidance.schema")
        );
    }

    /// One field that is not nullable, and `datasets` silently loses the images.
    #[test]
    fn every_field_and_every_child_is_nullable() {
        fn nullable(field: &Field) -> bool {
            field.is_nullable()
                && match field.data_type() {
                    DataType::Struct(fields) => fields.iter().all(|field| nullable(field)),
                    DataType::FixedSizeList(item, _) => nullable(item),
                    _ => true,
                }
        }
        for name in ["a", "avoid"] {
            assert!(schema(&tiny::config(name, 1)).fields().iter().all(|field| nullable(field)));
        }
    }
}
