//! Table of single sessions.

use crate::drawing::markup::escaped;
use eval::session::record::ContactCounts;
use eval::{Outcome, SessionRecord};
use std::fmt::Write;
use world::units::{to_deg, to_mm};

/// Sessions of one system.
#[derive(Debug, Clone, PartialEq)]
pub struct SessionGroup {
    /// Name of the system.
    pub system: String,
    /// One row per session.
    pub rows: Vec<SessionRow>,
}

/// Row of one session.
#[derive(Debug, Clone, PartialEq)]
pub struct SessionRow {
    /// Index, which determines the session.
    pub index: usize,
    /// Number of obstacles.
    pub obstacles: usize,
    /// How it ended.
    pub outcome: Outcome,
    /// Number of steps.
    pub steps: usize,
    /// Distance between final and goal position \[m\].
    pub position_error: f64,
    /// Angle between final and goal orientation \[rad\].
    pub orientation_error: f64,
    /// Incidents during the session.
    pub remarks: String,
}

impl SessionGroup {
    /// Creates the rows of all sessions of a system.
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

/// Returns the sessions of all systems, in collapsible sections.
pub(super) fn to_html(groups: &[SessionGroup]) -> String {
    let mut html = String::new();
    if !groups.is_empty() {
        html += "<h2>Sessions</h2>\n";
    }
    for group in groups {
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

impl SessionRow {
    fn to_html(&self) -> String {
        let class = if self.outcome == Outcome::Converged { "" } else { " class=\"failed\"" };
        format!(
            "<tr{class}><td>{}</td><td>{}</td><td class=\"word\">{}</td><td>{}</td><td>{:.2}</td><td>{:.2}</td>\
             <td class=\"word\">{}</td></tr>\n",
            self.index,
            self.obstacles,
            self.outcome.name().replace('_', " "),
            self.steps,
            to_mm(self.position_error),
            to_deg(self.orientation_error),
            escaped(&self.remarks)
        )
    }
}
