//! A contact sheet: rows of a dataset as images with their labels drawn over them.

use super::flow::{Flow, flow};
use crate::drawing::figure::WIDTH;
use crate::drawing::hemisphere::{Hemisphere, draw_color_bar};
use crate::drawing::svg::{Anchor, Area, INK, PALETTE, Stroke, Svg, TextStyle};
use datagen::Result;
use datagen::config::Kind;
use datagen::row::Row;
use datagen::statistics::BLOCKED;
use datagen::{
    ApproachRow, AvoidanceRow, CameraRow, DatasetConfig, DatasetReader, ImagesRow, MotionRow, SceneRow, png,
};
use image::RgbImage;
use image::imageops::thumbnail;
use nalgebra::Point2;
use world::units::{to_deg, to_mm};
use world::{AvoidanceMap, Camera, LabelForm, MeasuringPoints, Scene};

/// Space around the sheet.
const MARGIN: f64 = 28.0;
/// Space between the two columns of cells.
const GUTTER: f64 = 36.0;
const CELL: f64 = (WIDTH - GUTTER) / 2.0;
/// Space between the parts of a cell.
const BETWEEN: f64 = 6.0;
const HEADER: f64 = 110.0;
/// Space for the two lines below the images and the gap to the next cell.
const CAPTION: f64 = 64.0;
/// Maximum width of an image \[pixels\]. Wider ones are scaled down to keep the file small.
const MOST_PIXELS: u32 = 480;
/// Columns and rows of arrows over an image.
const ARROWS: [u32; 2] = [7, 5];
/// Width of the image beside an avoidance map, and radius of the map's hemispheres.
const MAPPED: f64 = 180.0;
const RADIUS: f64 = 50.0;
/// Distance of each hemisphere's center, downward and upward, from the left of its cell.
const POLES: [f64; 2] = [MAPPED + 81.0, MAPPED + 203.0];
/// Height of a hemisphere with its letters.
const GLOBE: f64 = 2.0 * RADIUS + 44.0;
const MARK: &str = PALETTE[0];

const TITLE: TextStyle = TextStyle { size: 22.0, anchor: Anchor::Start, color: INK, bold: true };
const FACTS: TextStyle = TextStyle { size: 14.0, anchor: Anchor::Start, ..TextStyle::TICK };
const NOTE: TextStyle = TextStyle { size: 13.0, anchor: Anchor::Start, ..TextStyle::TICK };
const NAME: TextStyle = TextStyle { size: 14.0, anchor: Anchor::Start, color: INK, bold: true };

const APPROACH_NOTE: [&str; 2] = [
    "Left: the current image. Right: the goal image. An arrow leads from a point's position in the current image to its position in the goal image.",
    "Points that leave the image have no arrow. Below: translation and rotation of the hand, and the ranges from which its poses were drawn.",
];
const AVOIDANCE_NOTE: [&str; 2] = [
    "Beside each wrist image: its avoidance map, seen from above, as lower hemisphere (center: straight down) and upper hemisphere. A dot is a",
    "direction of motion. F, B, L, and R are the robot's front, back, left, and right. Triangle: the image's upper edge. Blue ring: an obstacle's center.",
];

/// Draws rows of a dataset in the given order, as an SVG document without external resources.
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

/// The part of a row that both kinds of dataset have.
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
        let images = images.iter().map(|bytes| png::decode(bytes)).collect::<Result<Vec<_>>>()?;
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

    /// Draws the images side by side, the first one into `area`.
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

/// Reads one row of a dataset.
fn one<R: Row>(reader: &DatasetReader, row: u64) -> Result<R> {
    // One row is requested, so one is returned.
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

/// Draws current and goal image with the flow between them. Returns the right-hand text of the caption.
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

/// Draws the image beside its avoidance map. Returns the right-hand text of the caption.
fn draw_avoidance(svg: &mut Svg, area: &Area, example: &Example, row: &AvoidanceRow) -> Result<String> {
    example.draw_images(svg, area)?;
    let points = MeasuringPoints::spiral(row.values.len().max(2));
    let map = AvoidanceMap { values: row.values.iter().copied().map(f64::from).collect() };
    let middle = area.y + area.height / 2.0;
    for (pole, upward) in POLES.into_iter().zip([false, true]) {
        let hemisphere = Hemisphere { center: [area.x + pole, middle], radius: RADIUS, upward };
        hemisphere.draw(svg, &points, &map);
        hemisphere.draw_image_top(svg, &row.robot_from_hand);
        for obstacle in &example.scene.obstacles {
            let direction =
                obstacle.robot_from_body.translation.vector - row.robot_from_hand.translation.vector;
            if hemisphere.holds(&direction) {
                let place = hemisphere.project(&direction.normalize());
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
        0 => "no obstacles".to_owned(),
        1 => "1 obstacle".to_owned(),
        n => format!("{n} obstacles"),
    };
    let contents = format!("{}, {obstacles}", example.scene.target.shape.name());
    svg.text([x, y + 18.0], &example.motion, &NOTE);
    svg.text([x + CELL, y + 18.0], &contents, &NOTE.anchored(Anchor::End));
}
