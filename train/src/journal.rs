//! What a run writes while it goes, for people and their tools: `metrics.jsonl`, and TensorBoard's scalars.
//!
//! The loop's results do not depend on it; its times come from the one who started the run, for this crate reads no clock.

use std::path::Path;

use serde_json::Value;

use crate::error::Result;
use crate::history::{self, Cost, EpochRecord, Line};
use crate::place::Place;
use crate::tensorboard::EventFile;

/// Steps between two entries of the single steps.
const STEPS: usize = 10;

/// What is measured of the machine, not of the network.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Gauge {
    /// Since any fixed moment \[s\].
    pub seconds: f64,
    /// Since 1970 \[s\].
    pub unix_time: f64,
    /// Largest memory of the process so far; none where the system does not tell.
    pub peak_memory_mb: Option<f64>,
}

/// The files of a run under way.
pub(crate) struct Journal<'a> {
    run: &'a Path,
    gauge: &'a dyn Fn() -> Gauge,
    events: EventFile,
    started: Gauge,
    epoch_began: Gauge,
    last_step: Gauge,
    /// Examples learned from since the epoch began, or was resumed.
    examples: usize,
}

impl<'a> Journal<'a> {
    /// Goes on where a run stands: what was said about later steps is forgotten.
    pub(crate) fn open(run: &'a Path, gauge: &'a dyn Fn() -> Gauge, place: &Place) -> Result<Self> {
        history::keep(run, place.epoch)?;
        let now = gauge();
        let events = EventFile::begin(&run.join("tensorboard"), place.steps + 1, now.unix_time)?;
        Ok(Self { run, gauge, events, started: now, epoch_began: now, last_step: now, examples: 0 })
    }

    /// An epoch begins, or goes on.
    pub(crate) fn begin_epoch(&mut self) {
        self.epoch_began = (self.gauge)();
        self.examples = 0;
    }

    /// A step from some examples brought the run to `place`.
    pub(crate) fn step(&mut self, place: &Place, examples: usize, taken: &Step) -> Result<()> {
        self.examples += examples;
        self.last_step = (self.gauge)();
        if !place.steps.is_multiple_of(STEPS) {
            return Ok(());
        }
        let Step { loss, learning_rate, gradient_norm } = *taken;
        let values = [("loss", loss), ("learning_rate", learning_rate), ("gradient_norm", gradient_norm)];
        let values = values.map(|(name, value)| (format!("step/{name}"), value));
        self.events.scalars(place.steps, self.last_step.unix_time, &values)
    }

    /// An epoch is complete.
    pub(crate) fn complete_epoch(&mut self, record: &EpochRecord) -> Result<()> {
        let now = (self.gauge)();
        let seconds = self.last_step.seconds - self.epoch_began.seconds;
        let cost = Cost {
            seconds: now.seconds - self.started.seconds,
            samples_per_s: (self.examples > 0 && seconds > 0.0).then(|| self.examples as f64 / seconds),
            peak_memory_mb: now.peak_memory_mb,
        };
        let line = Line { record, cost };
        history::append(self.run, &line)?;
        let values = serde_json::to_value(&line).expect("numbers under names are always JSON");
        let scalar = |(name, value): (&String, &Value)| Some((format!("epoch/{name}"), value.as_f64()?));
        let scalars: Vec<_> = values.as_object().into_iter().flatten().filter_map(scalar).collect();
        self.events.scalars(record.steps, now.unix_time, &scalars)
    }
}

/// What is known of a step.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Step {
    /// Of the batch, before the step.
    pub(crate) loss: f64,
    pub(crate) learning_rate: f64,
    /// Before clipping.
    pub(crate) gradient_norm: f64,
}
