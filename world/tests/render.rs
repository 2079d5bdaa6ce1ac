//! Tests the renderer against independent oracles: closed-form silhouettes and a brute-force ray caster.

#![allow(missing_docs)]

use nalgebra::{Isometry3, Point2, Point3, UnitQuaternion, UnitVector3, Vector3};
use proptest::prelude::*;
use proptest::test_runner::RngSeed;
use world::config::CameraConfig;
use world::scene::{Cross, Light, Material, Table};
use world::{Body, Camera, Renderer, Scene, Sensor, Shape, Texture};

const WHITE: [f64; 3] = [1.0; 3];
const BLACK: [f64; 3] = [0.0; 3];

/// Uses the same cases in every run.
fn cases(cases: u32) -> ProptestConfig {
    let rng_seed = RngSeed::Fixed(1);
    ProptestConfig { cases, rng_seed, failure_persistence: None, ..ProptestConfig::default() }
}

fn camera(width: u32, height: u32) -> Camera {
    Camera::new(&CameraConfig { width, height, horizontal_fov_deg: 60.0, behind_hand_mm: 0.0 })
}

fn body(shape: Shape, position: [f64; 3], turn: [f64; 3], color: [f64; 3]) -> Body {
    let robot_from_body = Isometry3::new(position.into(), turn.into());
    Body { shape, robot_from_body, material: Material { color, cross: None, texture: None } }
}

fn cuboid(x: f64, y: f64, z: f64) -> Shape {
    Shape::Cuboid { half_extents: Vector3::new(x, y, z) }
}

/// A scene with one body in ambient light in front of black, far above the table, which is out of sight.
fn alone(body: Body) -> Scene {
    Scene {
        table: Table {
            center: Point3::new(0.0, 0.0, -1e6),
            half_size: [1e-3; 2],
            color: BLACK,
            texture: None,
        },
        target: body,
        obstacles: Vec::new(),
        light: Light { towards_light: Vector3::z_axis(), ambient: 1.0 },
        background: BLACK,
    }
}

/// A camera that looks from one point to another, with the u axis of the image horizontal.
fn looking(from: [f64; 3], to: [f64; 3]) -> Isometry3<f64> {
    let (from, to): (Point3<f64>, Point3<f64>) = (from.into(), to.into());
    let turn = UnitQuaternion::face_towards(&(to - from), &Vector3::new(1e-3, 0.0, -1.0));
    Isometry3::from_parts(from.coords.into(), turn)
}

/// Two cuboids, two cylinders and a sphere on a table, with crosses on three of them. Some occlude others.
fn busy_scene() -> Scene {
    let gray = [0.45, 0.45, 0.47];
    let mut scene = Scene {
        table: Table {
            center: Point3::new(0.4, 0.18, -0.02),
            half_size: [0.3, 0.25],
            color: [0.62, 0.5, 0.36],
            texture: None,
        },
        target: body(cuboid(0.03, 0.02, 0.02), [0.36, 0.18, 0.0], [0.0, 0.0, 0.3], [0.95; 3]),
        obstacles: vec![
            body(Shape::Cylinder { radius: 0.02, half_height: 0.03 }, [0.41, 0.16, 0.01], [0.0; 3], gray),
            body(cuboid(0.02, 0.03, 0.03), [0.34, 0.24, 0.01], [0.0, 0.0, 0.7], gray),
            body(Shape::Sphere { radius: 0.025 }, [0.31, 0.15, 0.005], [0.0; 3], [0.9, 0.8, 0.2]),
            body(
                Shape::Cylinder { radius: 0.015, half_height: 0.05 },
                [0.38, 0.1, 0.1],
                [1.2, 0.3, 0.0],
                gray,
            ),
        ],
        light: Light {
            towards_light: UnitVector3::new_normalize(Vector3::new(0.3, -0.4, 1.0)),
            ambient: 0.5,
        },
        background: [0.2, 0.22, 0.25],
    };
    let cross = Some(Cross { color: [0.85, 0.1, 0.1], width: 0.01 });
    scene.target.material.cross = cross;
    scene.obstacles[0].material.cross = cross;
    scene.obstacles[2].material.cross = cross;
    scene
}

/// Gives the table and all bodies of a scene textures with different seeds.
fn textured(mut scene: Scene, grain: [f64; 3], contrast: f64) -> Scene {
    let texture = |seed| Some(Texture { grain: grain.into(), contrast, seed });
    scene.table.texture = texture(1);
    scene.target.material.texture = texture(2);
    for (body, seed) in scene.obstacles.iter_mut().zip(3..) {
        body.material.texture = texture(seed);
    }
    scene
}

// ---- A ray caster ----

struct Hit {
    z: f64,
    instance: u16,
    color: [f64; 3],
}

/// Returns where a ray in the frame of a shape enters it, and the normal there.
fn enter(shape: &Shape, origin: &Vector3<f64>, ray: &Vector3<f64>) -> Option<(f64, Vector3<f64>)> {
    let slab = |i: usize, half: f64| {
        let ends = [(-half - origin[i]) / ray[i], (half - origin[i]) / ray[i]];
        let mut normal = Vector3::zeros();
        normal[i] = -ray[i].signum();
        (ends[0].min(ends[1]), ends[0].max(ends[1]), normal)
    };
    let round = |a: Vector3<f64>, o: Vector3<f64>, radius: f64| {
        let (b, root) =
            (a.dot(&o), a.dot(&o).powi(2) - a.norm_squared() * (o.norm_squared() - radius * radius));
        let ends = [-1.0, 1.0].map(|sign| (-b + sign * root.sqrt()) / a.norm_squared());
        (ends[0], ends[1], (o + a * ends[0]) / radius)
    };
    let flat = |v: &Vector3<f64>| Vector3::new(v.x, v.y, 0.0);
    let parts = match *shape {
        Shape::Cuboid { half_extents } => (0..3).map(|i| slab(i, half_extents[i])).collect(),
        Shape::Sphere { radius } => vec![round(*ray, *origin, radius)],
        Shape::Cylinder { radius, half_height } => {
            vec![round(flat(ray), flat(origin), radius), slab(2, half_height)]
        }
    };
    let first = parts.iter().copied().reduce(|a, b| if b.0 > a.0 { b } else { a })?;
    let leave = parts.iter().map(|part| part.1).fold(f64::INFINITY, f64::min);
    let is_hit = parts.iter().all(|part| part.0.is_finite()) && 0.0 < first.0 && first.0 < leave;
    is_hit.then_some((first.0, first.2))
}

fn dyed(color: [f64; 3], texture: Option<Texture>, point: &Point3<f64>) -> [f64; 3] {
    let factor = texture.map_or(1.0, |texture| texture.factor(point));
    color.map(|c| (c * factor).min(1.0))
}

fn cast(scene: &Scene, robot_from_camera: &Isometry3<f64>, ray: &Vector3<f64>) -> Hit {
    let mut nearest = Hit { z: f64::INFINITY, instance: 0, color: scene.background };
    let (origin, ray) = (robot_from_camera.translation.vector, robot_from_camera * ray);
    let lit = |color: [f64; 3], normal: &Vector3<f64>| color.map(|c| c * scene.light.on(normal));
    let z = (scene.table.height() - origin.z) / ray.z;
    let aside = origin + ray * z - scene.table.center.coords;
    let [x, y] = scene.table.half_size;
    if z > 0.0 && origin.z > scene.table.height() && aside.x.abs() < x && aside.y.abs() < y {
        let color = dyed(scene.table.color, scene.table.texture, &aside.into());
        nearest = Hit { z, instance: 0, color: lit(color, &Vector3::z()) };
    }
    for (body, instance) in scene.bodies().zip(1..) {
        let pose = body.robot_from_body;
        let local =
            [pose.inverse_transform_point(&origin.into()).coords, pose.inverse_transform_vector(&ray)];
        let Some((z, normal)) = enter(&body.shape, &local[0], &local[1]) else { continue };
        if z >= nearest.z {
            continue;
        }
        let point = local[0] + local[1] * z;
        let is_upper = match body.shape {
            Shape::Sphere { .. } => point.z > 0.0,
            _ => normal.z > 0.5,
        };
        let in_cross = |cross: &Cross| is_upper && point.x.abs().min(point.y.abs()) < cross.width / 2.0;
        let color = match body.material.cross {
            Some(cross) if in_cross(&cross) => cross.color,
            _ => body.material.color,
        };
        let color = dyed(color, body.material.texture, &point.into());
        nearest = Hit { z, instance, color: lit(color, &(pose * normal)) };
    }
    nearest
}

/// Returns the mean and the greatest difference from an image with `samples` x `samples` rays per pixel, in units of 1/255.
fn compare(camera: &Camera, scene: &Scene, pose: &Isometry3<f64>, samples: u32) -> (f64, f64) {
    let image = Renderer::new(camera.clone()).color(scene, pose);
    let (mut sum, mut greatest) = (0.0, 0.0f64);
    for (u, v, pixel) in image.enumerate_pixels() {
        let mut mean = Vector3::zeros();
        for i in 0..samples * samples {
            let at = |k: u32| (f64::from(k) + 0.5) / f64::from(samples);
            let place = Point2::new(f64::from(u) + at(i % samples), f64::from(v) + at(i / samples));
            mean += Vector3::from(cast(scene, pose, &camera.ray(&place)).color);
        }
        mean *= 255.0 / f64::from(samples * samples);
        for (value, expected) in pixel.0.iter().zip(mean.iter()) {
            let difference = (f64::from(*value) - expected).abs();
            sum += difference;
            greatest = greatest.max(difference);
        }
    }
    (sum / image.len() as f64, greatest)
}

fn views() -> impl Strategy<Value = Isometry3<f64>> {
    ((0.2..0.5f64, 0.0..0.35f64, 0.12..0.4f64), (0.3..0.42f64, 0.1..0.25f64, -0.02..0.02f64), -3.0..3.0f64)
        .prop_map(|(from, to, roll)| {
            looking(from.into(), to.into()) * UnitQuaternion::from_axis_angle(&Vector3::z_axis(), roll)
        })
}

proptest! {
    #![proptest_config(cases(12))]

    // 16 x 16 samples themselves have an error of up to 1/32 of the area of a pixel along a straight edge.
    #[test]
    fn an_image_is_what_rays_see(pose in views()) {
        let (mean, greatest) = compare(&camera(64, 48), &busy_scene(), &pose, 16);
        prop_assert!(mean < 0.4, "mean {mean}");
        prop_assert!(greatest < 8.0, "greatest {greatest}");
    }

    #[test]
    fn depth_and_instance_are_those_of_the_ray_through_the_pixel_center(pose in views()) {
        let (camera, scene) = (camera(96, 72), busy_scene());
        let frame = Renderer::new(camera.clone()).frame(&scene, &pose);
        for (i, (&depth, &instance)) in frame.depth.iter().zip(&frame.instance).enumerate() {
            let pixel = Point2::new((i % 96) as f64 + 0.5, (i / 96) as f64 + 0.5);
            let hit = cast(&scene, &pose, &camera.ray(&pixel));
            prop_assert_eq!(instance, hit.instance, "pixel {}", pixel);
            let both_see_nothing = depth.is_infinite() && hit.z.is_infinite();
            let is_same = both_see_nothing || (f64::from(depth) / hit.z - 1.0).abs() < 1e-6;
            prop_assert!(is_same, "pixel {}: {} instead of {}", pixel, depth, hit.z);
        }
    }
}

// ---- Silhouettes ----

/// The convex hull of image points (Andrew's monotone chain).
fn hull(mut points: Vec<Point2<f64>>) -> Vec<Point2<f64>> {
    points.sort_by(|a, b| a.x.total_cmp(&b.x).then(a.y.total_cmp(&b.y)));
    let half = |points: &mut dyn Iterator<Item = Point2<f64>>| {
        let mut chain: Vec<Point2<f64>> = Vec::new();
        for point in points {
            while let [.., a, b] = chain[..]
                && (b - a).perp(&(point - b)) <= 0.0
            {
                chain.pop();
            }
            chain.push(point);
        }
        chain.pop();
        chain
    };
    let mut all = half(&mut points.iter().copied());
    all.extend(half(&mut points.iter().rev().copied()));
    all
}

/// Area and centroid by the shoelace formula.
fn area_and_centroid(polygon: &[Point2<f64>]) -> (f64, Point2<f64>) {
    let (mut area, mut moment) = (0.0, nalgebra::Vector2::zeros());
    for (i, a) in polygon.iter().enumerate() {
        let b = polygon[(i + 1) % polygon.len()];
        let cross = a.coords.perp(&b.coords);
        area += cross / 2.0;
        moment += (a.coords + b.coords) * cross / 6.0;
    }
    (area, Point2::from(moment / area))
}

/// Returns the area of the intersection of a convex polygon and a pixel.
fn coverage(polygon: &[Point2<f64>], u: f64, v: f64) -> f64 {
    let mut rest = polygon.to_vec();
    for (axis, bound, sign) in [(0, u, 1.0), (0, u + 1.0, -1.0), (1, v, 1.0), (1, v + 1.0, -1.0)] {
        let inside = |p: &Point2<f64>| sign * (p[axis] - bound);
        let whole = std::mem::take(&mut rest);
        for (i, a) in whole.iter().enumerate() {
            let b = whole[(i + 1) % whole.len()];
            if inside(a) >= 0.0 {
                rest.push(*a);
            }
            if (inside(a) >= 0.0) != (inside(&b) >= 0.0) {
                rest.push(a + (b - a) * (inside(a) / (inside(a) - inside(&b))));
            }
        }
    }
    if rest.is_empty() { 0.0 } else { area_and_centroid(&rest).0 }
}

/// Returns the convex hull of the image of a body.
fn outline(body: &Body, pose: &Isometry3<f64>, camera: &Camera) -> Vec<Point2<f64>> {
    let camera_from_body = pose.inverse() * body.robot_from_body;
    let circle = |i: i32| (f64::from(i) * std::f64::consts::TAU / 600.0).sin_cos();
    let points: Vec<Point3<f64>> = match body.shape {
        Shape::Cuboid { half_extents: h } => (0..8)
            .map(|i| {
                Point3::from(
                    Vector3::from([1, 2, 4].map(|bit| if i & bit == 0 { -1.0 } else { 1.0 }))
                        .component_mul(&h),
                )
            })
            .collect(),
        Shape::Cylinder { radius, half_height } => (0..600)
            .flat_map(|i| {
                [-half_height, half_height]
                    .map(|z| Point3::new(radius * circle(i).0, radius * circle(i).1, z))
            })
            .collect(),
        // The circle in which rays touch the sphere.
        Shape::Sphere { radius } => {
            let to_eye = camera_from_body.inverse().translation.vector;
            let share = radius * radius / to_eye.norm_squared();
            let p = to_eye.cross(&Vector3::new(0.3, 0.5, 0.8)).normalize();
            let q = to_eye.normalize().cross(&p);
            let reach = radius * (1.0 - share).sqrt();
            (0..600)
                .map(|i| Point3::from(to_eye * share + (p * circle(i).0 + q * circle(i).1) * reach))
                .collect()
        }
    };
    hull(
        points
            .iter()
            .map(|point| camera.project(&(camera_from_body * point)).expect("in front of the camera"))
            .collect(),
    )
}

fn shapes() -> impl Strategy<Value = Shape> {
    let side = || 0.005..0.05f64;
    prop_oneof![
        (side(), side(), side()).prop_map(|(x, y, z)| cuboid(x, y, z)),
        (side(), side()).prop_map(|(radius, half_height)| Shape::Cylinder { radius, half_height }),
        side().prop_map(|radius| Shape::Sphere { radius }),
    ]
}

proptest! {
    #![proptest_config(cases(32))]

    #[test]
    fn a_pixel_is_as_bright_as_the_share_of_it_that_the_body_covers(
        shape in shapes(),
        turn in prop::array::uniform3(-3.0..3.0f64),
        eye in (-0.1..0.1f64, -0.1..0.1f64, 0.2..0.4f64),
    ) {
        let (camera, scene) = (camera(160, 120), alone(body(shape, [0.0; 3], turn, WHITE)));
        let pose = looking(eye.into(), [0.01, 0.0, 0.0]);
        let image = Renderer::new(camera.clone()).color(&scene, &pose);
        let outline = outline(&scene.target, &pose, &camera);
        for (u, v, pixel) in image.enumerate_pixels() {
            let expected = 255.0 * coverage(&outline, f64::from(u), f64::from(v));
            // Rounding contributes half a step; a curved outline may contribute another half.
            let tolerance = if matches!(shape, Shape::Cuboid { .. }) { 0.501 } else { 1.0 };
            let difference = (f64::from(pixel[0]) - expected).abs();
            prop_assert!(difference < tolerance, "({u}, {v}) is {} instead of {expected}", pixel[0]);
        }
    }

    #[test]
    fn no_view_is_too_close(eye in (0.25..0.48f64, 0.05..0.3f64, -0.03..0.12f64), to in views()) {
        let (camera, scene) = (camera(48, 36), busy_scene());
        let pose = Isometry3::from_parts(Point3::from(<[f64; 3]>::from(eye)).coords.into(), to.rotation);
        let frame = Renderer::new(camera.clone()).frame(&scene, &pose);
        for (i, &instance) in frame.instance.iter().enumerate() {
            let pixel = Point2::new((i % 48) as f64 + 0.5, (i / 48) as f64 + 0.5);
            prop_assert_eq!(instance, cast(&scene, &pose, &camera.ray(&pixel)).instance, "pixel {}", pixel);
        }
        let (mean, _) = compare(&camera, &scene, &pose, 4);
        prop_assert!(mean < 2.0, "mean {mean}");
    }
}

#[test]
fn a_tenth_of_a_pixel_moves_the_image_by_a_tenth_of_a_pixel() {
    for shape in [cuboid(0.03, 0.02, 0.02), Shape::Cylinder { radius: 0.02, half_height: 0.03 }] {
        let scene = alone(body(shape, [0.0; 3], [0.2, 0.1, 0.9], WHITE));
        let pose = looking([0.02, -0.05, 0.3], [0.0; 3]);
        let centroid = |shift: f64| {
            let mut camera = camera(128, 96);
            camera.center += nalgebra::Vector2::new(shift, 2.0 * shift);
            let image = Renderer::new(camera).color(&scene, &pose);
            let (mut sum, mut moment) = (0.0, nalgebra::Vector2::zeros());
            for (u, v, pixel) in image.enumerate_pixels() {
                sum += f64::from(pixel[0]);
                moment += nalgebra::Vector2::new(f64::from(u), f64::from(v)) * f64::from(pixel[0]);
            }
            moment / sum
        };
        for step in 1..=10 {
            let shift = 0.1 * f64::from(step);
            let moved = centroid(shift) - centroid(0.0);
            assert!((moved - nalgebra::Vector2::new(shift, 2.0 * shift)).norm() < 2e-3, "{shape:?}: {moved}");
        }
    }
}

/// Returns the sum of the changes in the first channel, and of their magnitudes, when the image plane is shifted, in units of
/// full scale.
fn change(scene: &Scene, pose: &Isometry3<f64>, camera: &Camera, shift: nalgebra::Vector2<f64>) -> [f64; 2] {
    let mut shifted = camera.clone();
    shifted.center += shift;
    let [before, after] = [camera, &shifted].map(|c| Renderer::new(c.clone()).color(scene, pose));
    let pairs = before.pixels().zip(after.pixels());
    let changes = pairs.map(|(before, after)| (f64::from(after[0]) - f64::from(before[0])) / 255.0);
    changes.fold([0.0; 2], |[sum, magnitudes], c| [sum + c, magnitudes + c.abs()])
}

#[test]
fn an_edge_moved_by_a_tenth_of_a_pixel_changes_the_image_by_a_tenth_of_its_length() {
    let contrast = 0.8;
    // Seen from above, an edge or an outline along the robot's y axis passes near the middle of the image. The other is out of
    // sight.
    let block = body(cuboid(1.0, 2.0, 0.1), [-1.0, 0.0, -0.5], [0.0; 3], [0.1 + contrast; 3]);
    let lying = [std::f64::consts::FRAC_PI_2, 0.0, 0.0];
    let log = Shape::Cylinder { radius: 1.0, half_height: 2.0 };
    for body in [block, body(log, [-1.0, 0.0, -1.0], lying, [0.1 + contrast; 3])] {
        let mut scene = alone(body);
        scene.background = [0.1; 3];
        for i in 0..40 {
            // Up to 0.35 rad from the columns of the image, the edge does not reach the left or right border.
            let (angle, phase) = (0.05 * f64::from(i % 8), (0.173 * f64::from(i)).fract());
            let mut camera = camera(128, 96);
            camera.center += nalgebra::Vector2::new(phase, 0.0);
            let down = UnitQuaternion::face_towards(&-Vector3::z(), &Vector3::y());
            let roll = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), angle);
            let pose = Isometry3::from_parts(Vector3::new(-0.02, 0.0, 1.0).into(), down * roll);
            let along = pose.inverse_transform_vector(&Vector3::y()).xy();
            let length = 96.0 / along.y.abs();
            for share in [0.1, -0.1] {
                let shift = nalgebra::Vector2::new(-along.y, along.x) * share;
                let [sum, magnitudes] = change(&scene, &pose, &camera, shift);
                let moved = sum.abs() / (contrast * length);
                // An edge along the columns has the same rounding error in all rows: half a byte value before and after, in one
                // or two columns.
                let tolerance = if angle == 0.0 { 2.0 / (255.0 * contrast) } else { 0.001 };
                assert!((moved - 0.1).abs() < tolerance, "{scene:?}, {angle}, {phase}: {moved}");
                assert!(magnitudes - sum.abs() < 1e-9, "{scene:?}, {angle}, {phase}: there and back");
            }
        }
    }
}

#[test]
fn a_disk_moved_by_a_tenth_of_a_pixel_changes_the_image_by_a_tenth_of_its_width_on_either_side() {
    let scenes = [
        (Shape::Sphere { radius: 0.1 }, 0.1 / (0.25f64 - 0.01).sqrt()),
        (Shape::Cylinder { radius: 0.1, half_height: 0.05 }, 0.1 / 0.45),
    ];
    for (shape, slope) in scenes {
        let scene = alone(body(shape, [0.0; 3], [0.0; 3], WHITE));
        let down = UnitQuaternion::face_towards(&-Vector3::z(), &Vector3::y());
        let pose = Isometry3::from_parts(Vector3::new(0.0, 0.0, 0.5).into(), down);
        for i in 0..20 {
            let mut camera = camera(128, 96);
            camera.center += nalgebra::Vector2::new(0.173, 0.377) * f64::from(i);
            let (sin, cos) = (0.31 * f64::from(i)).sin_cos();
            let [sum, magnitudes] = change(&scene, &pose, &camera, nalgebra::Vector2::new(cos, sin) * 0.1);
            let moved = magnitudes / (4.0 * slope * camera.focal);
            assert!((moved - 0.1).abs() < 0.001, "{shape:?}: {moved}");
            assert!(sum.abs() < 0.2, "{shape:?}: the area stays, {sum}");
        }
    }
}

// ---- Textures ----

proptest! {
    #![proptest_config(cases(4))]

    // The patterns are coarse enough for these pixels to remain unfiltered, except where a surface is seen nearly edge-on.
    #[test]
    fn an_image_of_textures_is_what_rays_see(pose in views()) {
        let scene = textured(busy_scene(), [0.3, 0.2, 0.4], 0.9);
        let (mean, greatest) = compare(&camera(64, 48), &scene, &pose, 12);
        prop_assert!(mean < 0.5, "mean {mean}");
        prop_assert!(greatest < 20.0, "greatest {greatest}");
    }
}

/// Two cameras that see all bodies of the busy scene, from the side and from above.
fn two_poses() -> [Isometry3<f64>; 2] {
    [looking([0.45, 0.0, 0.25], [0.36, 0.18, 0.0]), looking([0.33, 0.22, 0.32], [0.36, 0.18, 0.0])]
}

/// Interpolates the color at an image point between pixel centers.
fn interpolated(image: &image::RgbImage, at: &Point2<f64>) -> Vector3<f64> {
    let (u, v) = (at.x - 0.5, at.y - 0.5);
    let pixel = |x: f64, y: f64| Vector3::from(image.get_pixel(x as u32, y as u32).0.map(f64::from));
    let row = |y: f64| pixel(u.floor(), y).lerp(&pixel(u.floor() + 1.0, y), u.fract());
    row(v.floor()).lerp(&row(v.floor() + 1.0), v.fract())
}

#[test]
fn two_cameras_see_the_same_pattern() {
    let mut scene = textured(busy_scene(), [0.03, 0.02, 0.025], 0.8);
    scene.light.ambient = 1.0;
    let camera = camera(640, 480);
    let renderer = Renderer::new(camera.clone());
    let frames = two_poses().map(|pose| (renderer.frame(&scene, &pose), pose));
    let mut compared = [0; 6];
    for i in 0..60_000_u32 {
        // A pixel in the first image, the point that it shows, and the projection of that point into the second image.
        let (u, v) = (4 + i * 7 % 632, 4 + i * 13 % 472);
        let ([first, second], here) = (&frames, Point2::new(f64::from(u) + 0.5, f64::from(v) + 0.5));
        let index = |u: u32, v: u32| (v * 640 + u) as usize;
        let depth = f64::from(first.0.depth[index(u, v)]);
        let point = first.1 * Point3::from(camera.ray(&here) * depth);
        let in_second = second.1.inverse_transform_point(&point);
        let Some(there) = camera.project(&in_second) else { continue };
        if !(4.0..636.0).contains(&there.x) || !(4.0..476.0).contains(&there.y) || depth.is_infinite() {
            continue;
        }
        // Both cameras see this point, surrounded only by the same surface. Bodies with a cross are excluded because of its
        // borders.
        let instance = first.0.instance[index(u, v)];
        let is_within = |frame: &world::Frame, at: &Point2<f64>| {
            (-2..=2).all(|d| {
                let [x, y] = [at.x as i32, at.y as i32];
                [(x + d, y), (x, y + d)]
                    .into_iter()
                    .all(|(x, y)| frame.instance[index(x as u32, y as u32)] == instance)
            })
        };
        let seen = f64::from(second.0.depth[index(there.x as u32, there.y as u32)]);
        let is_plain = scene
            .bodies()
            .nth(usize::from(instance).wrapping_sub(1))
            .is_none_or(|body| body.material.cross.is_none());
        if is_plain
            && (seen - in_second.z).abs() < 2e-3
            && is_within(&first.0, &here)
            && is_within(&second.0, &there)
        {
            let apart = (interpolated(&first.0.color, &here) - interpolated(&second.0.color, &there)).amax();
            assert!(apart < 10.0, "{apart} at {point} of {instance}");
            compared[usize::from(instance)] += 1;
        }
    }
    assert!([0, 3, 5].iter().all(|&i| compared[i] > 100), "{compared:?}");
}

#[test]
fn a_texture_moves_no_edge() {
    for pose in two_poses() {
        // Only the background is blue: blue shows in proportion to the uncovered area.
        let mut scene = busy_scene();
        scene.table.color = [0.6, 0.4, 0.0];
        scene.background = [0.0, 0.0, 1.0];
        scene.target.material.color = [0.9, 0.9, 0.0];
        for body in &mut scene.obstacles {
            body.material.color = [0.4, 0.4, 0.0];
        }
        for body in std::iter::once(&mut scene.target).chain(&mut scene.obstacles) {
            body.material.cross = None;
        }
        scene.table.half_size = [0.06, 0.06];
        let renderer = Renderer::new(camera(320, 240));
        let (plain, dyed) =
            (renderer.frame(&scene, &pose), renderer.frame(&textured(scene, [0.01; 3], 1.0), &pose));
        assert_eq!((plain.instance, plain.depth), (dyed.instance, dyed.depth));
        let mut partly = 0;
        for (plain, dyed) in plain.color.pixels().zip(dyed.color.pixels()) {
            assert!(plain[2] == dyed[2], "{plain:?} and {dyed:?}");
            partly += u32::from(0 < plain[2] && plain[2] < 255);
        }
        assert!(partly > 200);
        assert_ne!(plain.color, dyed.color);
    }
}

#[test]
fn a_texture_far_finer_than_a_pixel_is_its_mean() {
    let renderer = Renderer::new(camera(160, 120));
    for pose in two_poses() {
        let plain = renderer.color(&busy_scene(), &pose);
        let greatest = |grain: f64| {
            let dyed = renderer.color(&textured(busy_scene(), [grain; 3], 1.0), &pose);
            dyed.iter().zip(plain.iter()).map(|(dyed, plain)| dyed.abs_diff(*plain)).max()
        };
        // Colors of partly covered pixels are added in a different order, which may change the rounding.
        assert!(greatest(2e-4) <= Some(1) && greatest(1e-9) <= Some(1));
        assert!(greatest(2e-2) > Some(6));
    }
}

#[test]
fn contrast_leaves_the_mean() {
    let renderer = Renderer::new(camera(320, 240));
    let pose = looking([0.4, 0.18, 0.15], [0.4, 0.18, 0.0]);
    let mean = |grain: f64, contrast: f64| {
        let mut scene =
            textured(alone(body(cuboid(1e-3, 1e-3, 1e-3), [9.0; 3], [0.0; 3], WHITE)), [grain; 3], contrast);
        scene.table = Table { color: [0.5; 3], ..busy_scene().table };
        scene.table.texture = textured(busy_scene(), [grain; 3], contrast).table.texture;
        let image = renderer.color(&scene, &pose);
        image.iter().map(|byte| f64::from(*byte)).sum::<f64>() / image.len() as f64
    };
    // From grains of a few dozen pixels to grains of one or two.
    for grain in [0.01, 0.004, 0.002, 0.001] {
        let (flat, dyed) = (mean(grain, 0.0), mean(grain, 0.9));
        assert!((dyed / flat - 1.0).abs() < 0.03, "{dyed} instead of {flat} at {grain}");
    }
}

#[test]
fn a_textured_image_is_the_same_on_every_machine() {
    let scene = textured(busy_scene(), [0.02, 0.004, 0.01], 0.5);
    let mut image = Renderer::new(camera(160, 120)).color(&scene, &two_poses()[0]);
    Sensor { blur: 0.7, noise: 0.01 }.expose(&mut image, 5);
    // FNV-1a.
    let digest = image.iter().fold(0xcbf2_9ce4_8422_2325_u64, |digest, &byte| {
        (digest ^ u64::from(byte)).wrapping_mul(0x100_0000_01b3)
    });
    assert_eq!(digest, 3_083_197_819_151_740_288, "{digest}");
}

/// A regression test: an outline that left the image sideways was missed if none of the three lines of a cell crossed it.
#[test]
fn an_outline_is_cut_at_the_border_of_the_image() {
    let (camera, beside) = (camera(80, 60), 160);
    let mut wide = camera.clone();
    wide.width += 2 * beside;
    wide.center.x += f64::from(beside);
    for i in 0..300_u32 {
        let turn = f64::from(i);
        let to = [0.36 + 0.06 * (1.7 * turn).sin(), 0.18 + 0.06 * (2.3 * turn).cos(), 0.0];
        let eye = [0.36 + 0.1 * turn.sin(), 0.18 + 0.1 * turn.cos(), 0.12 + 0.001 * f64::from(i % 97)];
        let [image, whole] =
            [&camera, &wide].map(|c| Renderer::new(c.clone()).color(&busy_scene(), &looking(eye, to)));
        for (u, v, pixel) in image.enumerate_pixels() {
            let others = whole.get_pixel(u + beside, v).0;
            let difference = pixel.0.into_iter().zip(others).map(|(a, b)| a.abs_diff(b)).max();
            // The cells differ, and so do the places where the brightness of a lateral surface is sampled near its outline.
            assert!(
                difference <= Some(12),
                "view {i}, pixel {u} {v}: {:?}, {others:?} in a wider image",
                pixel.0
            );
        }
    }
}

#[test]
fn intersecting_bodies_meet_in_a_line() {
    let mut scene = busy_scene();
    scene.obstacles.push(body(cuboid(0.02, 0.02, 0.06), [0.33, 0.16, 0.0], [0.5, 0.2, 0.1], [0.1, 0.7, 0.3]));
    scene.obstacles.push(body(
        Shape::Cylinder { radius: 0.015, half_height: 0.08 },
        [0.36, 0.2, 0.0],
        [0.9, 0.5, 0.0],
        [0.2, 0.4, 0.9],
    ));
    for eye in [[0.5, 0.0, 0.25], [0.1, 0.2, 0.2], [0.36, 0.18, 0.35]] {
        let pose = looking(eye, [0.35, 0.18, 0.0]);
        let (mean, greatest) = compare(&camera(96, 72), &scene, &pose, 16);
        assert!(mean < 0.4 && greatest < 16.0, "mean {mean}, greatest {greatest}");
    }
}
