//! Spheres and cylinders in the camera frame, in closed form along an image line.

use crate::scene::Light;
use nalgebra::{Matrix3, Vector3};

/// A sphere or an infinite cylinder: the points p with `|across (p - center)| = radius`.
#[derive(Debug, Clone)]
pub(crate) struct Quadric {
    /// Identity for a sphere, projection along the axis for a cylinder.
    pub(crate) across: Matrix3<f64>,
    /// `across` times the center.
    pub(crate) center: Vector3<f64>,
    /// Radius.
    pub(crate) radius: f64,
    /// Power of the camera center: its squared distance minus the squared radius, positive if the camera is outside.
    pub(crate) power: f64,
}

impl Quadric {
    /// Creates a sphere.
    pub(crate) fn sphere(center: Vector3<f64>, radius: f64) -> Self {
        Self { across: Matrix3::identity(), center, radius, power: center.norm_squared() - radius * radius }
    }

    /// Creates an infinite cylinder about the line through `center` along the unit vector `axis`.
    pub(crate) fn cylinder(center: Vector3<f64>, axis: &Vector3<f64>, radius: f64) -> Self {
        let across = Matrix3::identity() - axis * axis.transpose();
        let center = across * center;
        Self { across, center, radius, power: center.norm_squared() - radius * radius }
    }

    /// Swaps the x and y axes.
    pub(crate) fn transposed(&self) -> Self {
        let mut across = self.across;
        across.swap_rows(0, 1);
        across.swap_columns(0, 1);
        Self { across, center: self.center.yxz(), ..*self }
    }

    /// Returns whether the camera is outside.
    pub(crate) fn is_in_view(&self) -> bool {
        self.power > 0.0
    }

    /// Restricts the quadric to the image line with this y.
    pub(crate) fn on_line(&self, y: f64) -> QuadricOnLine<'_> {
        let offset = Vector3::new(0.0, y, 1.0);
        let offset_across = self.across * offset;
        QuadricOnLine {
            quadric: self,
            y,
            offset_across,
            square: [self.across.m11, offset_across.x, offset.dot(&offset_across)],
            toward: [self.center.x, self.center.dot(&offset)],
        }
    }
}

/// A quadric along an image line, as a function of the x of a ray.
#[derive(Debug)]
pub(crate) struct QuadricOnLine<'a> {
    quadric: &'a Quadric,
    y: f64,
    /// `across (0, y, 1)`.
    offset_across: Vector3<f64>,
    /// Coefficients of `ray·across ray` as a polynomial in x, the middle one halved.
    square: [f64; 3],
    /// Coefficients of `ray·center` as a polynomial in x.
    toward: [f64; 2],
}

impl QuadricOnLine<'_> {
    // The ray hits the quadric where square z² - 2 toward z + power = 0.
    fn toward_and_discriminant(&self, x: f64) -> (f64, f64) {
        let toward = self.toward[0] * x + self.toward[1];
        let square = (self.square[0] * x + 2.0 * self.square[1]) * x + self.square[2];
        (toward, toward * toward - square * self.quadric.power)
    }

    /// Returns whether the ray with this x hits the quadric. The camera must be outside.
    pub(crate) fn is_met(&self, x: f64) -> bool {
        let (toward, discriminant) = self.toward_and_discriminant(x);
        toward > 0.0 && discriminant >= 0.0
    }

    /// Returns 1/z where the ray enters. A ray that narrowly misses gets the value at the outline.
    pub(crate) fn nearness(&self, x: f64) -> f64 {
        let (toward, discriminant) = self.toward_and_discriminant(x);
        (toward + discriminant.max(0.0).sqrt()) / self.quadric.power
    }

    /// Returns 1/z and the unit normal where the ray enters.
    pub(crate) fn entry(&self, x: f64) -> (f64, Vector3<f64>) {
        let ray_across = self.quadric.across.column(0) * x + self.offset_across;
        let nearness = self.nearness(x);
        let point_across = ray_across * (1.0 / nearness);
        (nearness, (point_across - self.quadric.center) * (1.0 / self.quadric.radius))
    }

    /// Returns the brightness along the line. `light` is in the camera frame.
    pub(crate) fn shading(&self, light: &Light) -> Shading {
        let Quadric { across, center, radius, power } = self.quadric;
        let along = |v: &Vector3<f64>| light.towards_light.dot(v) * (1.0 / radius);
        Shading {
            square: self.square,
            toward: self.toward,
            power: *power,
            slope: along(&across.column(0).into_owned()),
            offset: along(&self.offset_across),
            center: along(center),
            ambient: light.ambient,
        }
    }

    /// Returns the x of the tangent rays.
    pub(crate) fn outline(&self) -> [f64; 2] {
        let ([s, h, c], [t, u]) = (self.square, self.toward);
        let p = self.quadric.power;
        roots(t * t - p * s, t * u - p * h, u * u - p * c)
    }

    /// Returns the x of the rays through the intersection with the plane `normal·p = distance`, in front of the camera or behind
    /// it.
    pub(crate) fn section(&self, normal: &Vector3<f64>, distance: f64) -> [f64; 2] {
        let ([s, h, c], [t, u]) = (self.square, self.toward);
        let (p, d) = (self.quadric.power, distance);
        let [n, m] = [normal.x, normal.y * self.y + normal.z];
        roots(
            d * d * s - 2.0 * d * t * n + p * n * n,
            d * d * h - d * (t * m + u * n) + p * n * m,
            d * d * c - 2.0 * d * u * m + p * m * m,
        )
    }
}

/// Brightness of a quadric along an image line. At the point `p = z r` the normal is `(across p - center) / radius`, and its
/// product with the direction toward the light is `z (slope x + offset) - center`.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Shading {
    square: [f64; 3],
    toward: [f64; 2],
    power: f64,
    slope: f64,
    offset: f64,
    center: f64,
    ambient: f64,
}

impl Shading {
    /// Returns the brightness on the ray with this x.
    pub(crate) fn at(&self, x: f64) -> f64 {
        let toward = self.toward[0] * x + self.toward[1];
        let square = (self.square[0] * x + 2.0 * self.square[1]) * x + self.square[2];
        let root = (toward * toward - square * self.power).max(0.0).sqrt();
        let depth = self.power / (toward + root);
        let cosine = (self.slope * x + self.offset) * depth - self.center;
        self.ambient + (1.0 - self.ambient) * cosine.max(0.0)
    }
}

/// Returns the roots of `a x² + 2 b x + c`. A value that is not finite stands for a missing root.
pub(crate) fn roots(a: f64, b: f64, c: f64) -> [f64; 2] {
    let root = (b * b - a * c).sqrt();
    let sum = if b < 0.0 { b - root } else { b + root };
    [-sum / a, -c / sum]
}
