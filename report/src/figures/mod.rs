//! The paper's Figures 6 to 9, drawn from servo sessions.

pub mod avoidance_maps;
pub mod final_poses;
mod onlooker;
pub mod pose_error;
pub mod snapshots;
