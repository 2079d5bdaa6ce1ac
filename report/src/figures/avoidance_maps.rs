//! Figure 6: wrist images with the avoidance maps that `CNN_avoid` predicts from them.

use crate::drawing::figure::{Figure, WIDTH};
use crate::drawing::hemisphere::{Hemisphere, draw_color_bar};
use crate::drawing::svg::{Area, Svg, TextStyle};
use datagen::Result;
use image::RgbImage;
use nalgebra::Isometry3;
use world::{AvoidanceMap, MeasuringPoints};

/// A wrist image with its predicted and its true avoidance map.
#[derive(Debug, Clone)]
pub struct AvoidanceExample {
    /// Input of the network.
    pub image: RgbImage,
    /// Hand pose.
    pub robot_from_hand: Isometry3<f64>,
    /// Output of the network.
    pub predicted: AvoidanceMap,
    /// Ground truth (Section 4.2).
    pub truth: AvoidanceMap,
}

const IMAGE_WIDTH: f64 = 240.0;
const RADIUS: f64 = 70.0;
const TOP: f64 = 58.0;
const ROW: f64 = 200.0;
/// Centers of the four hemispheres: predicted below and above, true below and above.
const CENTERS: [f64; 4] = [345.0, 511.0, 697.0, 863.0];

/// Draws one row per example: the image, then the predicted and the true map, each as two hemispheres.
pub fn figure_6(examples: &[AvoidanceExample], points: &MeasuringPoints) -> Result<Figure> {
    let height = TOP + ROW * examples.len() as f64 + 46.0;
    let mut svg = Svg::new(WIDTH, height, "Wrist images beside predicted and true avoidance maps");
    let pairs = [(IMAGE_WIDTH / 2.0, "wrist image"), (428.0, "predicted"), (780.0, "true")];
    for (x, heading) in pairs {
        svg.text([x, 20.0], heading, &TextStyle::HEADING);
    }
    for (x, side) in CENTERS.into_iter().zip(["downward", "upward", "downward", "upward"]) {
        svg.text([x, 42.0], side, &TextStyle::TICK);
    }
    for (i, example) in examples.iter().enumerate() {
        let top = TOP + ROW * i as f64;
        let image_height = IMAGE_WIDTH * f64::from(example.image.height()) / f64::from(example.image.width());
        let area = Area { x: 0.0, y: top + 4.0, width: IMAGE_WIDTH, height: image_height };
        svg.image(&area, &example.image)?;
        let maps = [&example.predicted, &example.predicted, &example.truth, &example.truth];
        for (k, (x, map)) in CENTERS.into_iter().zip(maps).enumerate() {
            let hemisphere = Hemisphere { center: [x, top + 96.0], radius: RADIUS, upward: k % 2 == 1 };
            hemisphere.draw(&mut svg, points, map);
            hemisphere.draw_image_top(&mut svg, &example.robot_from_hand);
        }
    }
    draw_color_bar(&mut svg, [490.0, height - 34.0]);
    let caption = "Examples of obstacle detection by CNN_avoid. The sphere of measuring points around the hand is shown as two \
                   hemispheres in equal-area projection, both seen from above. The center of the left one is straight down, that \
                   of the right one straight up, and the rim is horizontal. F, L, B, and R point to the robot's front, left, \
                   back, and right. Every dot is one direction; a dark dot means that motion in this direction leads to an \
                   obstacle. The small triangle points to the upper edge of the wrist image. The paper shows the predicted \
                   values on a sphere. The true map is added here.";
    Ok(Figure { label: "Figure 6".into(), svg: svg.finish(), caption: caption.into() })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::drawing::hemisphere::color;
    use crate::drawing::markup::tests::assert_balanced;
    use crate::drawing::svg::MUTED;

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
}
