//! Progress display on standard error: on a terminal a bar with rate and remaining time, otherwise an occasional plain line.

use crate::output::note;
use indicatif::{ProgressBar, ProgressState, ProgressStyle};
use std::fmt;
use std::io::IsTerminal;
use std::sync::Mutex;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::{Duration, Instant};

/// Progress of a stage of work, counted in steps.
pub(crate) struct Progress {
    name: String,
    unit: &'static str,
    done: AtomicU64,
    /// Steps done before the stage began.
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

/// Minimum time between plain lines, of which one is due after every tenth of the work.
const PLAIN_PAUSE: Duration = Duration::from_secs(5);

impl Progress {
    /// Starts the display of a stage of `total` steps. `unit` is the plural noun for a step.
    pub(crate) fn start(name: &str, unit: &'static str, total: u64) -> Self {
        let bar = std::io::stderr().is_terminal().then(|| {
            let bar = ProgressBar::new(total);
            let template = format!(
                "{{prefix}} {{wide_bar}} {{human_pos}}/{{human_len}} {unit}, {{rate}}, {{eta}} left{{msg}}"
            );
            if let Ok(style) = ProgressStyle::with_template(&template) {
                bar.set_style(style.with_key("rate", |state: &ProgressState, text: &mut dyn fmt::Write| {
                    // A progress bar cannot report an error.
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

    /// Sets the number of finished steps and shows a short message.
    pub(crate) fn update(&self, done: u64, message: &str) {
        self.done.store(done, Ordering::Relaxed);
        self.show(done, message);
    }

    fn show(&self, done: u64, message: &str) {
        let Ok(mut plain) = self.plain.lock() else { return };
        if let Some(bar) = &self.bar {
            bar.set_position(done);
            // On a line of its own the message has enough room.
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

    /// Like [`Progress::update`], for a stage whose size was not known at the start.
    pub(crate) fn update_of(&self, done: u64, total: u64, message: &str) {
        self.set_total(total);
        self.update(done, message);
    }

    /// Sets the number of finished steps, including those done before the stage began.
    pub(crate) fn update_from(&self, before: u64, done: u64) {
        self.before.store(before, Ordering::Relaxed);
        self.update(done, "");
    }

    /// Continues a previous run. Its steps count for the bar, but not for the rate.
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

    /// Adds one finished step. May be called from any thread.
    pub(crate) fn advance(&self) {
        let before = self.done.fetch_add(1, Ordering::Relaxed);
        self.show(before + 1, "");
    }

    /// Prints a line above the bar.
    pub(crate) fn say(&self, line: &str) {
        match &self.bar {
            Some(bar) => bar.suspend(|| note!("{line}")),
            None => note!("{line}"),
        }
    }

    /// Returns the seconds since the stage began.
    pub(crate) fn seconds(&self) -> f64 {
        self.started.elapsed().as_secs_f64()
    }

    /// Ends the display. Returns the duration of the stage in seconds.
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

/// Returns the separator before a message, if there is one.
fn comma(message: &str) -> &'static str {
    if message.is_empty() { "" } else { ", " }
}
