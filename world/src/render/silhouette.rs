//! Silhouettes: the part of an image line that a face of a body occupies, in closed form.
//!
//! An image line is a plane through the camera center. Its intersection with a polygon is an interval, bounded by two of the
//! planes through the camera center and an edge. Polygons beside or behind the camera need no clipping. The outline of a sphere
//! or a cylinder, its rims and the borders of the cross are roots of quadratics along the line.

use crate::render::quadric::{Quadric, QuadricOnLine};
use nalgebra::Vector3;

/// An interval of an image line that shows one patch, unless something hides it.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Strip {
    /// Left end.
    pub(crate) from: f64,
    /// Right end.
    pub(crate) to: f64,
    /// Index of the patch.
    pub(crate) patch: u16,
}

/// The cross on the upper side, in the camera frame. Its patch follows that of the surface that it is on.
#[derive(Debug, Clone)]
pub(crate) struct CrossInView {
    /// Axes of the body.
    pub(crate) axes: [Vector3<f64>; 3],
    /// Center of the body along these axes.
    pub(crate) center: [f64; 3],
    /// Half of the width of a bar.
    pub(crate) half_width: f64,
}

impl CrossInView {
    fn transposed(&self) -> Self {
        Self { axes: self.axes.map(|axis| axis.yxz()), ..self.clone() }
    }

    fn contains(&self, point: &Vector3<f64>) -> bool {
        let [x, y, z] = [0, 1, 2].map(|i| self.axes[i].dot(point) - self.center[i]);
        z > 0.0 && (x.abs() < self.half_width || y.abs() < self.half_width)
    }

    /// Iterates over the planes that bound the bars, as (normal, distance from the camera).
    fn borders(&self) -> impl Iterator<Item = (&Vector3<f64>, f64)> {
        let sides = [-self.half_width, self.half_width];
        (0..2).flat_map(move |i| sides.map(|side| (&self.axes[i], self.center[i] + side)))
    }
}

/// A convex polygon with four edges that faces the camera.
#[derive(Debug, Clone)]
pub(crate) struct Face {
    /// Inward normals of the planes through the camera and the edges.
    pub(crate) edges: [Vector3<f64>; 4],
    /// Plane: the nearness along a ray is the product with this vector.
    pub(crate) plane: Vector3<f64>,
    /// Cross, if any.
    pub(crate) cross: Option<CrossInView>,
    /// Index of the patch.
    pub(crate) patch: u16,
}

impl Face {
    /// Creates the face with these corners (in cyclic order). Returns `None` if it faces away from the camera or is seen edge-on.
    pub(crate) fn new(corners: &[Vector3<f64>; 4], outward: &Vector3<f64>, patch: u16) -> Option<Self> {
        let center = (corners[0] + corners[2]) / 2.0;
        let distance = outward.dot(&center);
        let edges = [0, 1, 2, 3].map(|i| {
            let normal = corners[i].cross(&corners[(i + 1) % 4]);
            if normal.dot(&center) < 0.0 { -normal } else { normal }
        });
        (distance < -1e-9).then(|| Self { edges, plane: outward / distance, cross: None, patch })
    }

    fn transposed(&self) -> Self {
        let cross = self.cross.as_ref().map(CrossInView::transposed);
        Self { edges: self.edges.map(|edge| edge.yxz()), plane: self.plane.yxz(), cross, patch: self.patch }
    }

    fn strips(&self, line: &mut ImageLine) {
        let (mut from, mut to) = (line.from, line.to);
        for edge in &self.edges {
            let constant = edge.y * line.y + edge.z;
            let end = -constant / edge.x;
            if edge.x > 0.0 {
                from = from.max(end);
            } else if edge.x < 0.0 {
                to = to.min(end);
            } else if constant < 0.0 {
                return;
            }
        }
        if from >= to {
            return;
        }
        let Some(cross) = &self.cross else {
            line.strips.push(Strip { from, to, patch: self.patch });
            return;
        };
        line.begin(from, to);
        line.cut_by_borders(cross, &self.plane);
        line.classify(|ray| Some(self.patch + u16::from(cross.contains(&(ray / self.plane.dot(ray))))));
    }
}

/// A sphere, or a cylinder. At most one end of a cylinder is in view.
#[derive(Debug, Clone)]
pub(crate) struct Round {
    /// Curved surface.
    pub(crate) quadric: Quadric,
    /// Cross on a sphere, if any.
    pub(crate) cross: Option<CrossInView>,
    /// Index of the patch of the curved surface.
    pub(crate) patch: u16,
    /// Ends of a cylinder; `None` for a sphere.
    pub(crate) ends: Option<Ends>,
}

/// The two ends of a cylinder.
#[derive(Debug, Clone)]
pub(crate) struct Ends {
    /// Axis.
    pub(crate) axis: Vector3<f64>,
    /// Positions of the ends along the axis, relative to the camera.
    pub(crate) along: [f64; 2],
    /// Plane (see [`Face`]), cross and patch of the end that faces the camera, if one does.
    pub(crate) cap: Option<(Vector3<f64>, Option<CrossInView>, u16)>,
}

impl Round {
    fn transposed(&self) -> Self {
        let cross = |cross: &Option<CrossInView>| cross.as_ref().map(CrossInView::transposed);
        let ends = self.ends.as_ref().map(|Ends { axis, along, cap }| {
            let cap = cap.as_ref().map(|(plane, on_cap, patch)| (plane.yxz(), cross(on_cap), *patch));
            Ends { axis: axis.yxz(), along: *along, cap }
        });
        Self { quadric: self.quadric.transposed(), cross: cross(&self.cross), patch: self.patch, ends }
    }

    fn strips(&self, line: &mut ImageLine) {
        line.begin(line.from, line.to);
        let quadric = self.quadric.on_line(line.y);
        line.cut(quadric.outline());
        if let Some(ends) = &self.ends {
            for distance in ends.along {
                line.cut(quadric.section(&ends.axis, distance));
            }
            if let Some((plane, Some(cross), _)) = &ends.cap {
                line.cut_by_borders(cross, plane);
            }
        } else if let Some(cross) = &self.cross {
            for (normal, distance) in cross.borders() {
                line.cut(quadric.section(normal, distance));
            }
            line.cut(quadric.section(&cross.axes[2], cross.center[2]));
        }
        line.classify(|ray| self.patch_on(ray, &quadric));
    }

    fn patch_on(&self, ray: &Vector3<f64>, quadric: &QuadricOnLine) -> Option<u16> {
        if let Some(Ends { cap: Some((plane, cross, patch)), .. }) = &self.ends {
            let nearness = plane.dot(ray);
            let point = ray / nearness;
            let off_axis = self.quadric.across * point - self.quadric.center;
            if nearness > 0.0 && off_axis.norm_squared() < self.quadric.radius * self.quadric.radius {
                return Some(patch + u16::from(cross.as_ref().is_some_and(|cross| cross.contains(&point))));
            }
        }
        if !self.quadric.is_in_view() || !quadric.is_met(ray.x) {
            return None;
        }
        let point = ray / quadric.nearness(ray.x);
        if let Some(Ends { axis, along: [bottom, top], .. }) = &self.ends {
            let along = axis.dot(&point);
            return (*bottom < along && along < *top).then_some(self.patch);
        }
        Some(self.patch + u16::from(self.cross.as_ref().is_some_and(|cross| cross.contains(&point))))
    }
}

/// A surface with a silhouette.
#[derive(Debug, Clone)]
pub(crate) enum Silhouette {
    /// Face of a cuboid, or the table.
    Face(Face),
    /// Sphere or cylinder.
    Round(Round),
}

impl Silhouette {
    /// Returns the silhouette in the transposed image, whose lines are the columns of the image.
    pub(crate) fn transposed(&self) -> Self {
        match self {
            Self::Face(face) => Self::Face(face.transposed()),
            Self::Round(round) => Self::Round(round.transposed()),
        }
    }
}

/// The strips on the image line with this y, between the left and right border of the image.
#[derive(Debug, Default)]
pub(crate) struct ImageLine {
    pub(crate) y: f64,
    pub(crate) from: f64,
    pub(crate) to: f64,
    pub(crate) strips: Vec<Strip>,
    cuts: Vec<f64>,
}

impl ImageLine {
    /// Creates an empty line between two borders.
    pub(crate) fn new(from: f64, to: f64) -> Self {
        Self { from, to, ..Self::default() }
    }

    /// Adds the strips of a silhouette.
    pub(crate) fn add(&mut self, silhouette: &Silhouette) {
        match silhouette {
            Silhouette::Face(face) => face.strips(self),
            Silhouette::Round(round) => round.strips(self),
        }
    }

    fn begin(&mut self, from: f64, to: f64) {
        self.cuts.clear();
        self.cuts.extend([from, to]);
    }

    fn cut(&mut self, roots: [f64; 2]) {
        let (from, to) = (self.cuts[0], self.cuts[1]);
        self.cuts.extend(roots.into_iter().filter(|x| from < *x && *x < to));
    }

    // The border is where t e·r = d, with 1/t = plane·r: a straight line in the image.
    fn cut_by_borders(&mut self, cross: &CrossInView, plane: &Vector3<f64>) {
        for (normal, distance) in cross.borders() {
            let border = normal - plane * distance;
            self.cut([-(border.y * self.y + border.z) / border.x, f64::NAN]);
        }
    }

    /// Adds a strip between each two neighboring cuts, with the patch on the ray through their middle, if any.
    fn classify(&mut self, patch_on: impl Fn(&Vector3<f64>) -> Option<u16>) {
        self.cuts.sort_unstable_by(f64::total_cmp);
        for pair in self.cuts.windows(2) {
            let (from, to) = (pair[0], pair[1]);
            if from < to
                && let Some(patch) = patch_on(&Vector3::new(0.5 * (from + to), self.y, 1.0))
            {
                self.strips.push(Strip { from, to, patch });
            }
        }
    }
}
