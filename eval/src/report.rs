//! The report: one HTML page with everything inside, that a browser shows without network or scripts.

use crate::figures::Figure;
use crate::measures::System;
use crate::svg::escaped;
use crate::tables::grids;
use crate::trace::{ContactCounts, Outcome, SessionRecord};
use std::fmt::Write;

/// All that a report says. It can be filled from the files of a finished run as well as by the run itself.
#[derive(Debug, Clone, PartialEq)]
pub struct Report {
    /// Heading of the page.
    pub title: String,
    /// What was done and what came out, a paragraph each.
    pub summary: Vec<String>,
    /// What was run: name and value, such as preset, seed, device, version.
    pub facts: Vec<(String, String)>,
    /// The stages of the run.
    pub stages: Vec<Stage>,
    /// The evaluated systems, in the order of the tables.
    pub systems: Vec<System>,
    /// Figures in the order of the page.
    pub figures: Vec<Figure>,
    /// Sessions in the order of the page.
    pub sessions: Vec<SessionGroup>,
    /// Files of settings as they were used: name and TOML.
    pub settings: Vec<(String, String)>,
}

/// One stage of a run.
#[derive(Debug, Clone, PartialEq)]
pub struct Stage {
    /// What was done.
    pub name: String,
    /// How long it took \[s\]; `None` where an earlier run's result was used again.
    pub seconds: Option<f64>,
    /// What came out.
    pub result: String,
}

/// The sessions of one system.
#[derive(Debug, Clone, PartialEq)]
pub struct SessionGroup {
    /// Name of the system.
    pub system: String,
    /// Its sessions, a row each.
    pub rows: Vec<SessionRow>,
}

/// How one session ended.
#[derive(Debug, Clone, PartialEq)]
pub struct SessionRow {
    /// Index, from which the session can be run again.
    pub index: usize,
    /// Obstacles on the table.
    pub obstacles: usize,
    /// How it ended.
    pub outcome: Outcome,
    /// Steps.
    pub steps: usize,
    /// Distance between final and goal position \[m\].
    pub position_error: f64,
    /// Angle between final and goal orientation \[rad\].
    pub orientation_error: f64,
    /// What else happened; empty if nothing.
    pub remarks: String,
}

impl SessionGroup {
    /// The sessions of a system.
    pub fn of(system: impl Into<String>, records: &[SessionRecord]) -> Self {
        Self { system: system.into(), rows: records.iter().map(SessionRow::from).collect() }
    }
}

impl From<&SessionRecord> for SessionRow {
    fn from(record: &SessionRecord) -> Self {
        let ContactCounts { obstacle, target, table } = record.contacts;
        let incidents = [
            (obstacle, "hit an obstacle"),
            (table, "hit the table"),
            (target, "touched the target"),
            (record.target_lost_steps, "target out of view"),
            (record.limit_violations, "joint outside its limits"),
        ];
        let happened = incidents.iter().filter(|(steps, _)| *steps > 0);
        Self {
            index: record.index,
            obstacles: record.scene.obstacles.len(),
            outcome: record.outcome,
            steps: record.steps.len(),
            position_error: record.position_error,
            orientation_error: record.orientation_error,
            remarks: happened.map(|(_, incident)| *incident).collect::<Vec<_>>().join(", "),
        }
    }
}

/// An outcome in words.
fn in_words(outcome: Outcome) -> &'static str {
    match outcome {
        Outcome::Converged => "converged",
        Outcome::Collided => "collided",
        Outcome::TargetLost => "target lost",
        Outcome::Infeasible => "infeasible",
        Outcome::IterationLimit => "not settled",
    }
}

impl Report {
    /// The page.
    pub fn to_html(&self) -> String {
        let mut html = format!(
            "<!doctype html>\n<html lang=\"en\">\n<head>\n<meta charset=\"utf-8\">\n\
             <meta name=\"viewport\" content=\"width=device-width, initial-scale=1\">\n<title>{title}</title>\n\
             <style>\n{}</style>\n</head>\n<body>\n<main>\n<h1>{title}</h1>\n",
            include_str!("report.css"),
            title = escaped(&self.title)
        );
        for paragraph in &self.summary {
            let _ = writeln!(html, "<p>{}</p>", escaped(paragraph));
        }
        html += &self.facts_html();
        html += "<h2>Results</h2>\n";
        for grid in grids(&self.systems) {
            html += &grid.to_html();
        }
        if !self.figures.is_empty() {
            html += "<h2>Figures</h2>\n";
        }
        for Figure { label, svg, caption } in &self.figures {
            let (label, caption) = (escaped(label), escaped(caption));
            let _ = write!(
                html,
                "<figure>\n<div class=\"scroll\">{svg}</div>\n<figcaption><b>{label}.</b> {caption}</figcaption>\n</figure>\n"
            );
        }
        html += &self.stages_html();
        html += &self.sessions_html();
        html += &self.settings_html();
        html + "</main>\n</body>\n</html>\n"
    }

    fn facts_html(&self) -> String {
        let mut html = String::from("<dl>\n");
        for (name, value) in &self.facts {
            let _ = writeln!(html, "<div><dt>{}</dt><dd>{}</dd></div>", escaped(name), escaped(value));
        }
        html + "</dl>\n"
    }

    fn stages_html(&self) -> String {
        if self.stages.is_empty() {
            return String::new();
        }
        let mut html = String::from(
            "<h2>Stages</h2>\n<div class=\"scroll\"><table>\n<thead><tr><th class=\"word\">stage</th>",
        );
        html += "<th>time</th><th class=\"word\">result</th></tr></thead>\n<tbody>\n";
        for stage in &self.stages {
            let time = stage.seconds.map_or_else(|| "reused".into(), duration);
            let (name, result) = (escaped(&stage.name), escaped(&stage.result));
            let _ = writeln!(
                html,
                "<tr><td class=\"word\">{name}</td><td>{time}</td><td class=\"word\">{result}</td></tr>"
            );
        }
        let total = duration(self.stages.iter().filter_map(|s| s.seconds).sum());
        let _ = writeln!(
            html,
            "</tbody>\n<tbody><tr><td class=\"word\">all</td><td>{total}</td><td></td></tr></tbody>"
        );
        html + "</table></div>\n"
    }

    fn sessions_html(&self) -> String {
        let mut html = String::new();
        if !self.sessions.is_empty() {
            html += "<h2>Sessions</h2>\n";
        }
        for group in &self.sessions {
            let failed = group.rows.iter().filter(|r| r.outcome != Outcome::Converged).count();
            let _ = write!(
                html,
                "<details>\n<summary>{}: {} sessions, {failed} not converged</summary>\n<div class=\"scroll\"><table>\n<thead><tr>\
                 <th>index</th><th>obstacles</th><th class=\"word\">outcome</th><th>steps</th><th>position<span>mm</span></th>\
                 <th>orientation<span>deg</span></th><th class=\"word\">remarks</th></tr></thead>\n<tbody>\n",
                escaped(&group.system),
                group.rows.len()
            );
            for row in &group.rows {
                html += &row.to_html();
            }
            html += "</tbody>\n</table></div>\n</details>\n";
        }
        html
    }

    fn settings_html(&self) -> String {
        let mut html = String::new();
        if !self.settings.is_empty() {
            html += "<h2>Settings</h2>\n";
        }
        for (name, toml) in &self.settings {
            let (name, toml) = (escaped(name), escaped(toml));
            let _ = write!(html, "<details>\n<summary>{name}</summary>\n<pre>{toml}</pre>\n</details>\n");
        }
        html
    }
}

impl SessionRow {
    fn to_html(&self) -> String {
        let class = if self.outcome == Outcome::Converged { "" } else { " class=\"failed\"" };
        format!(
            "<tr{class}><td>{}</td><td>{}</td><td class=\"word\">{}</td><td>{}</td><td>{:.2}</td><td>{:.2}</td>\
             <td class=\"word\">{}</td></tr>\n",
            self.index,
            self.obstacles,
            in_words(self.outcome),
            self.steps,
            world::units::to_mm(self.position_error),
            world::units::to_deg(self.orientation_error),
            escaped(&self.remarks)
        )
    }
}

/// As "0.4 s", "12 s", "3 min 05 s" or "2 h 10 min".
fn duration(seconds: f64) -> String {
    let whole = seconds.round() as u64;
    match whole {
        0..10 => format!("{seconds:.1} s"),
        10..60 => format!("{whole} s"),
        60..3600 => format!("{} min {:02} s", whole / 60, whole % 60),
        _ => format!("{} h {:02} min", whole / 3600, whole % 3600 / 60),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::measures::tests::system;
    use crate::svg::tests::assert_balanced;

    fn report() -> Report {
        let row = |index| SessionRow {
            index,
            obstacles: index % 4,
            outcome: if index == 7 { Outcome::Collided } else { Outcome::Converged },
            steps: 17,
            position_error: 0.00123,
            orientation_error: 0.01,
            remarks: String::new(),
        };
        Report {
            title: "R <&> \"D\"".into(),
            summary: vec!["<script>alert(1)</script>".into()],
            facts: vec![("device".into(), "<cpu>".into())],
            stages: vec![Stage { name: "train".into(), seconds: Some(185.0), result: "a < b".into() }],
            systems: vec![system("<plain>")],
            figures: vec![Figure {
                label: "Figure 8".into(),
                svg: "<svg></svg>".into(),
                caption: "x < y".into(),
            }],
            sessions: vec![SessionGroup { system: "<plain>".into(), rows: (0..40).map(row).collect() }],
            settings: vec![("eval.toml".into(), "key = \"</pre>\"".into())],
        }
    }

    #[test]
    fn every_session_figure_and_setting_is_there_and_every_text_escaped() {
        let html = report().to_html();
        assert_balanced(&html);
        for index in 0..40 {
            assert!(html.contains(&format!("<td>{index}</td><td>{}</td>", index % 4)), "session {index}");
        }
        assert_eq!(html.matches("class=\"failed\"").count(), 1);
        for text in [
            "40 sessions, 1 not converged",
            "<b>Figure 8.</b> x &lt; y",
            "&quot;&lt;/pre&gt;&quot;",
            "&lt;plain&gt;",
            "3 min 05 s",
        ] {
            assert!(html.contains(text), "{text}");
        }
        assert!(!html.contains("<script") && !html.contains("<cpu>"));
    }

    #[test]
    fn the_page_needs_nothing_from_outside() {
        let html = report().to_html();
        for outside in ["src=\"http", "href=\"http", "url(", "@import", "<link"] {
            assert!(!html.contains(outside), "{outside}");
        }
    }

    #[test]
    fn durations_read_well() {
        let read = [0.42, 9.6, 59.7, 60.0, 3599.0, 7805.0].map(duration);
        assert_eq!(read, ["0.4 s", "10 s", "1 min 00 s", "1 min 00 s", "59 min 59 s", "2 h 10 min"]);
    }
}
