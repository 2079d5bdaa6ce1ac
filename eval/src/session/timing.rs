//! Wall-clock time of the stages of a step.

use serde::{Deserialize, Serialize};
use std::ops::AddAssign;
use std::time::Instant;

/// Wall-clock time by stage \[s\].
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize, Deserialize)]
pub struct StageSeconds {
    /// Rendering of the current image.
    pub render: f64,
    /// Approach policy.
    pub approach: f64,
    /// Avoid policy.
    pub avoid: f64,
    /// Deflection.
    pub deflect: f64,
    /// Quadratic program.
    pub qp: f64,
}

impl StageSeconds {
    /// Names of the stages, in the order of Figure 2.
    pub const NAMES: [&str; 5] = ["render", "approach", "avoid", "deflect", "qp"];

    /// Returns the times in the order of [`StageSeconds::NAMES`].
    pub fn to_array(&self) -> [f64; 5] {
        [self.render, self.approach, self.avoid, self.deflect, self.qp]
    }

    /// Returns the sum over the stages.
    pub fn total(&self) -> f64 {
        self.to_array().iter().sum()
    }
}

impl AddAssign for StageSeconds {
    fn add_assign(&mut self, other: Self) {
        self.render += other.render;
        self.approach += other.approach;
        self.avoid += other.avoid;
        self.deflect += other.deflect;
        self.qp += other.qp;
    }
}

/// Does some work and adds the time it takes to `seconds`.
pub(super) fn timed<T>(seconds: &mut f64, work: impl FnOnce() -> T) -> T {
    let start = Instant::now();
    let result = work();
    *seconds += start.elapsed().as_secs_f64();
    result
}
