//! Compatibility of cameras: a network accepts any resolution, but only the view it was trained for.

use world::config::CameraConfig;

/// Returns the first property other than the resolution in which two cameras differ, with both values.
pub(crate) fn difference(a: &CameraConfig, b: &CameraConfig) -> Option<(&'static str, f64, f64)> {
    let aspect = |camera: &CameraConfig| f64::from(camera.width) / f64::from(camera.height);
    let properties = [
        ("horizontal_fov_deg", a.horizontal_fov_deg, b.horizontal_fov_deg),
        ("behind_hand_mm", a.behind_hand_mm, b.behind_hand_mm),
        ("width / height", aspect(a), aspect(b)),
    ];
    properties.into_iter().find(|(_, a, b)| (a - b).abs() > 1e-9)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn resolution_does_not_matter_but_the_view_does() {
        let vga = CameraConfig { width: 640, height: 480, horizontal_fov_deg: 60.0, behind_hand_mm: 100.0 };
        assert_eq!(difference(&vga, &CameraConfig { width: 128, height: 96, ..vga.clone() }), None);
        let wide = CameraConfig { horizontal_fov_deg: 70.0, ..vga.clone() };
        assert_eq!(difference(&vga, &wide), Some(("horizontal_fov_deg", 60.0, 70.0)));
        let square = CameraConfig { height: 640, ..vga.clone() };
        assert_eq!(difference(&vga, &square).map(|d| d.0), Some("width / height"));
        let near = CameraConfig { behind_hand_mm: 50.0, ..vga.clone() };
        assert_eq!(difference(&vga, &near), Some(("behind_hand_mm", 100.0, 50.0)));
    }
}
