//! A line chart with axes: one panel of a figure.

use super::svg::{Anchor, Area, FAINT, INK, MUTED, Stroke, Svg, TextStyle};

/// Scale of the y axis.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Scale {
    /// Linear.
    Linear,
    /// Logarithmic; values that are not positive are left out.
    Logarithmic,
}

/// One line of a chart.
#[derive(Debug, Clone, PartialEq)]
pub struct Series {
    /// Name in the legend; a series with an empty name is not listed.
    pub name: String,
    /// Color.
    pub color: &'static str,
    /// Whether it is dashed.
    pub dashed: bool,
    /// Points from left to right. Points that are not finite are left out.
    pub points: Vec<[f64; 2]>,
}

/// A chart.
#[derive(Debug, Clone, PartialEq)]
pub struct Chart {
    /// Heading: the quantity on the y axis, with its unit.
    pub heading: String,
    /// Quantity on the x axis.
    pub x_label: String,
    /// Range that the x axis covers in addition to the points.
    pub x_range: Option<[f64; 2]>,
    /// Scale of the y axis.
    pub scale: Scale,
    /// Lines.
    pub series: Vec<Series>,
}

/// Space around the plotting area: for the heading, for a legend below it, and for the numbers on both axes.
const ABOVE: f64 = 36.0;
const LEGEND: f64 = 26.0;
const BELOW: f64 = 48.0;
const LEFT: f64 = 58.0;
const RIGHT: f64 = 14.0;
/// Radius of the dot that marks a series of one point.
const MARK: f64 = 3.5;

impl Chart {
    /// Draws the chart into an area.
    pub fn draw(&self, svg: &mut Svg, area: &Area) {
        let named = self.series.iter().any(|series| !series.name.is_empty());
        let above = if named { ABOVE + LEGEND } else { ABOVE };
        let plot = Area {
            x: area.x + LEFT,
            y: area.y + above,
            width: area.width - LEFT - RIGHT,
            height: area.height - above - BELOW,
        };
        svg.text(
            [plot.x - LEFT + 4.0, area.y + 20.0],
            &self.heading,
            &TextStyle::HEADING.anchored(Anchor::Start),
        );
        draw_legend(svg, [plot.x, area.y + 46.0], &self.series);
        let shown: Vec<Vec<[f64; 2]>> = self.series.iter().map(|s| self.transformed(&s.points)).collect();
        let x_values = shown.iter().flatten().map(|p| p[0]).chain(self.x_range.into_iter().flatten());
        let x_axis = Axis::new(x_values, [plot.x, plot.x + plot.width], true);
        let y_range = [plot.y + plot.height, plot.y];
        let y_axis = match self.scale {
            Scale::Linear => Axis::new(shown.iter().flatten().map(|p| p[1]), y_range, false),
            Scale::Logarithmic => Axis::of_logarithms(shown.iter().flatten().map(|p| p[1]), y_range),
        };
        draw_axes(svg, &plot, &x_axis, &y_axis);
        let middle = plot.x + plot.width / 2.0;
        svg.text([middle, plot.y + plot.height + 40.0], &self.x_label, &TextStyle::LABEL);
        for (series, points) in self.series.iter().zip(&shown) {
            let points: Vec<[f64; 2]> = points.iter().map(|p| [x_axis.at(p[0]), y_axis.at(p[1])]).collect();
            svg.line(&points, &Stroke { color: series.color, width: 2.0, dashed: series.dashed });
            if let [only] = points.as_slice() {
                svg.disc(*only, MARK, series.color, series.color);
            }
        }
    }

    fn transformed(&self, points: &[[f64; 2]]) -> Vec<[f64; 2]> {
        let y = |y: f64| if self.scale == Scale::Linear { y } else { y.log10() };
        points.iter().map(|p| [p[0], y(p[1])]).filter(|p| p[0].is_finite() && p[1].is_finite()).collect()
    }
}

/// Draws the legend of the named series, side by side from a point.
pub(crate) fn draw_legend(svg: &mut Svg, [mut x, y]: [f64; 2], series: &[Series]) {
    for series in series.iter().filter(|s| !s.name.is_empty()) {
        if series.points.len() == 1 {
            svg.disc([x + 12.0, y - 5.0], MARK, series.color, series.color);
        } else {
            let stroke = Stroke { color: series.color, width: 2.5, dashed: series.dashed };
            svg.line(&[[x, y - 5.0], [x + 24.0, y - 5.0]], &stroke);
        }
        svg.text([x + 30.0, y], &series.name, &TextStyle::TICK.anchored(Anchor::Start));
        // The width of the name is an estimate.
        x += 46.0 + 7.2 * series.name.chars().count() as f64;
    }
}

fn draw_axes(svg: &mut Svg, plot: &Area, x_axis: &Axis, y_axis: &Axis) {
    let (bottom, right) = (plot.y + plot.height, plot.x + plot.width);
    for (value, label) in &y_axis.ticks {
        let y = y_axis.at(*value);
        let is_zero = label == "0";
        let stroke = Stroke { color: if is_zero { MUTED } else { FAINT }, width: 1.0, dashed: false };
        svg.line(&[[plot.x, y], [right, y]], &stroke);
        svg.text([plot.x - 8.0, y + 4.5], label, &TextStyle::TICK.anchored(Anchor::End));
    }
    for (value, label) in &x_axis.ticks {
        let x = x_axis.at(*value);
        svg.line(&[[x, bottom], [x, bottom + 5.0]], &Stroke { color: INK, width: 1.0, dashed: false });
        svg.text([x, bottom + 20.0], label, &TextStyle::TICK);
    }
    let stroke = Stroke { color: INK, width: 1.2, dashed: false };
    svg.line(&[[plot.x, plot.y], [plot.x, bottom], [right, bottom]], &stroke);
}

/// An axis of a plot.
struct Axis {
    values: [f64; 2],
    pixels: [f64; 2],
    ticks: Vec<(f64, String)>,
}

impl Axis {
    /// Creates a linear axis that covers the values. It ends at the extremes if it is tight, otherwise at ticks.
    fn new(values: impl Iterator<Item = f64>, pixels: [f64; 2], tight: bool) -> Self {
        let [low, high] = extremes(values);
        let step = tick_step(high - low);
        let (first, last) = if tight {
            ((low / step).ceil(), (high / step).floor())
        } else {
            ((low / step).floor(), (high / step).ceil())
        };
        let decimals = (-step.log10().floor()).max(0.0) as usize;
        let count = (last - first).round() as usize;
        let ticks = (0..=count)
            .map(|i| (first + i as f64) * step)
            // Adding zero turns -0 into 0.
            .map(|value| (value, format!("{:.decimals$}", (value / step).round() * step + 0.0)))
            .map(|(value, label)| if value.abs() < step / 2.0 { (0.0, "0".into()) } else { (value, label) })
            .collect();
        let values = if tight { [low, high] } else { [first * step, last * step] };
        Self { values, pixels, ticks }
    }

    /// Creates a logarithmic axis that covers the values, given as decimal logarithms. Ticks are at 1, 2 and 5 times powers of
    /// ten. A wide range has ticks at powers only, and a narrow one at more factors.
    fn of_logarithms(values: impl Iterator<Item = f64>, pixels: [f64; 2]) -> Self {
        let [low, high] = extremes(values);
        let factors: &[f64] = match high - low {
            ..0.5 => &[1.0, 1.2, 1.5, 2.0, 2.5, 3.0, 4.0, 5.0, 6.0, 8.0],
            ..2.5 => &[1.0, 2.0, 5.0],
            _ => &[1.0],
        };
        let all: Vec<(f64, String)> = (low.floor() as i32..=high.ceil() as i32)
            .flat_map(|power| factors.iter().map(move |factor| (factor, power)))
            .map(|(factor, power)| {
                let value = factor * 10f64.powi(power);
                let decimals = i32::from(factor.fract() > 0.0) - power;
                (value.log10(), format!("{value:.*}", usize::try_from(decimals).unwrap_or(0)))
            })
            .collect();
        let below = all.iter().rev().map(|t| t.0).find(|&t| t <= low).unwrap_or(low);
        let above = all.iter().map(|t| t.0).find(|&t| t >= high).unwrap_or(high);
        let ticks = all.into_iter().filter(|t| t.0 >= below && t.0 <= above).collect();
        Self { values: [below, above], pixels, ticks }
    }

    fn at(&self, value: f64) -> f64 {
        let share = (value - self.values[0]) / (self.values[1] - self.values[0]);
        self.pixels[0] + share * (self.pixels[1] - self.pixels[0])
    }
}

/// Returns the smallest and largest value, widened if they are equal. Without values, returns zero and one.
fn extremes(values: impl Iterator<Item = f64>) -> [f64; 2] {
    let [low, high] =
        values.fold([f64::INFINITY, f64::NEG_INFINITY], |[low, high], v| [low.min(v), high.max(v)]);
    if low > high {
        [0.0, 1.0]
    } else if high - low <= 1e-12 * high.abs().max(1e-6) {
        [low - 0.5, high + 0.5]
    } else {
        [low, high]
    }
}

/// Returns 1, 2 or 5 times a power of ten such that at most six steps fill the extent.
fn tick_step(extent: f64) -> f64 {
    let raw = extent / 6.0;
    let power = 10f64.powf(raw.log10().floor());
    let factor = [1.0, 2.0, 5.0, 10.0].into_iter().find(|f| f * power >= raw * 0.999).unwrap_or(10.0);
    factor * power
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::drawing::markup::tests::assert_balanced;
    use approx::assert_relative_eq;

    fn labels(axis: &Axis) -> Vec<&str> {
        axis.ticks.iter().map(|t| t.1.as_str()).collect()
    }

    #[test]
    fn ticks_are_round_numbers_that_cover_the_values() {
        let axis = Axis::new([-93.0, 41.0].into_iter(), [0.0, 1.0], false);
        assert_eq!(labels(&axis), ["-100", "-50", "0", "50"]);
        assert_relative_eq!([axis.at(-100.0), axis.at(50.0)][..], [0.0, 1.0][..]);
        let iterations = Axis::new((0..=40).map(f64::from), [0.0, 400.0], true);
        assert_eq!(labels(&iterations), ["0", "10", "20", "30", "40"]);
        assert_relative_eq!(iterations.at(40.0), 400.0);
        let small = Axis::new([0.0, 0.021].into_iter(), [0.0, 1.0], false);
        assert_eq!(labels(&small), ["0", "0.005", "0.010", "0.015", "0.020", "0.025"]);
    }

    #[test]
    fn logarithmic_ticks_name_the_values_not_their_logarithms() {
        let axis = Axis::of_logarithms([0.03f64.log10(), 1.3f64.log10()].into_iter(), [0.0, 1.0]);
        assert_eq!(labels(&axis), ["0.02", "0.05", "0.1", "0.2", "0.5", "1", "2"]);
        let narrow = Axis::of_logarithms([11.0f64.log10(), 17.0f64.log10()].into_iter(), [0.0, 1.0]);
        assert_eq!(labels(&narrow), ["10", "12", "15", "20"]);
        let small = Axis::of_logarithms([0.11f64.log10(), 0.17f64.log10()].into_iter(), [0.0, 1.0]);
        assert_eq!(labels(&small), ["0.1", "0.12", "0.15", "0.2"]);
        let wide = Axis::of_logarithms([-4.0, 1.0].into_iter(), [0.0, 1.0]);
        assert_eq!(labels(&wide), ["0.0001", "0.001", "0.01", "0.1", "1", "10"]);
    }

    #[test]
    fn charts_without_points_or_with_constant_points_are_well_formed() {
        for points in [vec![], vec![[1.0, f64::NAN]], vec![[1.0, 2.0]], vec![[0.0, 0.0], [1.0, 0.0]]] {
            for scale in [Scale::Linear, Scale::Logarithmic] {
                let series = Series { name: "s".into(), color: INK, dashed: false, points: points.clone() };
                let chart = Chart {
                    heading: "h".into(),
                    x_label: "x".into(),
                    x_range: None,
                    scale,
                    series: vec![series],
                };
                let mut svg = Svg::new(300.0, 200.0, "chart");
                chart.draw(&mut svg, &Area { x: 0.0, y: 0.0, width: 300.0, height: 200.0 });
                let text = svg.finish();
                assert_balanced(&text);
                assert!(!text.contains("NaN") && !text.contains("inf"), "{text}");
            }
        }
    }
}
