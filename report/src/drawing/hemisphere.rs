//! The sphere of measuring points as two hemispheres, seen from above (Figure 6, contact sheets).

use super::svg::{Anchor, Area, FAINT, INK, MUTED, Stroke, Svg, TextStyle};
use nalgebra::{Isometry3, Vector3};
use world::{AvoidanceMap, MeasuringPoints};

/// Colors from free to blocked, light to dark so that they survive a grayscale print (`YlOrBr` of `ColorBrewer`).
const COLORS: [[f64; 3]; 5] = [
    [255.0, 255.0, 229.0],
    [254.0, 217.0, 142.0],
    [254.0, 153.0, 41.0],
    [204.0, 76.0, 2.0],
    [102.0, 37.0, 6.0],
];
/// Width of the color bar without its labels.
const COLOR_BAR_WIDTH: f64 = 230.0;

/// One half of the sphere, seen from above.
pub(crate) struct Hemisphere {
    /// Position of its pole in the drawing.
    pub(crate) center: [f64; 2],
    /// Radius of its rim.
    pub(crate) radius: f64,
    /// Whether it is the upper half.
    pub(crate) upward: bool,
}

impl Hemisphere {
    /// Returns whether it contains a direction.
    pub(crate) fn holds(&self, direction: &Vector3<f64>) -> bool {
        (direction.z >= 0.0) == self.upward
    }

    /// Projects a direction by Lambert's azimuthal equal-area projection. The robot's front is up, and its left is on the left.
    pub(crate) fn project(&self, direction: &Vector3<f64>) -> [f64; 2] {
        let from_pole = (1.0 - direction.z.abs()).max(0.0).sqrt();
        let horizontal = direction.xy().norm().max(1e-12);
        let scale = self.radius * from_pole / horizontal;
        [self.center[0] - direction.y * scale, self.center[1] - direction.x * scale]
    }

    /// Draws a dot for each measuring point, and letters for the robot's front, back, left and right.
    pub(crate) fn draw(&self, svg: &mut Svg, points: &MeasuringPoints, map: &AvoidanceMap) {
        svg.disc(self.center, self.radius + 7.0, "#ffffff", FAINT);
        let dot = 0.76 * self.radius / (points.directions().len() as f64 / 2.0).sqrt();
        for (direction, value) in points.directions().iter().zip(&map.values) {
            if self.holds(direction) {
                svg.disc(self.project(direction), dot, &color(*value), MUTED);
            }
        }
        // L and R appear once per pair, on its outside.
        let side = if self.upward { ("R", [1.0, 0.0]) } else { ("L", [-1.0, 0.0]) };
        let reach = self.radius + 17.0;
        for (letter, [x, y]) in [("F", [0.0, -1.0]), ("B", [0.0, 1.0]), side] {
            svg.text(
                [self.center[0] + reach * x, self.center[1] + reach * y + 4.5],
                letter,
                &TextStyle::TICK,
            );
        }
    }

    /// Draws a triangle on the rim, in the hand's x direction.
    pub(crate) fn draw_image_top(&self, svg: &mut Svg, robot_from_hand: &Isometry3<f64>) {
        let forward = (robot_from_hand * Vector3::x()).xy();
        let yaw = forward.y.atan2(forward.x);
        let at = |radius: f64, turn: f64| {
            let angle = yaw + turn;
            [self.center[0] - radius * angle.sin(), self.center[1] - radius * angle.cos()]
        };
        let corners = [
            at(self.radius + 8.0, -0.055),
            at(self.radius + 8.0, 0.055),
            at(self.radius - 1.0, 0.0),
            at(self.radius + 8.0, -0.055),
        ];
        svg.line(&corners, &Stroke { color: INK, width: 3.0, dashed: false });
    }
}

/// Draws the color bar with its upper left corner at `left`, `y`.
pub(crate) fn draw_color_bar(svg: &mut Svg, [left, y]: [f64; 2]) {
    let width = COLOR_BAR_WIDTH;
    let steps = 46;
    for i in 0..steps {
        let x = left + width * f64::from(i) / f64::from(steps);
        let fill = color(f64::from(i) / f64::from(steps - 1));
        // Half a pixel wider than the step, to hide seams.
        svg.rectangle(&Area { x, y, width: width / f64::from(steps) + 0.5, height: 14.0 }, &fill);
    }
    svg.text([left - 10.0, y + 12.0], "0: free", &TextStyle::TICK.anchored(Anchor::End));
    svg.text(
        [left + width + 10.0, y + 12.0],
        "1: toward an obstacle",
        &TextStyle::TICK.anchored(Anchor::Start),
    );
}

/// Returns the color of an avoidance value, as `#rrggbb`.
pub(crate) fn color(value: f64) -> String {
    let position = if value.is_finite() { value.clamp(0.0, 1.0) } else { 0.0 } * (COLORS.len() - 1) as f64;
    let below = (position.floor() as usize).min(COLORS.len() - 2);
    let share = position - below as f64;
    let [r, g, b] = std::array::from_fn(|c| {
        (COLORS[below][c] * (1.0 - share) + COLORS[below + 1][c] * share).round() as u8
    });
    format!("#{r:02x}{g:02x}{b:02x}")
}

#[cfg(test)]
mod tests {
    use super::*;
    use approx::assert_relative_eq;

    #[test]
    fn the_projection_keeps_areas_and_directions() {
        let below = Hemisphere { center: [0.0, 0.0], radius: 70.0, upward: false };
        let center = below.project(&-Vector3::z());
        assert_relative_eq!(center[..], [0.0, 0.0][..]);
        assert_relative_eq!(below.project(&Vector3::x())[..], [0.0, -70.0][..]);
        assert_relative_eq!(below.project(&Vector3::y())[..], [-70.0, 0.0][..]);
        // The cap within 60 degrees of the pole holds half of the hemisphere's area.
        let [x, y] = below.project(&Vector3::new(0.75f64.sqrt(), 0.0, -0.5));
        assert_relative_eq!(x.hypot(y), 70.0 * 0.5f64.sqrt(), epsilon = 1e-12);
    }

    #[test]
    fn dark_is_blocked_and_other_values_are_clamped() {
        assert_eq!(color(0.0), "#ffffe5");
        assert_eq!(color(1.0), "#662506");
        assert_eq!([color(-3.0), color(7.0), color(f64::NAN)], [color(0.0), color(1.0), color(0.0)]);
    }
}
