//! The renderer.
//!
//! The sub-pixel position of edges is the signal that lets a network servo to a fraction of a millimeter. Images are therefore
//! anti-aliased by area instead of by samples: a pixel shows each color in proportion to the area that it covers. Data passes
//! through the parts in this order:
//!
//! 1. `view` transforms the scene to the camera frame, into patches (`surface`, `quadric`) and silhouettes.
//! 2. `silhouette` finds in closed form the part of an image line that a face occupies.
//! 3. `scan` joins image lines to cells between smooth edges.
//! 4. `coverage` adds cells to pixels, with colors from `quadric` and `texture_sampler`.
//!
//! Images are byte-identical on every machine: the renderer uses one thread, a fixed order, and no function beyond the basic
//! operations and the square root of IEEE 754. There are no shadows. A body that contains the camera is invisible.

mod coverage;
mod quadric;
mod scan;
mod silhouette;
mod surface;
mod texture_sampler;
mod view;

use crate::camera::Camera;
use crate::render::coverage::Canvas;
use crate::render::scan::{Line, Scanner};
use crate::render::view::View;
use crate::scene::Scene;
use image::RgbImage;
use nalgebra::{Isometry3, Point2};

/// Renders scenes for one camera.
#[derive(Debug, Clone)]
pub struct Renderer {
    camera: Camera,
}

/// A color image with its depth and instance maps, which are stored row by row.
#[derive(Debug, Clone, PartialEq)]
pub struct Frame {
    /// Color image.
    pub color: RgbImage,
    /// Depth at the center of each pixel: z in the camera frame \[m\], infinite in the background.
    pub depth: Vec<f32>,
    /// Instance number at the center of each pixel: 0 for the table and the background, 1 for the target, 2 and up for the
    /// obstacles.
    pub instance: Vec<u16>,
}

impl Renderer {
    /// Creates a renderer for a camera. Its mount is not used: the methods take the pose of the camera.
    pub fn new(camera: Camera) -> Self {
        Self { camera }
    }

    /// Returns the camera.
    pub fn camera(&self) -> &Camera {
        &self.camera
    }

    /// Renders the color image from a camera pose.
    pub fn color(&self, scene: &Scene, robot_from_camera: &Isometry3<f64>) -> RgbImage {
        self.color_of(&View::new(scene, &self.camera, robot_from_camera))
    }

    /// Renders the color image, the depth map and the instance map from a camera pose.
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

    /// Counts the pixels that show a body at their center. The instance number is that of [`Frame::instance`].
    pub fn pixels_of(&self, instance: u16, scene: &Scene, robot_from_camera: &Isometry3<f64>) -> usize {
        let view = View::new(scene, &self.camera, robot_from_camera);
        let mut scanner = Scanner::new(&view);
        let mut line = Line::default();
        // The number of pixels with their center to the left of an edge.
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
