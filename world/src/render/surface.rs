//! Surfaces in the camera frame.
//!
//! A ray through an image point is `(x, y, 1)`, so that its parameter is the depth z. Surfaces report the *nearness* 1/z, which
//! is linear over the image for a plane, and 0 where there is nothing.

use crate::color::Color;
use crate::render::quadric::{Quadric, QuadricOnLine};
use crate::render::texture_sampler::TextureInView;
use nalgebra::Vector3;

/// A part of the image with one material, on one surface.
#[derive(Debug, Clone)]
pub(crate) struct Patch {
    /// Instance number of the body.
    pub(crate) instance: u16,
    /// Geometry.
    pub(crate) surface: Surface,
    /// Color.
    pub(crate) color: Color,
    /// Brightness of a flat surface.
    pub(crate) brightness: f64,
    /// Texture, if any.
    pub(crate) texture: Option<TextureInView>,
}

/// Geometry of a patch.
#[derive(Debug, Clone)]
pub(crate) enum Surface {
    /// A plane. Its nearness along a ray is the product with this vector, which is 0 for the background.
    Flat(Vector3<f64>),
    /// A sphere, or the lateral surface of a cylinder.
    Round(Quadric),
}

impl Surface {
    /// Returns 1/z along a ray that is known to hit the surface.
    pub(crate) fn nearness(&self, ray: &Vector3<f64>) -> f64 {
        match self {
            Self::Flat(plane) => plane.dot(ray),
            Self::Round(quadric) => quadric.on_line(ray.y).nearness(ray.x),
        }
    }

    /// Restricts the surface to the image line with this y.
    pub(crate) fn on_line(&self, y: f64) -> SurfaceOnLine<'_> {
        match self {
            Self::Flat(plane) => SurfaceOnLine::Flat(plane),
            Self::Round(quadric) => SurfaceOnLine::Round(quadric.on_line(y)),
        }
    }
}

/// A surface along an image line.
#[derive(Debug)]
pub(crate) enum SurfaceOnLine<'a> {
    /// See [`Surface::Flat`].
    Flat(&'a Vector3<f64>),
    /// See [`Surface::Round`].
    Round(QuadricOnLine<'a>),
}
