//! Progress for people: a bar with rate and remaining time on a terminal, a plain line now and then elsewhere.
//! All of it goes to standard error; results go to standard output.

use crate::output::note;
use indicatif::{ProgressBar, ProgressState, ProgressStyle};
use std::fmt;
use std::io::IsTerminal;
use std::sync::Mutex;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::{Duration, Instant};

/// One stage of work, counted in steps.
pub(crate) struct Progress {
    name: String,
    unit: &'static str,
    done: AtomicU64,
    /// Of it, what was done before the stage began.
    before: AtomicU64,
    total: AtomicU64,
    started: Instant,
    bar: Option<ProgressBar>,
    plain: Mutex<Plain>,
}

/// When the next plain line is due.
struct Plain {
    next: u64,
    last: Instant,
}

/// Plain lines come at every tenth of the work, and no more often than this.
const PLAIN_PAUSE: Duration = Duration::from_secs(5);

impl Progress {
    /// Begins to show a stage of `total` steps, each a `unit` (plural).
    pub(crate) fn start(name: &str, unit: &'static str, total: u64) -> Self {
        let bar = std::io::stderr().is_terminal().then(|| {
            let bar = ProgressBar::new(total);
            let template = format!(
                "{{prefix}} {{wide_bar}} {{human_pos}}/{{human_len}} {unit}, {{rate}}, {{eta}} left{{msg}}"
            );
            if let Ok(style) = ProgressStyle::with_template(&template) {
                bar.set_style(style.with_key("rate", |state: &ProgressState, text: &mut dyn fmt::Write| {
                    // A bar has no one to tell of an error.
                    let _ = write!(text, "{:.1}/s", state.per_sec());
                }));
            }
            bar.set_prefix(name.to_owned());
            bar.enable_steady_tick(Duration::from_millis(250));
            bar
        });
        let started = Instant::now();
        Self {
            name: name.to_owned(),
            unit,
            done: AtomicU64::new(0),
            before: AtomicU64::new(0),
            total: AtomicU64::new(total),
            started,
            bar,
            plain: Mutex::new(Plain { next: total.div_ceil(10), last: started }),
        }
    }

    /// Says how far the stage is, and in a few words how it goes.
    pub(crate) fn update(&self, done: u64, message: &str) {
        self.done.store(done, Ordering::Relaxed);
        self.show(done, message);
    }

    fn show(&self, done: u64, message: &str) {
        let Ok(mut plain) = self.plain.lock() else { return };
        if let Some(bar) = &self.bar {
            bar.set_position(done);
            // On a line of its own there is room for it.
            bar.set_message(if message.is_empty() { String::new() } else { format!("\n  {message}") });
            return;
        }
        let total = self.total.load(Ordering::Relaxed);
        if done < plain.next || done >= total || plain.last.elapsed() < PLAIN_PAUSE {
            return;
        }
        *plain = Plain { next: done + total.div_ceil(10), last: Instant::now() };
        let rate = (done - self.before.load(Ordering::Relaxed)) as f64 / self.seconds().max(1e-9);
        let left = (total - done) as f64 / rate.max(1e-9);
        let Self { name, unit, .. } = self;
        note!(
            "{name}: {done}/{total} {unit}, {rate:.1}/s, about {left:.0} s left{}{message}",
            comma(message)
        );
    }

    /// Says how far a stage is whose size was not known at its start.
    pub(crate) fn update_of(&self, done: u64, total: u64, message: &str) {
        self.set_total(total);
        self.update(done, message);
    }

    /// Says how far the stage is, and how much of it was done before the stage began.
    pub(crate) fn update_from(&self, before: u64, done: u64) {
        self.before.store(before, Ordering::Relaxed);
        self.update(done, "");
    }

    /// Begins where another run stopped: what was done before counts for the bar, not for the rate.
    pub(crate) fn begin_at(&self, done: u64, total: u64) {
        self.set_total(total);
        self.done.store(done, Ordering::Relaxed);
        self.before.store(done, Ordering::Relaxed);
        if let Ok(mut plain) = self.plain.lock() {
            plain.next = done + total.div_ceil(10);
        }
        if let Some(bar) = &self.bar {
            bar.set_position(done);
            bar.reset_eta();
        }
    }

    fn set_total(&self, total: u64) {
        self.total.store(total, Ordering::Relaxed);
        if let Some(bar) = &self.bar {
            bar.set_length(total);
        }
    }

    /// One more step, from any thread.
    pub(crate) fn advance(&self) {
        let before = self.done.fetch_add(1, Ordering::Relaxed);
        self.show(before + 1, "");
    }

    /// A line of its own, above the bar.
    pub(crate) fn say(&self, line: &str) {
        match &self.bar {
            Some(bar) => bar.suspend(|| note!("{line}")),
            None => note!("{line}"),
        }
    }

    /// Seconds since the stage began.
    pub(crate) fn seconds(&self) -> f64 {
        self.started.elapsed().as_secs_f64()
    }

    /// Ends the stage's display; returns its seconds.
    pub(crate) fn finish(self) -> f64 {
        let seconds = self.seconds();
        if let Some(bar) = &self.bar {
            bar.finish_and_clear();
        }
        let done = self.done.load(Ordering::Relaxed) - self.before.load(Ordering::Relaxed);
        note!("{}: {done} {} in {seconds:.1} s", self.name, self.unit);
        seconds
    }
}

fn comma(message: &str) -> &'static str {
    if message.is_empty() { "" } else { ", " }
}

/// Largest memory that this process has held \[MB\]; `None` where the system does not tell.
pub(crate) fn peak_rss_mb() -> Option<f64> {
    let status = std::fs::read_to_string("/proc/self/status").ok()?;
    let line = status.lines().find(|line| line.starts_with("VmHWM:"))?;
    let kibibytes: f64 = line.split_whitespace().nth(1)?.parse().ok()?;
    Some(kibibytes * 1024.0 / 1e6)
}
