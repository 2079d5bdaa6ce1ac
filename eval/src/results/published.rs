//! The paper's own results (Section 6.4), for comparison, in SI units.

use super::accuracy::norms;
use world::units::{deg, mm};

/// Published results of a system. `None` marks values that were not published.
#[derive(Debug, Clone, PartialEq)]
pub struct Published {
    /// Name of the system.
    pub name: &'static str,
    /// Mean error of `x y z φ θ ψ` \[m\], \[rad\].
    pub mean: Option<[f64; 6]>,
    /// Standard deviation of the errors \[m\], \[rad\].
    pub standard_deviation: Option<[f64; 6]>,
    /// Norm of the position error \[m\].
    pub position_norm: f64,
    /// Norm of the orientation error \[rad\].
    pub orientation_norm: f64,
    /// Number of sessions.
    pub sessions: Option<usize>,
    /// Iterations until the pose was stable, in the single example shown.
    pub iterations: Option<f64>,
    /// Time to compute one motion \[s\].
    pub seconds_per_step: Option<f64>,
}

impl Published {
    /// Returns the root mean squares of position error \[m\] and orientation error \[rad\] implied by means and standard
    /// deviations.
    pub fn root_mean_squares(&self) -> Option<[f64; 2]> {
        let (mean, deviation) = (self.mean?, self.standard_deviation?);
        Some(norms(&std::array::from_fn(|i| mean[i].hypot(deviation[i]))))
    }
}

/// Converts six pose errors from millimeters and degrees.
fn pose_errors([x, y, z, phi, theta, psi]: [f64; 6]) -> [f64; 6] {
    [mm(x), mm(y), mm(z), deg(phi), deg(theta), deg(psi)]
}

/// Returns the results of the proposed method, from Table 1 and the text around it.
pub fn proposed_method() -> Published {
    Published {
        name: "the paper",
        mean: Some(pose_errors([1.72, 3.21, 2.61, 1.42, 0.72, 0.33])),
        standard_deviation: Some(pose_errors([1.35, 4.62, 2.25, 2.14, 0.55, 0.50])),
        position_norm: mm(4.5),
        orientation_norm: deg(1.6),
        sessions: Some(40),
        iterations: Some(40.0),
        seconds_per_step: Some(1.2),
    }
}

/// Returns the results of DEFINet, as the paper's authors implemented it and trained it on their data.
pub fn definet() -> Published {
    Published {
        name: "the paper's DEFINet",
        mean: None,
        standard_deviation: None,
        position_norm: mm(12.4),
        orientation_norm: deg(3.8),
        sessions: None,
        iterations: None,
        seconds_per_step: None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use world::units::{to_deg, to_mm};

    #[test]
    fn the_norms_of_table_1_are_norms_of_its_averages() {
        let paper = proposed_method();
        let [position, orientation] = norms(&paper.mean.unwrap());
        assert_eq!(format!("{:.1} {:.1}", to_mm(position), to_deg(orientation)), "4.5 1.6");
        assert_eq!(
            format!("{:.1} {:.1}", to_mm(paper.position_norm), to_deg(paper.orientation_norm)),
            "4.5 1.6"
        );
    }

    #[test]
    fn mean_and_deviation_imply_a_larger_root_mean_square() {
        let [position, orientation] = proposed_method().root_mean_squares().unwrap();
        // By hand: 1.72² + 1.35² + 3.21² + 4.62² + 2.61² + 2.25² = 48.3, and 7.77 for the angles.
        assert_eq!(format!("{:.2} {:.2}", to_mm(position), to_deg(orientation)), "6.95 2.79");
    }
}
