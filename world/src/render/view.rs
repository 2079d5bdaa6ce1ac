//! A scene in the frame of one camera: the surfaces that face it.

use crate::camera::Camera;
use crate::color::Color;
use crate::geometry::overlap;
use crate::render::quadric::{Quadric, roots};
use crate::render::silhouette::{CrossInView, Ends, Face, ImageLine, Round, Silhouette};
use crate::render::surface::{Patch, Surface};
use crate::render::texture_sampler::TextureInView;
use crate::scene::{Body, Light, Scene, Shape, Table};
use nalgebra::{Isometry3, Matrix3, Point3, Translation3, UnitVector3, Vector3};

/// Everything that the camera may see.
#[derive(Debug)]
pub(crate) struct View<'a> {
    /// Camera.
    pub(crate) camera: &'a Camera,
    /// Light in the camera frame.
    pub(crate) light: Light,
    /// Patches; the first is the background.
    pub(crate) patches: Vec<Patch>,
    /// Silhouettes, each with its vertical extent in the image \[pixels\].
    pub(crate) silhouettes: Vec<(Silhouette, [f64; 2])>,
    /// Heights in the image where an outline begins, ends, has a corner or crosses the border, and those of the upper and lower
    /// border \[pixels\].
    pub(crate) breaks: Vec<f64>,
    /// Whether bodies intersect each other or the table, so that visible surfaces may cross.
    pub(crate) crossing: bool,
}

/// Properties common to the patches of a body.
struct Paint {
    instance: u16,
    color: Color,
    cross: Option<(CrossInView, Color)>,
    texture: Option<TextureInView>,
}

impl<'a> View<'a> {
    /// Creates the view of a scene from a camera pose.
    pub(crate) fn new(scene: &Scene, camera: &'a Camera, robot_from_camera: &Isometry3<f64>) -> Self {
        let camera_from_robot = robot_from_camera.inverse();
        let towards_light = camera_from_robot.rotation * scene.light.towards_light.into_inner();
        let mut view = Self {
            camera,
            light: Light { towards_light: UnitVector3::new_unchecked(towards_light), ..scene.light },
            patches: vec![Patch {
                instance: 0,
                surface: Surface::Flat(Vector3::zeros()),
                color: scene.background,
                brightness: 1.0,
                texture: None,
            }],
            silhouettes: Vec::new(),
            breaks: Vec::new(),
            crossing: is_crossing(scene),
        };
        for (instance, body) in (1..).zip(scene.bodies()) {
            view.add_body(body, instance, &camera_from_robot);
        }
        view.add_table(&scene.table, &camera_from_robot);
        view.break_at_borders();
        view.settle_breaks();
        view
    }

    fn add_table(&mut self, table: &Table, camera_from_robot: &Isometry3<f64>) {
        let [x, y] = table.half_size;
        let corners = [(-x, -y), (x, -y), (x, y), (-x, y)]
            .map(|(x, y)| (camera_from_robot * (table.center + Vector3::new(x, y, 0.0))).coords);
        let camera_from_table = camera_from_robot * Translation3::from(table.center);
        let texture = table.texture.map(|t| TextureInView::new(t, &camera_from_table, self.camera.focal));
        let paint = Paint { instance: 0, color: table.color, cross: None, texture };
        self.add_face(&corners, &(camera_from_robot.rotation * Vector3::z()), &paint);
    }

    /// Adds the heights where outlines cross the left and right border of the image. Nothing is traced beyond the borders, so an
    /// outline that leaves the image begins or ends at a height that is not one of its landmarks.
    fn break_at_borders(&mut self) {
        let Camera { width, height, focal, center, .. } = *self.camera;
        let mut border = ImageLine::new(-center.y / focal, (f64::from(height) - center.y) / focal);
        for (silhouette, _) in &self.silhouettes {
            let transposed = silhouette.transposed();
            for u in [0.0, f64::from(width)] {
                border.y = (u - center.x) / focal;
                border.add(&transposed);
            }
        }
        let ends = border.strips.iter().flat_map(|strip| [strip.from, strip.to]);
        self.breaks.extend(ends.map(|y| center.y + focal * y));
    }

    /// Adds the upper and lower border, and sorts the breaks.
    fn settle_breaks(&mut self) {
        let height = f64::from(self.camera.height);
        self.breaks.retain(|v| (1e-6..height - 1e-6).contains(v));
        self.breaks.extend([0.0, height]);
        self.breaks.sort_unstable_by(f64::total_cmp);
        self.breaks.dedup_by(|next, v| *next - *v < 1e-6);
    }

    fn add_body(&mut self, body: &Body, instance: u16, camera_from_robot: &Isometry3<f64>) {
        let camera_from_body = camera_from_robot * body.robot_from_body;
        let axes = [Vector3::x(), Vector3::y(), Vector3::z()].map(|axis| camera_from_body.rotation * axis);
        let center = camera_from_body.translation.vector;
        let cross = body.material.cross.map(|cross| {
            let along = axes.map(|axis| axis.dot(&center));
            (CrossInView { axes, center: along, half_width: cross.width / 2.0 }, cross.color)
        });
        if let Some(cross) = body.material.cross {
            let landmarks = cross_landmarks(&body.shape, cross.width / 2.0);
            self.range(&landmarks.map(|point| (camera_from_body * point).coords), true);
        }
        let texture =
            body.material.texture.map(|t| TextureInView::new(t, &camera_from_body, self.camera.focal));
        let paint = Paint { instance, color: body.material.color, cross, texture };
        match body.shape {
            Shape::Cuboid { half_extents } => self.add_cuboid(&center, &axes, &half_extents, &paint),
            Shape::Cylinder { radius, half_height } => {
                self.add_cylinder(&center, &axes[2], [radius, half_height], &paint);
            }
            Shape::Sphere { radius } => self.add_sphere(&center, radius, &paint),
        }
    }

    fn add_cuboid(
        &mut self,
        center: &Vector3<f64>,
        axes: &[Vector3<f64>; 3],
        half_extents: &Vector3<f64>,
        paint: &Paint,
    ) {
        let half = [0, 1, 2].map(|i| axes[i] * half_extents[i]);
        let plain = Paint { cross: None, ..*paint };
        for i in 0..3 {
            for side in [1.0, -1.0] {
                let (middle, p, q) = (center + half[i] * side, half[(i + 1) % 3], half[(i + 2) % 3]);
                let corners = [middle + p + q, middle + p - q, middle - p - q, middle - p + q];
                let is_upper = i == 2 && side > 0.0;
                self.add_face(&corners, &(axes[i] * side), if is_upper { paint } else { &plain });
            }
        }
    }

    fn add_face(&mut self, corners: &[Vector3<f64>; 4], outward: &Vector3<f64>, paint: &Paint) {
        let Some(mut face) = Face::new(corners, outward, self.patches.len() as u16) else { return };
        let range = self.range(corners, corners.iter().all(|corner| corner.z > 1e-6));
        self.add_patches(&Surface::Flat(face.plane), self.light.on(outward), paint);
        face.cross = paint.cross.as_ref().map(|(cross, _)| cross.clone());
        self.silhouettes.push((Silhouette::Face(face), range));
    }

    fn add_sphere(&mut self, center: &Vector3<f64>, radius: f64, paint: &Paint) {
        let quadric = Quadric::sphere(*center, radius);
        if !quadric.is_in_view() {
            return;
        }
        let patch = self.add_patches(&Surface::Round(quadric.clone()), 1.0, paint);
        let cross = paint.cross.as_ref().map(|(cross, _)| cross.clone());
        let range = self.range(&extremes(center, &quadric.across, radius), center.z > radius);
        self.silhouettes.push((Silhouette::Round(Round { quadric, cross, patch, ends: None }), range));
    }

    fn add_cylinder(
        &mut self,
        center: &Vector3<f64>,
        axis: &Vector3<f64>,
        [radius, half_height]: [f64; 2],
        paint: &Paint,
    ) {
        let quadric = Quadric::cylinder(*center, axis, radius);
        let plain = Paint { cross: None, ..*paint };
        let patch = self.add_patches(&Surface::Round(quadric.clone()), 1.0, &plain);
        let (mut cap, mut landmarks) = (None, Vec::new());
        for (side, paint) in [(1.0, paint), (-1.0, &plain)] {
            let (outward, middle) = (axis * side, center + axis * (half_height * side));
            let distance = outward.dot(&middle);
            if distance < -1e-9 {
                let plane = outward / distance;
                let cross = paint.cross.as_ref().map(|(cross, _)| cross.clone());
                let patch = self.add_patches(&Surface::Flat(plane), self.light.on(&outward), paint);
                cap = Some((plane, cross, patch));
            }
            landmarks.extend(extremes(&middle, &quadric.across, radius));
            landmarks.extend(tangent_points(&quadric, axis).map(|point| point + outward * distance));
        }
        let range = self.range(&landmarks, center.z > radius + half_height);
        let along = [-half_height, half_height].map(|h| axis.dot(center) + h);
        let ends = Some(Ends { axis: *axis, along, cap });
        self.silhouettes.push((Silhouette::Round(Round { quadric, cross: None, patch, ends }), range));
    }

    /// Adds a patch, and that of the cross on it, if any. Returns the index of the first.
    fn add_patches(&mut self, surface: &Surface, brightness: f64, paint: &Paint) -> u16 {
        let index = self.patches.len() as u16;
        let colors = std::iter::once(paint.color).chain(paint.cross.as_ref().map(|(_, color)| *color));
        self.patches.extend(colors.map(|color| Patch {
            instance: paint.instance,
            surface: surface.clone(),
            color,
            brightness,
            texture: paint.texture,
        }));
        index
    }

    /// Adds the heights of the projected landmarks of an outline. Returns the vertical extent of the outline in the image.
    fn range(&mut self, landmarks: &[Vector3<f64>], is_all_ahead: bool) -> [f64; 2] {
        let mut range = [f64::INFINITY, f64::NEG_INFINITY];
        for pixel in landmarks.iter().filter_map(|point| self.camera.project(&(*point).into())) {
            self.breaks.push(pixel.y);
            range = [range[0].min(pixel.y), range[1].max(pixel.y)];
        }
        if is_all_ahead { range } else { [f64::NEG_INFINITY, f64::INFINITY] }
    }
}

/// Returns directions in the highest and the lowest image line that touch a sphere, or the circle in which the plane through
/// `center` cuts a cylinder. The normal `N = (0, 1, -y)` of such a line's plane satisfies `(N·center)² = radius² N·across N`.
fn extremes(center: &Vector3<f64>, across: &Matrix3<f64>, radius: f64) -> [Vector3<f64>; 2] {
    let square = radius * radius;
    let a = center.z * center.z - square * across.m33;
    let b = square * across.m23 - center.y * center.z;
    let c = center.y * center.y - square * across.m22;
    roots(a, b, c).map(|y| Vector3::new(0.0, y, 1.0))
}

/// Returns the points where rays in the plane through the camera and perpendicular to the axis touch a cylinder; NaN if the
/// camera is inside.
fn tangent_points(quadric: &Quadric, axis: &Vector3<f64>) -> [Vector3<f64>; 2] {
    let (center, radius) = (quadric.center, quadric.radius);
    let square = center.norm_squared();
    let aside = axis.cross(&center) * (radius * quadric.power.sqrt() / square);
    [1.0, -1.0].map(|side| center * (quadric.power / square) + aside * side)
}

/// Returns the corners of the cross in the body frame: the ends of its bars, and the corners where they meet.
fn cross_landmarks(shape: &Shape, half_width: f64) -> [Point3<f64>; 12] {
    let at_distance = |radius: f64, distance: f64| (radius * radius - distance * distance).max(0.0).sqrt();
    let (reach, height, middle_height) = match *shape {
        Shape::Cuboid { half_extents } => ([half_extents.x, half_extents.y], half_extents.z, half_extents.z),
        Shape::Cylinder { radius, half_height } => {
            ([at_distance(radius, half_width); 2], half_height, half_height)
        }
        Shape::Sphere { radius } => {
            let reach = at_distance(radius, half_width);
            ([reach; 2], 0.0, at_distance(reach, half_width))
        }
    };
    std::array::from_fn(|i| {
        let sign = |bit: usize| if i & bit == 0 { -1.0 } else { 1.0 };
        match i / 4 {
            0 => Point3::new(sign(1) * reach[0], sign(2) * half_width, height),
            1 => Point3::new(sign(1) * half_width, sign(2) * reach[1], height),
            _ => Point3::new(sign(1) * half_width, sign(2) * half_width, middle_height),
        }
    })
}

/// Returns whether a body intersects another or reaches below the table top.
fn is_crossing(scene: &Scene) -> bool {
    let bodies: Vec<&Body> = scene.bodies().collect();
    let is_below = |body: &Body| body.lowest() < scene.table.height() - 1e-6;
    bodies.iter().any(|body| is_below(body))
        || bodies.iter().enumerate().any(|(i, a)| bodies[..i].iter().any(|b| overlap(a, b)))
}
