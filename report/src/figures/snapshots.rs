//! Figure 7: one session in four snapshots from an onlooker's view, and in images of the hand camera.

use super::onlooker::Onlooker;
use crate::drawing::figure::{Figure, WIDTH, row};
use crate::drawing::svg::{Svg, TextStyle};
use datagen::Result;
use eval::session::deflect::DeflectionKind;
use eval::{Outcome, SessionRecord};
use world::Environment;

/// Returns the session to show: of the converged sessions with obstacles, the one with the most deflected steps. If there is
/// none, returns the first session.
pub fn example(records: &[SessionRecord]) -> Option<&SessionRecord> {
    records
        .iter()
        .filter(|record| record.outcome == Outcome::Converged && !record.scene.obstacles.is_empty())
        // Selects the first of equals: `max_by_key` returns the last one.
        .rev()
        .max_by_key(|record| deflected_steps(record))
        .or(records.first())
}

/// Returns the number of steps whose direction was changed.
fn deflected_steps(record: &SessionRecord) -> usize {
    record.steps.iter().filter(|step| step.deflection != DeflectionKind::Kept).count()
}

/// Draws snapshots at the start, at two thirds and one third of the initial distance, and at the end. Below them are the
/// initial, goal and final image.
pub fn figure_7(environment: &Environment, record: &SessionRecord) -> Result<Figure> {
    const LABEL: f64 = 26.0;
    let camera = &environment.camera;
    let upper = row(4, LABEL, 4.0 / 3.0);
    let lower =
        row(3, LABEL + upper[0].height + LABEL + 14.0, f64::from(camera.width) / f64::from(camera.height));
    let mut svg = Svg::new(WIDTH, lower[0].y + lower[0].height, "Snapshots of a servo session");
    let onlooker = Onlooker::new(&record.scene.target_center(), 480);
    for ((i, area), step) in upper.iter().enumerate().zip(thirds(record)) {
        let joints = step.checked_sub(1).map_or(&record.start_joints, |k| &record.steps[k].joints);
        let heading =
            format!("({}) {}", i + 1, if step == 0 { "start".into() } else { format!("iteration {step}") });
        svg.text([area.x + area.width / 2.0, area.y - 8.0], &heading, &TextStyle::LABEL);
        svg.image(area, &onlooker.view(environment, &record.scene, joints))?;
    }
    let poses = [
        ("initial image", &record.robot_from_start),
        ("goal image", &record.robot_from_goal),
        ("final image", &record.robot_from_final),
    ];
    for (area, (heading, robot_from_hand)) in lower.iter().zip(poses) {
        svg.text([area.x + area.width / 2.0, area.y - 8.0], heading, &TextStyle::LABEL);
        svg.image(area, &environment.wrist_image(&record.scene, robot_from_hand))?;
    }
    let caption = format!(
        "An example of visual servoing: session {} of the evaluation, with {} on the table and {} of {} steps deflected. Above: \
         an onlooker's view at the start, at two thirds and one third of the initial distance, and at the end. The hand is \
         blue, and the arm is drawn as simple solids. Below: the initial image of the hand camera, the goal image, and the \
         final image. The paper shows the full robot model of Gazebo.",
        record.index,
        match record.scene.obstacles.len() {
            1 => "one obstacle".into(),
            n => format!("{n} obstacles"),
        },
        deflected_steps(record),
        record.steps.len()
    );
    Ok(Figure { label: "Figure 7".into(), svg: svg.finish(), caption })
}

/// Returns the numbers of steps after which all, two thirds, one third and none of the distance to the final position remain.
fn thirds(record: &SessionRecord) -> [usize; 4] {
    let end = record.robot_from_final.translation.vector;
    let whole = (record.robot_from_start.translation.vector - end).norm();
    let left: Vec<f64> =
        record.steps.iter().map(|s| (s.robot_from_hand.translation.vector - end).norm()).collect();
    let last = left.len();
    let after = |share: f64| left.iter().position(|&way| way <= share * whole).map_or(last, |k| k + 1);
    [0, after(2.0 / 3.0), after(1.0 / 3.0), last]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::drawing::markup::tests::assert_balanced;
    use crate::fixture::{environment, sessions};
    use nalgebra::Translation3;

    #[test]
    fn snapshots_are_at_thirds_of_the_distance() {
        let mut record = sessions(1).swap_remove(0);
        // The distance shrinks by the factor 0.7 per step: 0.49 of it is left after two steps, 0.24 after four.
        let end = record.robot_from_final.translation.vector;
        let away = record.robot_from_start.translation.vector - end;
        let last = record.steps.len();
        for (k, step) in record.steps.iter_mut().take(last - 1).enumerate() {
            let left = 0.7f64.powi(i32::try_from(k).unwrap() + 1);
            step.robot_from_hand.translation = Translation3::from(end + away * left);
        }
        assert_eq!(thirds(&record), [0, 2, 4, last]);
    }

    #[test]
    fn the_example_is_the_session_with_the_most_deflected_steps() {
        let mut records = sessions(4);
        for step in records.iter_mut().flat_map(|record| &mut record.steps) {
            step.deflection = DeflectionKind::Kept;
        }
        records[2].steps[0].deflection = DeflectionKind::Turned;
        assert_eq!(example(&records).map(|r| r.index), Some(2));
        records[2].outcome = Outcome::Collided;
        assert_ne!(example(&records).map(|r| r.index), Some(2));
        assert!(example(&[]).is_none());
    }

    #[test]
    fn seven_images_are_embedded() {
        let figure = figure_7(&environment(), &sessions(1)[0]).unwrap();
        assert_balanced(&figure.svg);
        assert_eq!(figure.svg.matches("data:image/png;base64,").count(), 7);
    }
}
