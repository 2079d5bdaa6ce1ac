//! The six pose variables of Table 1, with the units in which people read them.

use world::units::{to_deg, to_mm};

/// A unit of length or angle.
#[derive(Debug, Clone, Copy)]
pub(super) struct Unit {
    /// Name, as in keys and headings.
    pub(super) name: &'static str,
    /// Converts from meters or radians.
    pub(super) from_si: fn(f64) -> f64,
}

pub(super) const MILLIMETERS: Unit = Unit { name: "mm", from_si: to_mm };
pub(super) const DEGREES: Unit = Unit { name: "deg", from_si: to_deg };

/// A pose variable.
pub(super) struct PoseVariable {
    /// Name in keys.
    pub(super) key: &'static str,
    /// Heading of its error.
    pub(super) heading: &'static str,
    /// Unit.
    pub(super) unit: Unit,
}

/// The pose variables in the order of the paper.
pub(super) const POSE_VARIABLES: [PoseVariable; 6] = [
    PoseVariable { key: "x", heading: "Δx", unit: MILLIMETERS },
    PoseVariable { key: "y", heading: "Δy", unit: MILLIMETERS },
    PoseVariable { key: "z", heading: "Δz", unit: MILLIMETERS },
    PoseVariable { key: "phi", heading: "Δφ", unit: DEGREES },
    PoseVariable { key: "theta", heading: "Δθ", unit: DEGREES },
    PoseVariable { key: "psi", heading: "Δψ", unit: DEGREES },
];
