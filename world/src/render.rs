//! The renderer: what a camera sees of a scene.
//!
//! The sub-pixel position of edges is the signal that lets a network servo to a fraction of a millimetre, so images are
//! anti-aliased by area instead of by samples: a pixel shows each color in proportion to the area that it covers. Faces are
//! found in closed form along image lines (`silhouette`), lines are joined to cells between smooth edges (`scan`), and cells
//! are summed up over pixels (`coverage`).
//!
//! Images are deterministic to the byte: one thread, a fixed order, and no function beyond IEEE 754's basic operations and
//! square root. There are no shadows, and a body in which the camera is does not show.

use crate::camera::Camera;
use crate::coverage::Canvas;
use crate::scan::{Line, Scanner};
use crate::scene::Scene;
use crate::view::View;
use image::RgbImage;
use nalgebra::{Isometry3, Point2};

/// Renders scenes for one camera.
#[derive(Debug, Clone)]
pub struct Renderer {
    camera: Camera,
}

/// A color image with what is known about its pixels; maps are row by row.
#[derive(Debug, Clone, PartialEq)]
pub struct Frame {
    /// The image.
    pub color: RgbImage,
    /// z in the camera frame of what is seen at the pixel's centre \[m\]; infinite where there is nothing.
    pub depth: Vec<f32>,
    /// Whose surface is seen at the pixel's centre: 0 the table or nothing, 1 the target, 2 and on the obstacles.
    pub instance: Vec<u16>,
}

impl Renderer {
    /// For images of this camera, whose mount is not used: poses are the camera's.
    pub fn new(camera: Camera) -> Self {
        Self { camera }
    }

    /// The camera.
    pub fn camera(&self) -> &Camera {
        &self.camera
    }

    /// The image from a pose.
    pub fn color(&self, scene: &Scene, robot_from_camera: &Isometry3<f64>) -> RgbImage {
        self.color_of(&View::new(scene, &self.camera, robot_from_camera))
    }

    /// The image, the depth map and the instance map from a pose.
    pub fn frame(&self, scene: &Scene, robot_from_camera: &Isometry3<f64>) -> Frame {
        let view = View::new(scene, &self.camera, robot_from_camera);
        let pixels = self.camera.width as usize * self.camera.height as usize;
        let (mut depth, mut instance) = (Vec::with_capacity(pixels), Vec::with_capacity(pixels));
        let mut scanner = Scanner::new(&view);
        let mut line = Line::default();
        for row in 0..self.camera.height {
            let v = f64::from(row) + 0.5;
            scanner.trace(v, &mut line);
            let mut span = 0;
            for column in 0..self.camera.width {
                let u = f64::from(column) + 0.5;
                while line.edges[span + 1] <= u {
                    span += 1;
                }
                let patch = &view.patches[usize::from(line.patches[span])];
                depth.push((1.0 / patch.surface.nearness(&self.camera.ray(&Point2::new(u, v)))) as f32);
                instance.push(patch.instance);
            }
        }
        Frame { color: self.color_of(&view), depth, instance }
    }

    /// The number of pixels at whose centers a body is seen, by its number in [`Frame::instance`].
    pub fn pixels_of(&self, instance: u16, scene: &Scene, robot_from_camera: &Isometry3<f64>) -> usize {
        let view = View::new(scene, &self.camera, robot_from_camera);
        let mut scanner = Scanner::new(&view);
        let mut line = Line::default();
        // Pixels whose centers lie to the left of an edge.
        let left_of = |edge: f64| (edge - 0.5).ceil().max(0.0) as usize;
        let mut pixels = 0;
        for row in 0..self.camera.height {
            scanner.trace(f64::from(row) + 0.5, &mut line);
            for (&patch, edges) in line.patches.iter().zip(line.edges.windows(2)) {
                if view.patches[usize::from(patch)].instance == instance {
                    pixels += left_of(edges[1]) - left_of(edges[0]);
                }
            }
        }
        pixels
    }

    fn color_of(&self, view: &View) -> RgbImage {
        let mut image = RgbImage::new(self.camera.width, self.camera.height);
        let mut canvas = Canvas::new(view, &mut image);
        let mut scanner = Scanner::new(view);
        while let Some(cell) = scanner.next_cell() {
            canvas.draw(cell);
        }
        image
    }
}
