//! Figure 7: one session in four snapshots from an onlooker's view, and in the hand camera's images.

use super::{Figure, WIDTH, row};
use crate::deflect::Course;
use crate::error::Result;
use crate::figures::onlooker::Onlooker;
use crate::svg::{Svg, TextStyle};
use crate::trace::{Outcome, SessionRecord};
use world::environment::Environment;

/// The session to show: the converged one with obstacles that was deflected in most steps, or the first one.
pub fn example(records: &[SessionRecord]) -> Option<&SessionRecord> {
    let turned =
        |record: &SessionRecord| record.steps.iter().filter(|step| step.course != Course::Kept).count();
    records
        .iter()
        .filter(|record| record.outcome == Outcome::Converged && !record.scene.obstacles.is_empty())
        // The first of equals: max_by_key alone would take the last.
        .rev()
        .max_by_key(|record| turned(record))
        .or(records.first())
}

/// Snapshots at the start, when two thirds and one third of the distance are left, and at the end; below, the initial, goal
/// and final image.
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
    let turned = record.steps.iter().filter(|step| step.course != Course::Kept).count();
    let caption = format!(
        "An example of visual servoing: session {} of the evaluation, {} on the table, {turned} of {} steps deflected. Above, \
         an onlooker in front of the robot sees the start, two thirds and one third of the distance left, and the end, with the \
         hand in blue and the arm as plain solids; below, the initial image of the hand camera, the goal image, and the image at the end. The paper shows \
         Gazebo's full robot model.",
        record.index,
        match record.scene.obstacles.len() {
            1 => "one obstacle".into(),
            n => format!("{n} obstacles"),
        },
        record.steps.len()
    );
    Ok(Figure { label: "Figure 7".into(), svg: svg.finish(), caption })
}

/// Numbers of steps after which all, two thirds, one third and nothing is left of the distance to the final position.
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
    use crate::fixture::{environment, session};
    use crate::svg::tests::assert_balanced;

    #[test]
    fn snapshots_stand_at_thirds_of_the_way() {
        // The fixture's distance shrinks by the factor 0.7 a step: 0.49 after two steps, 0.24 after four.
        assert_eq!(thirds(&session(0)), [0, 2, 4, 12]);
    }

    #[test]
    fn the_example_is_the_session_that_was_deflected_most() {
        let mut records: Vec<SessionRecord> = (0..4).map(session).collect();
        records[2].steps[0].course = Course::Turned;
        assert_eq!(example(&records).map(|r| r.index), Some(2));
        records[2].outcome = Outcome::Collided;
        assert_ne!(example(&records).map(|r| r.index), Some(2));
        assert!(example(&[]).is_none());
    }

    #[test]
    fn seven_images_are_embedded() {
        let figure = figure_7(&environment(), &session(1)).unwrap();
        assert_balanced(&figure.svg);
        assert_eq!(figure.svg.matches("data:image/png;base64,").count(), 7);
    }
}
