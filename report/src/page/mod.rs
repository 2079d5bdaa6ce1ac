//! The report: one self-contained HTML page without scripts.

pub mod sessions;
mod table;

use crate::drawing::figure::Figure;
use crate::drawing::markup::escaped;
use eval::results::system::System;
use eval::results::table_1::tables;
use sessions::SessionGroup;
use std::fmt::Write;

/// Contents of a report. It can be filled by a run or from the files of a finished one.
#[derive(Debug, Clone, PartialEq)]
pub struct Report {
    /// Title of the page.
    pub title: String,
    /// Paragraphs that summarize the run and its results.
    pub summary: Vec<String>,
    /// Names and values of what was run, such as preset, seed, device and version.
    pub facts: Vec<(String, String)>,
    /// Stages of the run.
    pub stages: Vec<Stage>,
    /// Evaluated systems in the order of the tables.
    pub systems: Vec<System>,
    /// Figures in the order of the page.
    pub figures: Vec<Figure>,
    /// Sessions in the order of the page.
    pub sessions: Vec<SessionGroup>,
    /// Names and contents of the configuration files that were used, as TOML.
    pub settings: Vec<(String, String)>,
}

/// One stage of a run.
#[derive(Debug, Clone, PartialEq)]
pub struct Stage {
    /// Name.
    pub name: String,
    /// Duration \[s\]; `None` if an earlier result was reused.
    pub seconds: Option<f64>,
    /// Result.
    pub result: String,
}

impl Report {
    /// Returns the page.
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
        for table in tables(&self.systems) {
            html += &table::to_html(&table);
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
        html += &sessions::to_html(&self.sessions);
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
            "</tbody>\n<tbody><tr><td class=\"word\">total</td><td>{total}</td><td></td></tr></tbody>"
        );
        html + "</table></div>\n"
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

/// Formats a duration as "0.4 s", "12 s", "3 min 05 s" or "2 h 10 min".
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
    use crate::drawing::markup::tests::assert_balanced;
    use crate::fixture;
    use crate::page::sessions::SessionRow;
    use eval::Outcome;

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
            systems: vec![System::of("<plain>", &fixture::sessions(2))],
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
    fn every_session_figure_and_setting_is_shown_and_every_text_escaped() {
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
    fn durations_are_readable() {
        let read = [0.42, 9.6, 59.7, 60.0, 3599.0, 7805.0].map(duration);
        assert_eq!(read, ["0.4 s", "10 s", "1 min 00 s", "1 min 00 s", "59 min 59 s", "2 h 10 min"]);
    }
}
