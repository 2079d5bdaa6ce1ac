//! Textures as the camera sees them.

use crate::color::Color;
use crate::scene::{GradientNoise, Texture};
use nalgebra::{Isometry3, Matrix3, Vector3};

/// A texture in the camera frame.
#[derive(Debug, Clone, Copy)]
pub(crate) struct TextureInView {
    texture: Texture,
    /// Turns from the camera frame to the body frame, in units of the grain.
    turn: Matrix3<f64>,
    /// Camera position in the body frame, in units of the grain.
    shift: Vector3<f64>,
    focal: f64,
}

impl TextureInView {
    /// Creates the texture of a body for a camera with this focal length \[pixels\].
    pub(crate) fn new(texture: Texture, camera_from_body: &Isometry3<f64>, focal: f64) -> Self {
        let body_from_camera = camera_from_body.inverse();
        let per_grain = Matrix3::from_diagonal(&texture.grain.map(|grain| 1.0 / grain));
        let turn = per_grain * body_from_camera.rotation.to_rotation_matrix().matrix();
        let shift = per_grain * body_from_camera.translation.vector;
        Self { texture, turn, shift, focal }
    }

    /// Returns a sampler of the texture.
    pub(crate) fn sampler(&self) -> TextureSampler<'_> {
        TextureSampler { view: self, noise: GradientNoise::new(self.texture.seed) }
    }
}

/// Samples a texture. Successive samples at neighboring places are fast.
pub(crate) struct TextureSampler<'a> {
    view: &'a TextureInView,
    noise: GradientNoise,
}

impl TextureSampler<'_> {
    /// Returns a color modulated by the texture where a ray hits the surface at 1/z = `nearness`. The normal may have any
    /// length.
    pub(crate) fn modulate(
        &mut self,
        color: Color,
        ray: &Vector3<f64>,
        nearness: f64,
        normal: &Vector3<f64>,
    ) -> Color {
        let TextureInView { texture, turn, shift, focal } = self.view;
        let depth = 1.0 / nearness;
        let point = turn * ray * depth;
        // Distances on the surface between neighboring pixels along u and v, in units of the grain. On the tangent plane, 1/z is
        // the product of `plane` and the ray.
        let plane = normal * (nearness / normal.dot(ray));
        let step = |axis: usize| (turn.column(axis) - point * plane[axis]) * (depth / focal);
        let squares = step(0).map(|s| s * s) + step(1).map(|s| s * s);
        let pixel = squares.x.max(squares.y).max(squares.z).sqrt();
        let factor = 1.0 + texture.contrast * self.noise.at(&(point + shift), pixel);
        color.map(|c| (c * factor).clamp(0.0, 1.0))
    }
}
