//! Progress of a run, as reported to the caller.

use crate::checkpoint::pretrained::Imported;
use crate::checkpoint::warm_start::WarmStart;
use crate::metrics::history::EpochRecord;

/// An event of a run.
#[derive(Debug)]
pub enum Event<'a> {
    /// Published weights were imported.
    Imported(&'a Imported),
    /// The run starts from a trained model.
    WarmStart {
        /// The model.
        parent: &'a WarmStart,
        /// First difference between its camera and that of the examples: property, its value there and here.
        other_camera: Option<(&'static str, f64, f64)>,
    },
    /// The run was started or resumed.
    Started {
        /// Complete epochs.
        epochs: usize,
        /// Steps taken.
        steps: usize,
        /// Steps of the whole run, provided that no phase stops early.
        planned: usize,
        /// Device of the previous steps, if it is a different one. Results are bit-identical only on one CPU.
        other_device: Option<String>,
    },
    /// A step was taken.
    Step {
        /// Current epoch, from 1, and epochs of the run, provided that no phase stops early.
        epoch: [usize; 2],
        /// Steps taken, and steps of the run, provided that no phase stops early.
        step: [usize; 2],
        /// Examples of the batch.
        examples: usize,
        /// Loss of the batch before the step.
        loss: f64,
    },
    /// An epoch is complete and saved.
    Epoch(&'a EpochRecord),
}
