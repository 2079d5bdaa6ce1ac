//! Surfaces in the camera frame: how near they are along a ray, and what color they show.
//!
//! A ray through an image point is `(x, y, 1)`, so that its length parameter is the depth z. Surfaces answer with the
//! *nearness* 1/z, which is linear over the image for a plane and 0 where there is nothing.

use crate::scene::{Color, Light};
use crate::texture::TextureInView;
use nalgebra::{Matrix3, Vector3};

/// A part of the image's contents that has one material and lies on one surface.
#[derive(Debug, Clone)]
pub(crate) struct Patch {
    /// Instance number of its body.
    pub(crate) instance: u16,
    /// Where it lies.
    pub(crate) surface: Surface,
    /// Its color.
    pub(crate) color: Color,
    /// Brightness of a flat surface.
    pub(crate) brightness: f64,
    /// Its texture, if any.
    pub(crate) texture: Option<TextureInView>,
}

/// The geometry of a patch.
#[derive(Debug, Clone)]
pub(crate) enum Surface {
    /// A plane, whose nearness along a ray is the product with this vector; 0 for nothing at all.
    Flat(Vector3<f64>),
    /// A sphere, or the side of a cylinder.
    Round(Quadric),
}

impl Surface {
    /// 1/z along a ray which is known to meet the surface.
    pub(crate) fn nearness(&self, ray: &Vector3<f64>) -> f64 {
        match self {
            Self::Flat(plane) => plane.dot(ray),
            Self::Round(quadric) => quadric.on_line(ray.y).nearness(ray.x),
        }
    }

    /// The surface as the image line with this y has it.
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

/// A sphere or an endless cylinder: the points p with `|across (p - center)| = radius`.
#[derive(Debug, Clone)]
pub(crate) struct Quadric {
    /// The identity for a sphere, the projection along the axis for a cylinder.
    pub(crate) across: Matrix3<f64>,
    /// `across` times the center.
    pub(crate) center: Vector3<f64>,
    /// Radius.
    pub(crate) radius: f64,
    /// Squared distance of the camera less the squared radius: positive if the camera is outside.
    pub(crate) power: f64,
}

impl Quadric {
    /// A sphere.
    pub(crate) fn sphere(center: Vector3<f64>, radius: f64) -> Self {
        Self { across: Matrix3::identity(), center, radius, power: center.norm_squared() - radius * radius }
    }

    /// A cylinder without ends about the line through `center` along the unit vector `axis`.
    pub(crate) fn cylinder(center: Vector3<f64>, axis: &Vector3<f64>, radius: f64) -> Self {
        let across = Matrix3::identity() - axis * axis.transpose();
        let center = across * center;
        Self { across, center, radius, power: center.norm_squared() - radius * radius }
    }

    /// The quadric with its axes x and y exchanged.
    pub(crate) fn transposed(&self) -> Self {
        let mut across = self.across;
        across.swap_rows(0, 1);
        across.swap_columns(0, 1);
        Self { across, center: self.center.yxz(), ..*self }
    }

    /// Is the camera outside?
    pub(crate) fn is_in_view(&self) -> bool {
        self.power > 0.0
    }

    /// The quadric as the image line with this y has it.
    pub(crate) fn on_line(&self, y: f64) -> QuadricOnLine<'_> {
        let offset = Vector3::new(0.0, y, 1.0);
        let offset_across = self.across * offset;
        QuadricOnLine {
            quadric: self,
            y,
            offset_across,
            square: [self.across.m11, offset_across.x, offset.dot(&offset_across)],
            towards: [self.center.x, self.center.dot(&offset)],
        }
    }
}

/// A quadric along an image line, by the ray's x.
#[derive(Debug)]
pub(crate) struct QuadricOnLine<'a> {
    quadric: &'a Quadric,
    y: f64,
    /// `across (0, y, 1)`.
    offset_across: Vector3<f64>,
    /// Coefficients of `ray·across ray`, the second one halved.
    square: [f64; 3],
    /// Coefficients of `ray·center`.
    towards: [f64; 2],
}

impl QuadricOnLine<'_> {
    // The ray meets the quadric where square z² - 2 towards z + power = 0.
    fn towards_and_discriminant(&self, x: f64) -> (f64, f64) {
        let towards = self.towards[0] * x + self.towards[1];
        let square = (self.square[0] * x + 2.0 * self.square[1]) * x + self.square[2];
        (towards, towards * towards - square * self.quadric.power)
    }

    /// Does the ray enter it? (The camera is outside.)
    pub(crate) fn is_met(&self, x: f64) -> bool {
        let (towards, discriminant) = self.towards_and_discriminant(x);
        towards > 0.0 && discriminant >= 0.0
    }

    /// 1/z where the ray enters; that of the outline for a ray which misses narrowly.
    pub(crate) fn nearness(&self, x: f64) -> f64 {
        let (towards, discriminant) = self.towards_and_discriminant(x);
        (towards + discriminant.max(0.0).sqrt()) / self.quadric.power
    }

    /// 1/z and the unit normal where the ray enters.
    pub(crate) fn entry(&self, x: f64) -> (f64, Vector3<f64>) {
        let ray_across = self.quadric.across.column(0) * x + self.offset_across;
        let nearness = self.nearness(x);
        let point_across = ray_across * (1.0 / nearness);
        (nearness, (point_across - self.quadric.center) * (1.0 / self.quadric.radius))
    }

    /// Brightness along the line where rays enter. `light` is in the camera frame.
    pub(crate) fn shading(&self, light: &Light) -> Shading {
        let Quadric { across, center, radius, power } = self.quadric;
        let along = |v: &Vector3<f64>| light.towards_light.dot(v) * (1.0 / radius);
        Shading {
            square: self.square,
            towards: self.towards,
            power: *power,
            slope: along(&across.column(0).into_owned()),
            offset: along(&self.offset_across),
            center: along(center),
            ambient: light.ambient,
        }
    }

    /// x of the rays that touch it.
    pub(crate) fn outline(&self) -> [f64; 2] {
        let ([s, h, c], [t, u]) = (self.square, self.towards);
        let p = self.quadric.power;
        roots(t * t - p * s, t * u - p * h, u * u - p * c)
    }

    /// x of the rays that meet its intersection with the plane `normal·p = distance`, in front or behind.
    pub(crate) fn section(&self, normal: &Vector3<f64>, distance: f64) -> [f64; 2] {
        let ([s, h, c], [t, u]) = (self.square, self.towards);
        let (p, d) = (self.quadric.power, distance);
        let [n, m] = [normal.x, normal.y * self.y + normal.z];
        roots(
            d * d * s - 2.0 * d * t * n + p * n * n,
            d * d * h - d * (t * m + u * n) + p * n * m,
            d * d * c - 2.0 * d * u * m + p * m * m,
        )
    }
}

/// Brightness of a quadric along an image line: at the point `p = z r` the normal is `(across p - center) / radius`, and its
/// product with the direction towards the light is `z (slope x + offset) - center`.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Shading {
    square: [f64; 3],
    towards: [f64; 2],
    power: f64,
    slope: f64,
    offset: f64,
    center: f64,
    ambient: f64,
}

impl Shading {
    /// At the ray with this x.
    pub(crate) fn at(&self, x: f64) -> f64 {
        let towards = self.towards[0] * x + self.towards[1];
        let square = (self.square[0] * x + 2.0 * self.square[1]) * x + self.square[2];
        let root = (towards * towards - square * self.power).max(0.0).sqrt();
        let depth = self.power / (towards + root);
        let cosine = (self.slope * x + self.offset) * depth - self.center;
        self.ambient + (1.0 - self.ambient) * cosine.max(0.0)
    }
}

/// Roots of `a x² + 2 b x + c`; what is not a finite number is no root.
pub(crate) fn roots(a: f64, b: f64, c: f64) -> [f64; 2] {
    let root = (b * b - a * c).sqrt();
    let sum = if b < 0.0 { b - root } else { b + root };
    [-sum / a, -c / sum]
}
