//! Obstacle avoidance: measuring points, obstacle elements, and the avoidance map computed from them (paper, Sections 4.2 and
//! 6.3). The map is the ground truth of `CNN_avoid`.

mod avoidance_map;
mod measuring_points;
mod obstacle_elements;

pub use avoidance_map::AvoidanceMap;
pub use measuring_points::MeasuringPoints;
pub use obstacle_elements::ObstacleElements;
