//! A contact sheet: some rows of a dataset, as a person wants to look at them.

use super::WIDTH;
use super::flow::{Flow, flow};
use super::hemisphere::{Hemisphere, draw_color_bar};
use crate::error::Result;
use crate::svg::{Anchor, Area, INK, PALETTE, Stroke, Svg, TextStyle};
use datagen::config::Kind;
use datagen::row::Row;
use datagen::statistics::BLOCKED;
use datagen::{
    ApproachRow, AvoidanceRow, CameraRow, DatasetConfig, DatasetReader, ImagesRow, MotionRow, SceneRow, png,
};
use image::RgbImage;
use image::imageops::thumbnail;
use nalgebra::Point2;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use std::collections::BTreeSet;
use world::units::{to_deg, to_mm};
use world::{AvoidanceMap, Camera, LabelForm, MeasuringPoints, Scene};

/// Space around the whole.
const MARGIN: f64 = 28.0;
/// Space between the two columns of rows.
const GUTTER: f64 = 36.0;
const CELL: f64 = (WIDTH - GUTTER) / 2.0;
/// Space between what stands side by side in a cell.
const BETWEEN: f64 = 6.0;
const HEADER: f64 = 110.0;
/// Room for the two lines below images, and for the space to the next cell.
const CAPTION: f64 = 64.0;
/// Wider images are made smaller, so that the sheet stays a handy file.
const MOST_PIXELS: u32 = 480;
/// Arrows over an image.
const ARROWS: [u32; 2] = [7, 5];
/// Width of the image beside an avoidance map, and radius of the map's hemispheres.
const MAPPED: f64 = 180.0;
const RADIUS: f64 = 50.0;
/// Middle of each hemisphere, downwards and upwards, from the left of its cell.
const POLES: [f64; 2] = [MAPPED + 81.0, MAPPED + 203.0];
/// Height of a hemisphere with its letters.
const GLOBE: f64 = 2.0 * RADIUS + 44.0;
const MARK: &str = PALETTE[0];

const TITLE: TextStyle = TextStyle { size: 22.0, anchor: Anchor::Start, color: INK, bold: true };
const FACTS: TextStyle = TextStyle { size: 14.0, anchor: Anchor::Start, ..TextStyle::TICK };
const NOTE: TextStyle = TextStyle { size: 13.0, anchor: Anchor::Start, ..TextStyle::TICK };
const NAME: TextStyle = TextStyle { size: 14.0, anchor: Anchor::Start, color: INK, bold: true };

const APPROACH_NOTE: [&str; 2] = [
    "Left the current image, right the goal image. An arrow leads from where a point of the scene is in the current image to where it is in the",
    "goal image; points that leave the image have none. Below, how far the hand moves and turns, and the pose ranges that were drawn from.",
];
const AVOIDANCE_NOTE: [&str; 2] = [
    "Beside each wrist image its avoidance map, seen from above: the lower hemisphere, whose center is straight down, and the upper one. A dot is a",
    "direction of motion; F, B, L, R are the robot's front, back, left and right. Triangle: the image's upper edge. Blue ring: an obstacle's center.",
];

/// `count` rows of `rows`, evenly spread; all where there are not more.
pub fn evenly_spread(rows: u64, count: u64) -> Vec<u64> {
    let count = count.min(rows);
    (0..count).map(|i| (u128::from(2 * i + 1) * u128::from(rows) / u128::from(2 * count)) as u64).collect()
}

/// `count` different rows of `rows`, drawn by chance, in ascending order; all where there are not more.
pub fn drawn(rows: u64, count: u64, seed: u64) -> Vec<u64> {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let mut drawn = BTreeSet::new();
    while (drawn.len() as u64) < count.min(rows) {
        drawn.insert(rng.random_range(0..rows));
    }
    drawn.into_iter().collect()
}

/// Draws rows of a dataset, in this order: an SVG document without external resources.
pub fn contact_sheet(reader: &DatasetReader, rows: &[u64]) -> Result<String> {
    let config = &reader.info().config;
    let camera = &config.world.camera;
    let image_width = match config.kind {
        Kind::Approach => (CELL - BETWEEN) / 2.0,
        Kind::Avoidance => MAPPED,
    };
    let image_height = image_width * f64::from(camera.height) / f64::from(camera.width);
    let cell_height = match config.kind {
        Kind::Approach => image_height,
        Kind::Avoidance => image_height.max(GLOBE),
    };
    let step = cell_height + CAPTION;
    let height = MARGIN + HEADER + step * rows.len().div_ceil(2) as f64;
    let title = format!("Contact sheet of the dataset {}", config.name);
    let mut svg = Svg::new(WIDTH + 2.0 * MARGIN, height, &title);
    draw_header(&mut svg, reader);
    for (i, &row) in rows.iter().enumerate() {
        let x = MARGIN + (i % 2) as f64 * (CELL + GUTTER);
        let y = MARGIN + HEADER + (i / 2) as f64 * step;
        let example = Example::read(reader, row)?;
        let area =
            Area { x, y: y + (cell_height - image_height) / 2.0, width: image_width, height: image_height };
        let below = match config.kind {
            Kind::Approach => draw_approach(&mut svg, &area, &example, &one(reader, row)?)?,
            Kind::Avoidance => draw_avoidance(&mut svg, &area, &example, &one(reader, row)?)?,
        };
        draw_caption(&mut svg, [x, y + cell_height + 20.0], &example, &below);
    }
    Ok(svg.finish())
}

/// What rows of both kinds have.
struct Example {
    index: u64,
    images: Vec<RgbImage>,
    camera: Camera,
    motion: String,
    scene: Scene,
}

impl Example {
    fn read(reader: &DatasetReader, row: u64) -> Result<Self> {
        let ImagesRow { index, images } = one(reader, row)?;
        let images = images.iter().map(|bytes| png::decode(bytes)).collect::<datagen::Result<Vec<_>>>()?;
        let CameraRow { focal, center, hand_from_camera, .. } = one(reader, row)?;
        let DatasetConfig { world, motions, .. } = &reader.info().config;
        let [width, height] = [world.camera.width, world.camera.height];
        let MotionRow { motion, .. } = one(reader, row)?;
        Ok(Self {
            index,
            camera: Camera { width, height, focal, center, hand_from_camera },
            images,
            motion: motions.get(motion).map(|motion| motion.name.clone()).unwrap_or_default(),
            scene: one::<SceneRow>(reader, row)?.scene,
        })
    }

    /// Draws the images side by side, the first one into an area.
    fn draw_images(&self, svg: &mut Svg, area: &Area) -> Result<()> {
        for (i, image) in self.images.iter().enumerate() {
            let area = Area { x: area.x + i as f64 * (area.width + BETWEEN), ..*area };
            if image.width() <= MOST_PIXELS {
                svg.image(&area, image)?;
            } else {
                let height = image.height() * MOST_PIXELS / image.width();
                svg.image(&area, &thumbnail(image, MOST_PIXELS, height.max(1)))?;
            }
        }
        Ok(())
    }
}

/// One row of a dataset.
fn one<R: Row>(reader: &DatasetReader, row: u64) -> Result<R> {
    // One is asked for, so one is there.
    Ok(reader.rows_at(&[row])?.swap_remove(0))
}

fn draw_header(svg: &mut Svg, reader: &DatasetReader) {
    let info = reader.info();
    let config = &info.config;
    svg.text([MARGIN, MARGIN + 18.0], &config.name, &TITLE);
    if config.kind == Kind::Avoidance {
        draw_color_bar(svg, [MARGIN + WIDTH - 390.0, MARGIN + 5.0]);
    }
    let facts = format!(
        "{} dataset · {} rows · seed {} · {} x {} pixels · digest {}",
        config.kind,
        info.rows,
        config.seed,
        config.world.camera.width,
        config.world.camera.height,
        info.digest.get(..12).unwrap_or(&info.digest)
    );
    svg.text([MARGIN, MARGIN + 42.0], &facts, &FACTS);
    let note = match config.kind {
        Kind::Approach => APPROACH_NOTE,
        Kind::Avoidance => AVOIDANCE_NOTE,
    };
    for (i, line) in note.iter().enumerate() {
        svg.text([MARGIN, MARGIN + 68.0 + 18.0 * i as f64], line, &NOTE);
    }
}

/// Current and goal image with the flow between them; returns what stands below at the right.
fn draw_approach(svg: &mut Svg, area: &Area, example: &Example, row: &ApproachRow) -> Result<String> {
    example.draw_images(svg, area)?;
    let Example { camera, scene, .. } = example;
    let [current, goal] = [&row.robot_from_current, &row.robot_from_goal];
    let cameras = [current, goal].map(|robot_from_hand| robot_from_hand * camera.hand_from_camera);
    let at = |pixel: Point2<f64>| {
        let [u, v] = [pixel.x / f64::from(camera.width), pixel.y / f64::from(camera.height)];
        [area.x + u * area.width, area.y + v * area.height]
    };
    for Flow { current, goal } in flow(camera, scene, [&cameras[0], &cameras[1]], ARROWS) {
        svg.arrow(at(current), at(goal), MARK);
    }
    let twist = LabelForm::Twist.label(current, goal);
    Ok(format!("{:.0} mm, {:.1}°", to_mm(twist.translation.norm()), to_deg(twist.rotation.norm())))
}

/// The image beside its avoidance map; returns what stands below at the right.
fn draw_avoidance(svg: &mut Svg, area: &Area, example: &Example, row: &AvoidanceRow) -> Result<String> {
    example.draw_images(svg, area)?;
    let points = MeasuringPoints::spiral(row.values.len().max(2));
    let map = AvoidanceMap { values: row.values.iter().copied().map(f64::from).collect() };
    let middle = area.y + area.height / 2.0;
    for (pole, upwards) in POLES.into_iter().zip([false, true]) {
        let hemisphere = Hemisphere { center: [area.x + pole, middle], radius: RADIUS, upwards };
        hemisphere.draw(svg, &points, &map);
        hemisphere.draw_image_top(svg, &row.robot_from_hand);
        for obstacle in &example.scene.obstacles {
            let towards =
                obstacle.robot_from_body.translation.vector - row.robot_from_hand.translation.vector;
            if hemisphere.holds(&towards) {
                let place = hemisphere.project(&towards.normalize());
                svg.ring(place, 6.5, &Stroke { color: "#ffffff", width: 4.0, dashed: false });
                svg.ring(place, 6.5, &Stroke { color: MARK, width: 2.2, dashed: false });
            }
        }
    }
    let blocked = map.values.iter().filter(|&&value| value >= BLOCKED).count();
    Ok(format!("{:.0} % of the directions blocked", 100.0 * blocked as f64 / map.values.len() as f64))
}

fn draw_caption(svg: &mut Svg, [x, y]: [f64; 2], example: &Example, below: &str) {
    svg.text([x, y], &format!("row {}", example.index), &NAME);
    svg.text([x + CELL, y], below, &TextStyle { anchor: Anchor::End, bold: false, ..NAME });
    let obstacles = match example.scene.obstacles.len() {
        0 => "no obstacle".to_owned(),
        1 => "1 obstacle".to_owned(),
        n => format!("{n} obstacles"),
    };
    let contents = format!("{}, {obstacles}", example.scene.target.shape.name());
    svg.text([x, y + 18.0], &example.motion, &NOTE);
    svg.text([x + CELL, y + 18.0], &contents, &NOTE.anchored(Anchor::End));
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rows_are_spread_evenly() {
        assert_eq!(evenly_spread(100, 4), [12, 37, 62, 87]);
        assert_eq!(evenly_spread(3, 12), [0, 1, 2]);
        assert_eq!(evenly_spread(u64::MAX, 1), [u64::MAX / 2]);
    }

    #[test]
    fn drawn_rows_are_different_and_follow_the_seed() {
        let rows = drawn(1000, 30, 5);
        assert!(rows.len() == 30 && rows.is_sorted_by(|a, b| a < b) && rows[29] < 1000, "{rows:?}");
        assert_eq!(rows, drawn(1000, 30, 5));
        assert_ne!(rows, drawn(1000, 30, 6));
        assert_eq!(drawn(3, 12, 0), [0, 1, 2]);
    }
}
