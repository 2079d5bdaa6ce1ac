//! Rows: an [`Example`] is generated, encoded as Arrow columns, and decoded again.
//!
//! The columns are defined once, in `column.rs`; schema, Hugging Face features, card and encoder all follow from there.

mod batch;
mod column;
mod decode;
mod encode;
mod example;
pub mod features;
pub mod png;
mod schema;

pub use batch::Batch;
pub use column::{Column, Content, columns};
pub use decode::{ApproachRow, AvoidanceRow, CameraRow, ImagesRow, MotionRow, Row, SceneRow};
pub use encode::encode;
pub use example::{Example, ExampleGenerator};
pub use schema::schema;
