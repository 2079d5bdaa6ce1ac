//! Training curves: loss and validation error over the epochs.

use crate::drawing::chart::{Chart, Scale, Series, draw_legend};
use crate::drawing::figure::{Figure, GAP, WIDTH};
use crate::drawing::svg::{Area, MUTED, PALETTE, Svg};

/// Validation of one epoch.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Epoch {
    /// Number of the epoch.
    pub epoch: usize,
    /// Loss over the validation examples.
    pub validation_loss: f64,
    /// Mean position error over the validation examples; `None` for a network that does not predict motions.
    pub position_error_mm: Option<f64>,
    /// Mean orientation error over the validation examples; `None` like the position error.
    pub orientation_error_deg: Option<f64>,
}

/// Training history of a network.
#[derive(Debug, Clone, PartialEq)]
pub struct TrainingCurve {
    /// Name of the network.
    pub name: String,
    /// Its epochs in order.
    pub epochs: Vec<Epoch>,
    /// Training loss: mean of successive groups of batches, at the fractional epoch at which the group ends.
    pub losses: Vec<[f64; 2]>,
}

/// Draws a panel of the loss and, for networks that predict motions, panels of position and orientation error on the validation
/// examples.
pub fn training_curves(label: &str, curves: &[TrainingCurve]) -> Figure {
    const TOP: f64 = 34.0;
    let epochs = curves.iter().map(|curve| curve.epochs.len()).max().unwrap_or(0);
    let loss = lines(curves, |e| Some(e.validation_loss));
    let mut panels = vec![chart("Loss", [training_losses(curves), loss].concat(), epochs)];
    for (heading, value) in [
        ("Position error [mm]", (|e| e.position_error_mm) as fn(&Epoch) -> Option<f64>),
        ("Orientation error [deg]", |e| e.orientation_error_deg),
    ] {
        let series = lines(curves, value);
        if series.iter().any(|s| !s.points.is_empty()) {
            panels.push(chart(heading, series, epochs));
        }
    }
    let height = TOP + 300.0;
    let mut svg = Svg::new(WIDTH, height, "Training curves");
    draw_legend(&mut svg, [4.0, 20.0], &legend(curves));
    let width = (WIDTH - GAP * (panels.len() as f64 - 1.0)) / panels.len() as f64;
    for (i, panel) in panels.iter().enumerate() {
        panel.draw(&mut svg, &Area { x: i as f64 * (width + GAP), y: TOP, width, height: height - TOP });
    }
    let names: Vec<&str> = curves.iter().map(|c| c.name.as_str()).collect();
    let caption = format!(
        "Training of {}. Loss: mean squared error of the network's output, solid for the validation examples, dashed for the \
         training examples. Errors: means over the validation examples. Dots: the epoch with the lowest validation loss, \
         whose weights are used. Vertical axes are logarithmic. The paper shows no training curves.",
        names.join(", ")
    );
    Figure { label: label.into(), svg: svg.finish(), caption }
}

fn chart(heading: &str, series: Vec<Series>, epochs: usize) -> Chart {
    Chart {
        heading: heading.into(),
        x_label: "epoch".into(),
        x_range: Some([0.0, epochs as f64]),
        scale: Scale::Logarithmic,
        series,
    }
}

/// Returns a line per curve and a dot at its best epoch, without names. A curve has the same color in all panels.
fn lines(curves: &[TrainingCurve], value: fn(&Epoch) -> Option<f64>) -> Vec<Series> {
    let point = |e: &Epoch| value(e).map(|v| [e.epoch as f64, v]);
    let line = |(i, curve): (usize, &TrainingCurve)| {
        let best = curve.epochs.iter().min_by(|a, b| a.validation_loss.total_cmp(&b.validation_loss));
        [
            series(i, false, curve.epochs.iter().filter_map(point).collect()),
            series(i, false, best.and_then(point).into_iter().collect()),
        ]
    };
    curves.iter().enumerate().flat_map(line).collect()
}

/// Returns the legend: colors of the networks, and styles of lines.
fn legend(curves: &[TrainingCurve]) -> Vec<Series> {
    let named = |name: &str, series: Series| Series { name: name.into(), ..series };
    let kind = |name, dashed, points| Series { name: String::from(name), color: MUTED, dashed, points };
    let networks =
        curves.iter().enumerate().map(|(i, curve)| named(&curve.name, series(i, false, Vec::new())));
    let kinds = [
        kind("validation", false, Vec::new()),
        kind("training", true, Vec::new()),
        kind("best epoch", false, vec![[0.0; 2]]),
    ];
    networks.chain(kinds).collect()
}

fn training_losses(curves: &[TrainingCurve]) -> Vec<Series> {
    curves.iter().enumerate().map(|(i, curve)| series(i, true, curve.losses.clone())).collect()
}

fn series(curve: usize, dashed: bool, points: Vec<[f64; 2]>) -> Series {
    Series { name: String::new(), color: PALETTE[curve % PALETTE.len()], dashed, points }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::drawing::markup::tests::assert_balanced;

    fn curve(position_error_mm: Option<f64>) -> TrainingCurve {
        let epoch = |epoch| Epoch {
            epoch,
            validation_loss: 1.2 / epoch as f64,
            position_error_mm,
            orientation_error_deg: position_error_mm,
        };
        TrainingCurve {
            name: "a <net>".into(),
            epochs: (1..=5).map(epoch).collect(),
            losses: vec![[0.5, 2.0], [1.0, 1.0]],
        }
    }

    #[test]
    fn a_network_without_motions_has_one_panel() {
        let with = training_curves("Figure 3", &[curve(Some(4.0))]);
        let without = training_curves("Figure 3", &[curve(None)]);
        assert_eq!(with.svg.matches(">epoch<").count(), 3);
        assert_eq!(without.svg.matches(">epoch<").count(), 1);
        assert_balanced(&with.svg);
        assert!(with.svg.contains("a &lt;net&gt;"));
        // One dot in the legend and one per panel, at the last epoch, which has the lowest loss.
        assert_eq!(with.svg.matches("<circle").count(), 1 + 3);
    }
}
