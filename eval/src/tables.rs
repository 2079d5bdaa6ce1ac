//! Table 1 of the paper beside the paper's own numbers, and what the paper leaves out (Section 6.4), for people to read.
//! Programs read [`crate::measures`]. Millimetres, degrees and milliseconds begin in these two files.

use crate::accuracy::Accuracy;
use crate::conduct::STAGES;
use crate::grid::{Column, Grid};
use crate::measures::{AXIS_UNITS, System, statistics, to_ms};
use crate::paper::{Published, definet, proposed_method};
use world::units::{to_deg, to_mm};

/// The tables in reading order.
pub fn grids(systems: &[System]) -> Vec<Grid> {
    vec![table_1(systems), beyond_table_1(systems), outcomes(systems), times(systems)]
}

/// All tables for a terminal.
pub fn to_text(systems: &[System]) -> String {
    grids(systems).iter().map(Grid::to_text).collect::<Vec<_>>().join("\n")
}

/// All tables as Markdown.
pub fn to_markdown(systems: &[System]) -> String {
    grids(systems).iter().map(Grid::to_markdown).collect::<Vec<_>>().join("\n")
}

/// Table 1: the paper's layout, its own rows first.
fn table_1(systems: &[System]) -> Grid {
    let row = |name: &str, statistic: &str, axes: [f64; 6], norms: [String; 2]| {
        let [x, y, z, phi, theta, psi] = std::array::from_fn(|i| shown((AXIS_UNITS[i].1)(axes[i])));
        let [position, orientation] = norms;
        vec![name.to_owned(), statistic.to_owned(), x, y, z, position, phi, theta, psi, orientation]
    };
    let published = |paper: &Published| {
        let norms = [printed(to_mm(paper.position_norm)), printed(to_deg(paper.orientation_norm))];
        let mut block = vec![row(paper.name, "mean", paper.mean.unwrap_or([f64::NAN; 6]), norms)];
        block.extend(paper.standard_deviation.map(|axes| row("", "std. dev.", axes, absent())));
        block
    };
    let measured = |system: &System| {
        let Accuracy { axes, .. } = &system.accuracy;
        let norms = [
            shown(to_mm(system.accuracy.position_norm())),
            shown(to_deg(system.accuracy.orientation_norm())),
        ];
        vec![
            row(&system.name, "mean", axes.map(|a| a.mean), norms),
            row("", "std. dev.", axes.map(|a| a.standard_deviation), absent()),
        ]
    };
    let blocks =
        [proposed_method(), definet()].iter().map(published).chain(systems.iter().map(measured)).collect();
    Grid {
        title: "Table 1. Final pose error of visual servoing, per pose variable".into(),
        columns: columns(&[
            ("system", ""),
            ("", ""),
            ("Δx", "mm"),
            ("Δy", "mm"),
            ("Δz", "mm"),
            ("norm", "mm"),
            ("Δφ", "deg"),
            ("Δθ", "deg"),
            ("Δψ", "deg"),
            ("norm", "deg"),
        ]),
        words: 2,
        blocks,
        note: "Absolute errors in the robot frame over all sessions, whatever their outcome; norm: of the three means, as in \
               the paper. The paper does not say whether its averages are of absolute errors."
            .into(),
    }
}

/// Statistics of the error norms of single sessions.
fn beyond_table_1(systems: &[System]) -> Grid {
    let published = |paper: &Published| {
        let row = |name: &str, kind: &str, norm: f64, rms: Option<f64>| {
            let rms = rms.map_or_else(|| "–".into(), printed);
            let mut cells =
                vec![name.to_owned(), kind.to_owned(), printed(norm), "–".into(), "–".into(), rms];
            cells.extend(["–".into(), "–".into(), "–".into()]);
            cells
        };
        let rms = paper.root_mean_squares();
        vec![
            row(
                paper.name,
                "position, mm",
                to_mm(paper.position_norm),
                rms.map(|[position, _]| to_mm(position)),
            ),
            row("", "orientation, deg", to_deg(paper.orientation_norm), rms.map(|[_, angle]| to_deg(angle))),
        ]
    };
    let row = |name: &str, kind: &str, norm: [String; 2], statistics: [f64; 5]| {
        let [norm, interval] = norm;
        let mut cells = vec![name.to_owned(), kind.to_owned(), norm, interval];
        cells.extend(statistics.map(shown));
        cells
    };
    let measured = |system: &System| {
        let a = &system.accuracy;
        let norm = |norm: f64, interval: [f64; 2], unit: fn(f64) -> f64| {
            let [low, high] = interval.map(unit).map(shown);
            [shown(unit(norm)), format!("{low} to {high}")]
        };
        let position = norm(a.position_norm(), a.position_norm_interval, to_mm);
        let orientation = norm(a.orientation_norm(), a.orientation_norm_interval, to_deg);
        vec![
            row(&system.name, "position, mm", position, statistics(&a.position, to_mm)),
            row("", "orientation, deg", orientation, statistics(&a.orientation, to_deg)),
        ]
    };
    let blocks =
        [proposed_method(), definet()].iter().map(published).chain(systems.iter().map(measured)).collect();
    Grid {
        title: "What Table 1 leaves out: the error norms of single sessions".into(),
        columns: columns(&[
            ("system", ""),
            ("error", ""),
            ("Table 1", ""),
            ("95 % interval", ""),
            ("mean", ""),
            ("RMS", ""),
            ("median", ""),
            ("95th perc.", ""),
            ("maximum", ""),
        ]),
        words: 2,
        blocks,
        note: "Distance between final and goal position, angle between final and goal orientation. Table 1: the paper's norm of \
               the three means, with its 95 % interval by bootstrap over the sessions. The paper's RMS is what its means and \
               deviations imply."
            .into(),
    }
}

/// How sessions ended, and after how many steps.
fn outcomes(systems: &[System]) -> Grid {
    let published = |paper: &Published| {
        let number = |value: Option<f64>| value.map_or_else(|| "–".into(), |v| format!("{v:.0}"));
        let mut row = vec![paper.name.to_owned(), number(paper.sessions.map(|n| n as f64))];
        row.extend(["–".into(), "–".into(), "–".into(), "–".into(), number(paper.iterations)]);
        vec![row]
    };
    let measured = |system: &System| {
        let c = &system.conduct;
        let share = |count: usize| format!("{:.1}", 100.0 * c.share(count));
        let mut row = vec![system.name.clone(), c.sessions.to_string()];
        row.extend([c.converged, c.collided, c.target_lost, c.iteration_limit + c.infeasible].map(share));
        row.push(format!("{:.1}", c.iterations.mean));
        vec![row]
    };
    Grid {
        title: "How the sessions ended".into(),
        columns: columns(&[
            ("system", ""),
            ("sessions", ""),
            ("converged", "%"),
            ("collided", "%"),
            ("target lost", "%"),
            ("not settled", "%"),
            ("iterations", "mean"),
        ]),
        words: 1,
        blocks: [proposed_method()].iter().map(published).chain(systems.iter().map(measured)).collect(),
        note: "Converged: the loop settled, wherever that is. Collided: the hand ran into an obstacle or the table. Target \
               lost: its center left the image and stayed away. Not settled: stopped at the step limit, or without a \
               displacement from the quadratic program. The paper's iterations are those of its one example."
            .into(),
    }
}

/// What a step costs.
fn times(systems: &[System]) -> Grid {
    let published = |paper: &Published| {
        let mut row = vec![paper.name.to_owned()];
        row.extend(STAGES.map(|_| "–".to_owned()));
        row.push(
            paper.seconds_per_step.map_or_else(|| "–".into(), |seconds| format!("{:.0}", to_ms(seconds))),
        );
        vec![row]
    };
    let measured = |system: &System| {
        let seconds = system.conduct.seconds_per_step;
        let mut row = vec![system.name.clone()];
        row.extend(seconds.map(|stage| shown(to_ms(stage))));
        row.push(shown(to_ms(seconds.iter().sum())));
        vec![row]
    };
    let mut names = vec![("system", "")];
    names.extend(STAGES.map(|stage| (stage, "ms")));
    names.push(("step", "ms"));
    Grid {
        title: "Time of one step".into(),
        columns: columns(&names),
        words: 1,
        blocks: [proposed_method()].iter().map(published).chain(systems.iter().map(measured)).collect(),
        note: "Mean wall-clock time by stage, with sessions running side by side. The paper's is approximate, and that of its machine."
            .into(),
    }
}

fn columns(names: &[(&'static str, &'static str)]) -> Vec<Column> {
    names.iter().map(|&(name, unit)| Column { name, unit }).collect()
}

fn absent() -> [String; 2] {
    [String::new(), String::new()]
}

/// A measured number with as many decimals as mean something.
fn shown(value: f64) -> String {
    match value {
        v if !v.is_finite() => "–".into(),
        v if v > 0.0 && v < 0.005 => "<0.01".into(),
        v if v < 99.95 => format!("{v:.2}"),
        v => format!("{v:.1}"),
    }
}

/// One of the paper's norms with as many decimals as it prints.
fn printed(value: f64) -> String {
    format!("{value:.1}")
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::accuracy::Distribution;
    use crate::measures::tests::system;

    fn cells<'a>(grid: &'a Grid, name: &str) -> &'a [Vec<String>] {
        grid.blocks.iter().find(|block| block[0][0] == name).unwrap()
    }

    #[test]
    fn the_papers_averages_give_the_papers_norms() {
        let paper = proposed_method();
        let axis = |i: usize| Distribution { mean: paper.mean.unwrap()[i], ..Distribution::of(&[]) };
        let mut replica = system("replica");
        replica.accuracy.axes = std::array::from_fn(axis);
        let grid = table_1(&[replica]);
        let (printed, computed) = (&cells(&grid, "the paper")[0], &cells(&grid, "replica")[0]);
        assert_eq!(printed[2..], ["1.72", "3.21", "2.61", "4.5", "1.42", "0.72", "0.33", "1.6"]);
        assert_eq!(computed[2..], ["1.72", "3.21", "2.61", "4.48", "1.42", "0.72", "0.33", "1.63"]);
    }

    #[test]
    fn rows_are_as_long_as_the_header_and_text_and_markdown_hold_every_cell() {
        let systems = [system("ours"), system("plain")];
        let (text, markdown) = (to_text(&systems), to_markdown(&systems));
        for grid in grids(&systems) {
            for row in grid.blocks.iter().flatten() {
                assert_eq!(row.len(), grid.columns.len(), "{}: {row:?}", grid.title);
                assert!(row.iter().all(|cell| text.contains(cell.as_str())), "{row:?}");
                assert!(markdown.contains(&format!("| {} |", row.join(" | "))), "{row:?}");
            }
        }
    }

    #[test]
    fn the_definet_row_and_the_implied_rms_are_there() {
        let grids = grids(&[system("ours")]);
        assert_eq!(cells(&grids[0], "the paper's DEFINet")[0][2..6], ["–", "–", "–", "12.4"]);
        assert_eq!(cells(&grids[1], "the paper")[0][5], "7.0");
        assert_eq!(cells(&grids[1], "the paper")[1][5], "2.8");
        assert_eq!(cells(&grids[0], "ours")[0][2..6], ["0.50", "0.00", "0.00", "0.50"]);
        assert_eq!(cells(&grids[2], "ours")[0][1..7], ["4", "100.0", "0.0", "0.0", "0.0", "13.5"]);
    }

    #[test]
    fn small_numbers_are_not_rounded_to_nothing() {
        let read = [0.0, 4e-5, 0.005, 12.345, 1234.5, f64::NAN].map(shown);
        assert_eq!(read, ["0.00", "<0.01", "0.01", "12.35", "1234.5", "–"]);
    }
}
