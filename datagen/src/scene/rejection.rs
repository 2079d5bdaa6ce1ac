//! Reasons for rejecting a draw, and how often each applied.

use std::fmt;

/// Reason for rejecting a draw.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Reason {
    /// The center of the target is outside an image.
    OutOfSight,
    /// An obstacle is too close to the target or to another obstacle.
    Crowded,
    /// The hand touches the table.
    TouchesTable,
    /// The hand touches an obstacle.
    TouchesObstacle,
    /// The hand touches the target.
    TouchesTarget,
    /// The arm cannot reach a pose within its joint limits.
    Unreachable,
    /// Too few pixels show the target.
    HardlyVisible,
}

const REASONS: [Reason; 7] = [
    Reason::OutOfSight,
    Reason::Crowded,
    Reason::TouchesTable,
    Reason::TouchesObstacle,
    Reason::TouchesTarget,
    Reason::Unreachable,
    Reason::HardlyVisible,
];

impl fmt::Display for Reason {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter.write_str(match self {
            Self::OutOfSight => "target outside the image (motions, world.camera)",
            Self::Crowded => {
                "obstacles too close to the target or each other (obstacles.gap_mm, distance_mm, count)"
            }
            Self::TouchesTable => "hand touches the table (motions)",
            Self::TouchesObstacle => "hand touches an obstacle (obstacles.distance_mm, motions)",
            Self::TouchesTarget => "hand touches the target (motions, target)",
            Self::Unreachable => "hand pose out of the arm's reach (target.x_mm, target.y_mm, motions)",
            Self::HardlyVisible => "too few pixels of the target (rejection.min_target_area, motions)",
        })
    }
}

/// Number of rejected draws by reason; the error when no draw was acceptable.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Rejections {
    counts: [u32; REASONS.len()],
}

impl Rejections {
    /// Counts a rejection.
    pub fn add(&mut self, reason: Reason) {
        self.counts[reason as usize] += 1;
    }

    /// Returns the number of rejections for a reason.
    pub fn of(&self, reason: Reason) -> u32 {
        self.counts[reason as usize]
    }

    /// Returns the number of all rejections.
    pub fn total(&self) -> u32 {
        self.counts.iter().sum()
    }
}

impl fmt::Display for Rejections {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(formatter, "no acceptable scene: {} draws were rejected", self.total())?;
        let mut applied: Vec<Reason> = REASONS.into_iter().filter(|&reason| self.of(reason) > 0).collect();
        applied.sort_by_key(|&reason| std::cmp::Reverse(self.of(reason)));
        for (i, reason) in applied.into_iter().enumerate() {
            let separator = if i == 0 { ':' } else { ',' };
            write!(formatter, "{separator} {} x {reason}", self.of(reason))?;
        }
        formatter.write_str("; relax the most frequent constraint, or raise rejection.tries")
    }
}

impl std::error::Error for Rejections {}
