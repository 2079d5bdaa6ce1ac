//! Figure 8: pose error over the iterations of one session.

use crate::drawing::chart::{Chart, Scale, Series};
use crate::drawing::figure::{Figure, GAP, WIDTH};
use crate::drawing::svg::{Area, PALETTE, Svg};
use eval::SessionRecord;
use eval::results::published::proposed_method;
use world::LabelForm;
use world::units::{to_deg, to_mm};

/// Draws two panels with the signed errors of `x y z` and of `φ θ ψ`, from the start to the last step.
pub fn figure_8(record: &SessionRecord) -> Figure {
    let errors: Vec<[f64; 6]> = std::iter::once(&record.robot_from_start)
        .chain(record.steps.iter().map(|step| &step.robot_from_hand))
        .map(|hand| LabelForm::Difference.label(&record.robot_from_goal, hand).to_array())
        .collect();
    let panel = |heading: &str, names: [&str; 3], first: usize, unit: fn(f64) -> f64| Chart {
        heading: heading.into(),
        x_label: "iteration".into(),
        x_range: None,
        scale: Scale::Linear,
        series: (0..3)
            .map(|i| Series {
                name: names[i].into(),
                color: PALETTE[i],
                dashed: false,
                points: errors.iter().enumerate().map(|(k, e)| [k as f64, unit(e[first + i])]).collect(),
            })
            .collect(),
    };
    let (height, width) = (350.0, (WIDTH - GAP) / 2.0);
    let mut svg = Svg::new(WIDTH, height, "Position and orientation error over the iterations");
    let left = Area { x: 0.0, y: 0.0, width, height };
    panel("Position error [mm]", ["x", "y", "z"], 0, to_mm).draw(&mut svg, &left);
    let right = Area { x: width + GAP, ..left };
    panel("Orientation error [deg]", ["φ", "θ", "ψ"], 3, to_deg).draw(&mut svg, &right);
    let iterations =
        proposed_method().iterations.map_or_else(String::new, |n| format!(" in about {n:.0} iterations"));
    let caption = format!(
        "Pose error of the end effector in the session of Figure 7: pose minus goal pose in the robot frame. The session \
         ended after {} iterations, {:.2} mm and {:.2} degrees from the goal. The paper plots the pose of its example, which \
         became stable{iterations}.",
        record.steps.len(),
        to_mm(record.position_error),
        to_deg(record.orientation_error)
    );
    Figure { label: "Figure 8".into(), svg: svg.finish(), caption }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::drawing::markup::tests::assert_balanced;
    use crate::fixture::sessions;

    #[test]
    fn every_axis_has_a_line_from_the_start_to_the_last_step() {
        let record = &sessions(1)[0];
        let figure = figure_8(record);
        assert_balanced(&figure.svg);
        let long = |line: &str| {
            line.split("points=\"").nth(1).map_or(0, |p| p.split('"').next().unwrap().split(' ').count())
        };
        let curves = figure.svg.lines().filter(|line| long(line) == record.steps.len() + 1).count();
        assert_eq!(curves, 6);
    }
}
