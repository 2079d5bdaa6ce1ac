//! Obstacle avoidance: the directions of motion that are judged, the elements that stand for the obstacles, and the avoidance map
//! (paper, Sections 4.2 and 6.3). Ground truth of `CNN_avoid`.

mod avoidance_map;
mod measuring_points;
mod obstacle_elements;

pub use avoidance_map::AvoidanceMap;
pub use measuring_points::MeasuringPoints;
pub use obstacle_elements::ObstacleElements;
