//! Hand poses as six numbers, and the change between two of them: the label of `CNN_approach` (paper, Section 4.1).

mod hand_pose;
mod label_form;
mod pose_change;

pub use hand_pose::HandPose;
pub use label_form::LabelForm;
pub use pose_change::{PoseChange, adjoint};
