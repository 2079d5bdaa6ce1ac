//! Figure 9: final poses of sessions, from an onlooker's view and from the hand camera.

use super::onlooker::Onlooker;
use crate::drawing::figure::{Figure, WIDTH, row};
use crate::drawing::svg::{Svg, TextStyle};
use datagen::Result;
use eval::SessionRecord;
use world::Environment;
use world::units::{to_deg, to_mm};

/// Draws one column per session, with the onlooker's view above and the hand camera's image below. Five sessions fit well.
pub fn figure_9(environment: &Environment, records: &[SessionRecord]) -> Result<Figure> {
    const LABEL: f64 = 24.0;
    let camera = &environment.camera;
    let count = records.len().max(1);
    let upper = row(count, LABEL, 4.0 / 3.0);
    let lower = row(count, LABEL + upper[0].height + 8.0, f64::from(camera.width) / f64::from(camera.height));
    let bottom = lower[0].y + lower[0].height;
    let mut svg = Svg::new(WIDTH, bottom + LABEL, "Final poses of servo sessions");
    for ((record, above), below) in records.iter().zip(&upper).zip(&lower) {
        let onlooker = Onlooker::new(&record.scene.target_center(), 400);
        let joints = record.steps.last().map_or(&record.start_joints, |step| &step.joints);
        let middle = above.x + above.width / 2.0;
        svg.text([middle, above.y - 8.0], &format!("session {}", record.index), &TextStyle::LABEL);
        svg.image(above, &onlooker.view(environment, &record.scene, joints))?;
        svg.image(below, &environment.wrist_image(&record.scene, &record.robot_from_final))?;
        let error =
            format!("{:.2} mm, {:.2}°", to_mm(record.position_error), to_deg(record.orientation_error));
        svg.text([middle, bottom + 18.0], &error, &TextStyle::TICK);
    }
    let caption = "Final poses of the first sessions of the evaluation, not selected by result. Above: an onlooker's view. Below: the \
                   image of the hand camera, with the final position and orientation error. The paper shows a selection \
                   without errors.";
    Ok(Figure { label: "Figure 9".into(), svg: svg.finish(), caption: caption.into() })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::drawing::markup::tests::assert_balanced;
    use crate::fixture::{environment, sessions};

    #[test]
    fn every_session_has_two_images_and_its_error() {
        let records = sessions(3);
        let figure = figure_9(&environment(), &records).unwrap();
        assert_balanced(&figure.svg);
        assert_eq!(figure.svg.matches("data:image/png;base64,").count(), 6);
        for record in &records {
            assert!(figure.svg.contains(&format!("session {}", record.index)));
            assert!(figure.svg.contains(&format!("{:.2} mm", to_mm(record.position_error))));
        }
    }
}
