//! Table 1 with the paper's own results, and tables of statistics that the paper does not give (Section 6.4). They are for
//! people; programs read [`super::metrics`].

use super::accuracy::Accuracy;
use super::distribution::Distribution;
use super::metrics::{statistics, to_ms};
use super::pose_variable::{DEGREES, MILLIMETERS, POSE_VARIABLES, Unit};
use super::published::{Published, definet, proposed_method};
use super::system::System;
use super::table::{Column, Table};
use crate::session::outcome::Outcome;
use crate::session::timing::StageSeconds;
use world::units::{to_deg, to_mm};

/// Rows of one system.
type Block = Vec<Vec<String>>;

/// Placeholder for a number that is not published or not defined.
const MISSING: &str = "–";

/// Returns the tables in reading order.
pub fn tables(systems: &[System]) -> Vec<Table> {
    vec![table_1(systems), error_norms(systems), outcomes(systems), times(systems)]
}

/// Returns all tables for a terminal.
pub fn to_text(systems: &[System]) -> String {
    tables(systems).iter().map(Table::to_text).collect::<Vec<_>>().join("\n")
}

/// Returns all tables in Markdown.
pub fn to_markdown(systems: &[System]) -> String {
    tables(systems).iter().map(Table::to_markdown).collect::<Vec<_>>().join("\n")
}

/// Table 1 in the paper's layout, with the paper's rows first.
fn table_1(systems: &[System]) -> Table {
    let row = |name: &str, statistic: &str, axes: [f64; 6], norms: [String; 2]| {
        let cell = |i: usize| shown((POSE_VARIABLES[i].unit.from_si)(axes[i]));
        let [position, orientation] = norms;
        let mut cells = vec![name.to_owned(), statistic.to_owned()];
        cells.extend((0..3).map(cell).chain([position]));
        cells.extend((3..6).map(cell).chain([orientation]));
        cells
    };
    let no_norms = || [String::new(), String::new()];
    let published = |paper: &Published| {
        let norms = [printed(to_mm(paper.position_norm)), printed(to_deg(paper.orientation_norm))];
        let mut block = vec![row(paper.name, "mean", paper.mean.unwrap_or([f64::NAN; 6]), norms)];
        block.extend(paper.standard_deviation.map(|axes| row("", "std. dev.", axes, no_norms())));
        block
    };
    let measured = |system: &System| {
        let accuracy @ Accuracy { axes, .. } = &system.accuracy;
        let norms = [shown(to_mm(accuracy.position_norm())), shown(to_deg(accuracy.orientation_norm()))];
        vec![
            row(&system.name, "mean", axes.map(|a| a.mean), norms),
            row("", "std. dev.", axes.map(|a| a.standard_deviation), no_norms()),
        ]
    };
    let heading = |i: usize| (POSE_VARIABLES[i].heading, POSE_VARIABLES[i].unit.name);
    let mut names = vec![("system", ""), ("", "")];
    names.extend((0..3).map(heading).chain([("norm", MILLIMETERS.name)]));
    names.extend((3..6).map(heading).chain([("norm", DEGREES.name)]));
    Table {
        title: "Table 1. Final pose error of visual servoing, per pose variable".into(),
        columns: columns(&names),
        text_columns: 2,
        blocks: blocks(&[proposed_method(), definet()], published, systems, measured),
        note: "Absolute errors in the robot frame over all sessions, regardless of outcome. The norm is that of the three means, \
               as in the paper. The paper does not state whether its averages are of absolute errors."
            .into(),
    }
}

/// Statistics of the error norms of individual sessions.
fn error_norms(systems: &[System]) -> Table {
    let published = |paper: &Published| {
        let row = |name: &str, kind: &str, norm: f64, rms: Option<f64>| {
            let mut cells =
                vec![name.to_owned(), kind.to_owned(), printed(norm), MISSING.into(), MISSING.into()];
            cells.push(rms.map_or_else(|| MISSING.into(), printed));
            cells.extend([MISSING; 3].map(String::from));
            cells
        };
        let [position, orientation] = paper.root_mean_squares().map_or([None; 2], |rms| rms.map(Some));
        vec![
            row(paper.name, "position, mm", to_mm(paper.position_norm), position.map(to_mm)),
            row("", "orientation, deg", to_deg(paper.orientation_norm), orientation.map(to_deg)),
        ]
    };
    let measured = |system: &System| {
        let a = &system.accuracy;
        let Accuracy { position, orientation, position_norm_interval, orientation_norm_interval, .. } = a;
        let row = |[name, kind]: [&str; 2], norm: f64, interval: &[f64; 2], d: &Distribution, unit: Unit| {
            let [low, high] = interval.map(unit.from_si).map(shown);
            let mut cells = vec![name.to_owned(), kind.to_owned(), shown((unit.from_si)(norm))];
            cells.push(format!("{low} to {high}"));
            cells.extend(statistics(d, unit).map(shown));
            cells
        };
        let (norm, names) = (a.position_norm(), [system.name.as_str(), "position, mm"]);
        let above = row(names, norm, position_norm_interval, position, MILLIMETERS);
        let (norm, names) = (a.orientation_norm(), ["", "orientation, deg"]);
        vec![above, row(names, norm, orientation_norm_interval, orientation, DEGREES)]
    };
    Table {
        title: "Error norms of individual sessions (not in the paper)".into(),
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
        text_columns: 2,
        blocks: blocks(&[proposed_method(), definet()], published, systems, measured),
        note: "Distance between final and goal position, and angle between final and goal orientation. The column Table 1 repeats \
               the norm of the three means, with its 95 % bootstrap interval over the sessions. The paper's RMS is computed from \
               its means and standard deviations."
            .into(),
    }
}

/// Outcomes of the sessions, and their lengths.
fn outcomes(systems: &[System]) -> Table {
    let published = |paper: &Published| {
        let number = |value: Option<f64>| value.map_or_else(|| MISSING.into(), |v| format!("{v:.0}"));
        let mut row = vec![paper.name.to_owned(), number(paper.sessions.map(|n| n as f64))];
        row.extend([MISSING; 4].map(String::from));
        row.push(number(paper.iterations));
        vec![row]
    };
    let measured = |system: &System| {
        let o = &system.outcomes;
        let [converged, collided, target_lost, infeasible, iteration_limit] =
            Outcome::ALL.map(|outcome| o.count(outcome));
        let mut row = vec![system.name.clone(), o.sessions.to_string()];
        let counts = [converged, collided, target_lost, iteration_limit + infeasible];
        row.extend(counts.map(|count| format!("{:.1}", 100.0 * o.share(count))));
        row.push(format!("{:.1}", o.iterations.mean));
        vec![row]
    };
    Table {
        title: "Outcomes of the sessions".into(),
        columns: columns(&[
            ("system", ""),
            ("sessions", ""),
            ("converged", "%"),
            ("collided", "%"),
            ("target lost", "%"),
            ("not settled", "%"),
            ("iterations", "mean"),
        ]),
        text_columns: 1,
        blocks: blocks(&[proposed_method()], published, systems, measured),
        note: "Converged: the loop settled, not necessarily at the goal. Collided: the hand hit an obstacle or the table. Target \
               lost: its center left the image and did not return. Not settled: the session reached the step limit, or the \
               quadratic program had no solution. The paper's iterations are those of its single example."
            .into(),
    }
}

/// Time per step.
fn times(systems: &[System]) -> Table {
    let published = |paper: &Published| {
        let mut row = vec![paper.name.to_owned()];
        row.extend(StageSeconds::NAMES.map(|_| MISSING.to_owned()));
        let seconds = paper.seconds_per_step;
        row.push(seconds.map_or_else(|| MISSING.into(), |seconds| format!("{:.0}", to_ms(seconds))));
        vec![row]
    };
    let measured = |system: &System| {
        let seconds = system.outcomes.seconds_per_step;
        let mut row = vec![system.name.clone()];
        row.extend(seconds.map(|stage| shown(to_ms(stage))));
        row.push(shown(to_ms(seconds.iter().sum())));
        vec![row]
    };
    let mut names = vec![("system", "")];
    names.extend(StageSeconds::NAMES.map(|stage| (stage, "ms")));
    names.push(("step", "ms"));
    Table {
        title: "Time per step".into(),
        columns: columns(&names),
        text_columns: 1,
        blocks: blocks(&[proposed_method()], published, systems, measured),
        note: "Mean wall-clock time by stage, with sessions running in parallel. The paper's time is approximate and was measured \
               on a different machine."
            .into(),
    }
}

/// Returns the paper's rows, followed by those of the systems.
fn blocks(
    papers: &[Published],
    published: impl Fn(&Published) -> Block,
    systems: &[System],
    measured: impl Fn(&System) -> Block,
) -> Vec<Block> {
    papers.iter().map(published).chain(systems.iter().map(measured)).collect()
}

fn columns(names: &[(&'static str, &'static str)]) -> Vec<Column> {
    names.iter().map(|&(name, unit)| Column { name, unit }).collect()
}

/// Formats a measured number with its significant decimals.
fn shown(value: f64) -> String {
    match value {
        v if !v.is_finite() => MISSING.into(),
        v if v > 0.0 && v < 0.005 => "<0.01".into(),
        v if v < 99.95 => format!("{v:.2}"),
        v => format!("{v:.1}"),
    }
}

/// Formats one of the paper's norms with as many decimals as the paper prints.
fn printed(value: f64) -> String {
    format!("{value:.1}")
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::results::metrics::tests::system;

    fn cells<'a>(table: &'a Table, name: &str) -> &'a [Vec<String>] {
        table.blocks.iter().find(|block| block[0][0] == name).unwrap()
    }

    #[test]
    fn the_papers_averages_give_the_papers_norms() {
        let paper = proposed_method();
        let axis = |i: usize| Distribution { mean: paper.mean.unwrap()[i], ..Distribution::of(&[]) };
        let mut replica = system("replica");
        replica.accuracy.axes = std::array::from_fn(axis);
        let table = table_1(&[replica]);
        let (printed, computed) = (&cells(&table, "the paper")[0], &cells(&table, "replica")[0]);
        assert_eq!(printed[2..], ["1.72", "3.21", "2.61", "4.5", "1.42", "0.72", "0.33", "1.6"]);
        assert_eq!(computed[2..], ["1.72", "3.21", "2.61", "4.48", "1.42", "0.72", "0.33", "1.63"]);
    }

    #[test]
    fn rows_are_as_long_as_the_header_and_text_and_markdown_hold_every_cell() {
        let systems = [system("ours"), system("plain")];
        let (text, markdown) = (to_text(&systems), to_markdown(&systems));
        for table in tables(&systems) {
            for row in table.blocks.iter().flatten() {
                assert_eq!(row.len(), table.columns.len(), "{}: {row:?}", table.title);
                assert!(row.iter().all(|cell| text.contains(cell.as_str())), "{row:?}");
                assert!(markdown.contains(&format!("| {} |", row.join(" | "))), "{row:?}");
            }
        }
    }

    #[test]
    fn the_definet_row_and_the_implied_rms_are_shown() {
        let tables = tables(&[system("ours")]);
        assert_eq!(cells(&tables[0], "the paper's DEFINet")[0][2..6], ["–", "–", "–", "12.4"]);
        assert_eq!(cells(&tables[1], "the paper")[0][5], "7.0");
        assert_eq!(cells(&tables[1], "the paper")[1][5], "2.8");
        assert_eq!(cells(&tables[0], "ours")[0][2..6], ["0.50", "0.00", "0.00", "0.50"]);
        assert_eq!(cells(&tables[2], "ours")[0][1..7], ["4", "100.0", "0.0", "0.0", "0.0", "13.5"]);
    }

    #[test]
    fn small_numbers_are_not_rounded_to_nothing() {
        let read = [0.0, 4e-5, 0.005, 12.345, 1234.5, f64::NAN].map(shown);
        assert_eq!(read, ["0.00", "<0.01", "0.01", "12.35", "1234.5", "–"]);
    }
}
