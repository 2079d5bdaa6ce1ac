//! The journal of a run: `metrics.jsonl` and TensorBoard's event files, for people and their tools.
//!
//! No result of training depends on it. Times come from the caller, since this crate reads no clock.

use std::path::Path;

use serde_json::Value;

use super::history::{self, Cost, EpochRecord, Line};
use super::tensorboard::EventFile;
use crate::error::Result;

/// Steps between two recorded steps.
const STEPS: usize = 10;

/// Measurements of the machine rather than the network.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Telemetry {
    /// Seconds since any fixed moment.
    pub seconds: f64,
    /// Seconds since 1970.
    pub unix_time: f64,
    /// Peak memory of the process so far. `None` if the system does not report it.
    pub peak_memory_mb: Option<f64>,
}

/// Measurements of a step.
#[derive(Debug, Clone, Copy)]
pub(crate) struct StepRecord {
    /// Loss of the batch before the step.
    pub(crate) loss: f64,
    pub(crate) learning_rate: f64,
    /// Norm of the gradient before clipping.
    pub(crate) gradient_norm: f64,
}

/// The journal of a run in progress.
pub(crate) struct Journal<'a> {
    run: &'a Path,
    telemetry: &'a dyn Fn() -> Telemetry,
    events: EventFile,
    started: Telemetry,
    epoch_started: Telemetry,
    last_step: Telemetry,
    /// Training examples since the epoch was started or resumed.
    examples: usize,
}

impl<'a> Journal<'a> {
    /// Opens the journal of a run after `epochs` epochs and `steps` steps. Later entries are dropped.
    pub(crate) fn open(
        run: &'a Path,
        telemetry: &'a dyn Fn() -> Telemetry,
        epochs: usize,
        steps: usize,
    ) -> Result<Self> {
        history::truncate(run, epochs)?;
        let now = telemetry();
        let events = EventFile::create(&run.join("tensorboard"), steps + 1, now.unix_time)?;
        Ok(Self { run, telemetry, events, started: now, epoch_started: now, last_step: now, examples: 0 })
    }

    /// Starts or resumes an epoch.
    pub(crate) fn begin_epoch(&mut self) {
        self.epoch_started = (self.telemetry)();
        self.examples = 0;
    }

    /// Records a step with `examples` examples. `steps` counts the steps of the run.
    pub(crate) fn step(&mut self, steps: usize, examples: usize, record: &StepRecord) -> Result<()> {
        self.examples += examples;
        self.last_step = (self.telemetry)();
        if !steps.is_multiple_of(STEPS) {
            return Ok(());
        }
        let StepRecord { loss, learning_rate, gradient_norm } = *record;
        let values = [("loss", loss), ("learning_rate", learning_rate), ("gradient_norm", gradient_norm)];
        let values = values.map(|(name, value)| (format!("step/{name}"), value));
        self.events.scalars(steps, self.last_step.unix_time, &values)
    }

    /// Records a complete epoch.
    pub(crate) fn complete_epoch(&mut self, record: &EpochRecord) -> Result<()> {
        let now = (self.telemetry)();
        let seconds = self.last_step.seconds - self.epoch_started.seconds;
        let cost = Cost {
            seconds: now.seconds - self.started.seconds,
            samples_per_s: (self.examples > 0 && seconds > 0.0).then(|| self.examples as f64 / seconds),
            peak_memory_mb: now.peak_memory_mb,
        };
        let line = Line { record, cost };
        history::append(self.run, &line)?;
        let values = serde_json::to_value(&line).expect("numbers and names are always JSON");
        let scalar = |(name, value): (&String, &Value)| Some((format!("epoch/{name}"), value.as_f64()?));
        let scalars: Vec<_> = values.as_object().into_iter().flatten().filter_map(scalar).collect();
        self.events.scalars(record.steps, now.unix_time, &scalars)
    }
}
