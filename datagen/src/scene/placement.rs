//! A scene with hand poses.

use world::Scene;
use world::arm::JointVector;
use world::pose::HandPose;

/// A scene, and the hand poses in it.
#[derive(Debug, Clone, PartialEq)]
pub struct Placement {
    /// Index of the motion in the configuration.
    pub motion: usize,
    /// Table, target and obstacles.
    pub scene: Scene,
    /// Current and goal pose of an approach, or the single pose of an avoidance map.
    pub hands: Vec<HandPlacement>,
}

/// A reachable hand pose.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct HandPlacement {
    /// Pose of the hand.
    pub pose: HandPose,
    /// Joint angles of the arm at this pose \[rad\].
    pub joints: JointVector,
}
