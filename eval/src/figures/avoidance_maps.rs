//! Figure 6: what the wrist camera sees, and where `CNN_avoid` thinks obstacles are.

use super::{Figure, WIDTH};
use crate::error::Result;
use crate::svg::{Anchor, Area, FAINT, INK, MUTED, Stroke, Svg, TextStyle};
use image::RgbImage;
use nalgebra::{Isometry3, Vector3};
use world::{AvoidanceMap, MeasuringPoints};

/// A wrist image with the map that was predicted from it, and the true one.
#[derive(Debug, Clone)]
pub struct AvoidanceExample {
    /// What the network saw.
    pub image: RgbImage,
    /// Where the hand was.
    pub robot_from_hand: Isometry3<f64>,
    /// The network's answer.
    pub predicted: AvoidanceMap,
    /// The map of Section 4.2.
    pub truth: AvoidanceMap,
}

const IMAGE_WIDTH: f64 = 240.0;
const RADIUS: f64 = 70.0;
const TOP: f64 = 58.0;
const ROW: f64 = 200.0;
/// Centers of the four hemispheres: predicted below and above, true below and above.
const CENTERS: [f64; 4] = [345.0, 511.0, 697.0, 863.0];
/// From free to blocked, light to dark so that it survives a gray print (`YlOrBr` of `ColorBrewer`).
const COLORS: [[f64; 3]; 5] = [
    [255.0, 255.0, 229.0],
    [254.0, 217.0, 142.0],
    [254.0, 153.0, 41.0],
    [204.0, 76.0, 2.0],
    [102.0, 37.0, 6.0],
];

/// One row an example: the image, then the predicted and the true map, each as two hemispheres.
pub fn figure_6(examples: &[AvoidanceExample], points: &MeasuringPoints) -> Result<Figure> {
    let height = TOP + ROW * examples.len() as f64 + 46.0;
    let mut svg = Svg::new(WIDTH, height, "Wrist images beside predicted and true avoidance maps");
    let pairs = [(IMAGE_WIDTH / 2.0, "wrist image"), (428.0, "predicted"), (780.0, "true")];
    for (x, heading) in pairs {
        svg.text([x, 20.0], heading, &TextStyle::HEADING);
    }
    for (x, side) in CENTERS.into_iter().zip(["downwards", "upwards", "downwards", "upwards"]) {
        svg.text([x, 42.0], side, &TextStyle::TICK);
    }
    for (i, example) in examples.iter().enumerate() {
        let top = TOP + ROW * i as f64;
        let image_height = IMAGE_WIDTH * f64::from(example.image.height()) / f64::from(example.image.width());
        let area = Area { x: 0.0, y: top + 4.0, width: IMAGE_WIDTH, height: image_height };
        svg.image(&area, &example.image)?;
        let maps = [&example.predicted, &example.predicted, &example.truth, &example.truth];
        for (k, (x, map)) in CENTERS.into_iter().zip(maps).enumerate() {
            let hemisphere = Hemisphere { center: [x, top + 96.0], upwards: k % 2 == 1 };
            hemisphere.draw(&mut svg, points, map);
            hemisphere.draw_image_top(&mut svg, &example.robot_from_hand);
        }
    }
    draw_color_bar(&mut svg, height - 34.0);
    let caption = "Examples of obstacle detection by CNN_avoid. The sphere of measuring points around the hand is shown as two \
                   hemispheres in equal-area projection, both seen from above: on the left half of each pair the center is \
                   straight down, on the right half straight up, the rim is horizontal, and F, L, B, R point to the robot's \
                   front, left, back and right. Every dot is one direction; dark means that motion there leads to an obstacle. \
                   The small triangle marks where the wrist image's upper edge points. The paper shows the predicted values on \
                   a sphere; the true map is added here.";
    Ok(Figure { label: "Figure 6".into(), svg: svg.finish(), caption: caption.into() })
}

/// A half of the sphere, seen from above.
struct Hemisphere {
    center: [f64; 2],
    upwards: bool,
}

impl Hemisphere {
    /// Lambert's azimuthal equal-area projection about the vertical; the robot's front is up, its left is left.
    fn project(&self, direction: &Vector3<f64>) -> [f64; 2] {
        let from_pole = (1.0 - direction.z.abs()).max(0.0).sqrt();
        let horizontal = direction.xy().norm().max(1e-12);
        let scale = RADIUS * from_pole / horizontal;
        [self.center[0] - direction.y * scale, self.center[1] - direction.x * scale]
    }

    fn draw(&self, svg: &mut Svg, points: &MeasuringPoints, map: &AvoidanceMap) {
        svg.disc(self.center, RADIUS + 7.0, "#ffffff", FAINT);
        let dot = 0.76 * RADIUS / (points.directions().len() as f64 / 2.0).sqrt();
        for (direction, value) in points.directions().iter().zip(&map.values) {
            if (direction.z >= 0.0) == self.upwards {
                svg.disc(self.project(direction), dot, &color(*value), MUTED);
            }
        }
        // Left and right stand once at a pair, outside of it.
        let side = if self.upwards { ("R", [1.0, 0.0]) } else { ("L", [-1.0, 0.0]) };
        let reach = RADIUS + 17.0;
        for (letter, [x, y]) in [("F", [0.0, -1.0]), ("B", [0.0, 1.0]), side] {
            svg.text(
                [self.center[0] + reach * x, self.center[1] + reach * y + 4.5],
                letter,
                &TextStyle::TICK,
            );
        }
    }

    /// A triangle on the rim, in the hand's x direction.
    fn draw_image_top(&self, svg: &mut Svg, robot_from_hand: &Isometry3<f64>) {
        let forward = (robot_from_hand * Vector3::x()).xy();
        let yaw = forward.y.atan2(forward.x);
        let at = |radius: f64, turn: f64| {
            let angle = yaw + turn;
            [self.center[0] - radius * angle.sin(), self.center[1] - radius * angle.cos()]
        };
        let corners = [
            at(RADIUS + 8.0, -0.055),
            at(RADIUS + 8.0, 0.055),
            at(RADIUS - 1.0, 0.0),
            at(RADIUS + 8.0, -0.055),
        ];
        svg.line(&corners, &Stroke { color: INK, width: 3.0, dashed: false });
    }
}

fn draw_color_bar(svg: &mut Svg, y: f64) {
    let [left, width] = [490.0, 230.0];
    let steps = 46;
    for i in 0..steps {
        let x = left + width * f64::from(i) / f64::from(steps);
        let fill = color(f64::from(i) / f64::from(steps - 1));
        // Half a pixel wider than the step, so that no seam shows.
        svg.rectangle(&Area { x, y, width: width / f64::from(steps) + 0.5, height: 14.0 }, &fill);
    }
    svg.text([left - 10.0, y + 12.0], "0: free", &TextStyle::TICK.anchored(Anchor::End));
    svg.text(
        [left + width + 10.0, y + 12.0],
        "1: towards an obstacle",
        &TextStyle::TICK.anchored(Anchor::Start),
    );
}

/// Color of an avoidance value, as `#rrggbb`.
fn color(value: f64) -> String {
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
    use crate::svg::tests::assert_balanced;
    use approx::assert_relative_eq;

    #[test]
    fn the_projection_keeps_areas_and_directions() {
        let below = Hemisphere { center: [0.0, 0.0], upwards: false };
        let center = below.project(&-Vector3::z());
        assert_relative_eq!(center[..], [0.0, 0.0][..]);
        assert_relative_eq!(below.project(&Vector3::x())[..], [0.0, -RADIUS][..]);
        assert_relative_eq!(below.project(&Vector3::y())[..], [-RADIUS, 0.0][..]);
        // The cap within 60 degrees of the pole holds half of the hemisphere's area.
        let [x, y] = below.project(&Vector3::new(0.75f64.sqrt(), 0.0, -0.5));
        assert_relative_eq!(x.hypot(y), RADIUS * 0.5f64.sqrt(), epsilon = 1e-12);
    }

    #[test]
    fn every_measuring_point_is_drawn_once_in_each_map() {
        let points = MeasuringPoints::spiral(180);
        let map = AvoidanceMap { values: vec![0.5; 180] };
        let example = AvoidanceExample {
            image: RgbImage::new(8, 6),
            robot_from_hand: Isometry3::identity(),
            predicted: map.clone(),
            truth: map,
        };
        let figure = figure_6(&[example.clone(), example], &points).unwrap();
        assert_balanced(&figure.svg);
        let dots = figure.svg.matches(&format!("fill=\"{}\" stroke=\"{MUTED}\"", color(0.5))).count();
        assert_eq!(dots, 2 * 2 * 180);
    }

    #[test]
    fn dark_is_blocked_and_no_value_breaks_the_scale() {
        assert_eq!(color(0.0), "#ffffe5");
        assert_eq!(color(1.0), "#662506");
        assert_eq!([color(-3.0), color(7.0), color(f64::NAN)], [color(0.0), color(1.0), color(0.0)]);
    }
}
