//! An epoch: batches and steps, validation, checkpoints.

use burn::module::Module;

use super::event::Event;
use super::learner::Learner;
use super::run::Run;
use crate::checkpoint::lineage::InitialWeights;
use crate::checkpoint::model_info::ModelInfo;
use crate::checkpoint::save::Snapshot;
use crate::checkpoint::training_state::TrainingState;
use crate::data::batch::{Batch, prefetch};
use crate::data::examples::Examples;
use crate::data::split::Split;
use crate::data::targets::Targets;
use crate::error::{Error, Result};
use crate::metrics::history::EpochRecord;
use crate::metrics::journal::{Journal, StepRecord};
use crate::metrics::validation::Metrics;
use crate::network::Network;
use crate::network::task::Task;
use crate::optimizer::gradients::Gradients;
use crate::optimizer::loss::mean_squared_error;
use crate::optimizer::phase::Phase;

/// Everything in a run that a step does not change.
pub(crate) struct Training<'a> {
    pub(crate) run: &'a Run<'a>,
    pub(crate) task: Task,
    pub(crate) examples: &'a Examples,
    pub(crate) split: Split,
    pub(crate) targets: Targets<'a>,
    pub(crate) phases: Vec<Phase>,
    pub(crate) initial_weights: InitialWeights,
}

impl Training<'_> {
    /// Continues from the current state to the end of its epoch.
    pub(crate) fn epoch(
        &self,
        mut learner: Learner,
        phase: &Phase,
        journal: &mut Journal,
        report: &mut dyn FnMut(Event),
    ) -> Result<Learner> {
        let config = self.run.config;
        let [steps, epochs] = learner.state.planned(&self.phases);
        let order = self.split.order(config.seed, learner.state.epoch, &phase.counts);
        let batches = order.chunks(config.optimizer.batch).take(phase.batches).skip(learner.state.batch);
        journal.begin_epoch();
        let learner = prefetch(self.examples, batches, |batches| {
            for batch in batches {
                if self.run.is_stopped() {
                    return Err(self.interrupted(&learner));
                }
                let batch = batch?;
                let record;
                (learner, record) = self.step(learner, phase, &batch)?;
                let state = &mut learner.state;
                state.step(record.loss, record.gradient_norm);
                let epochs_done = state.epoch as f64 + state.batch as f64 / phase.batches as f64;
                state.losses.add(record.loss, epochs_done, steps);
                journal.step(state.steps, batch.indices.len(), &record)?;
                if state.steps.is_multiple_of(config.checkpoint_steps) && state.batch < phase.batches {
                    self.save_last(&learner)?;
                }
                report(Event::Step {
                    epoch: [learner.state.epoch + 1, epochs],
                    step: [learner.state.steps, steps],
                    examples: batch.indices.len(),
                    loss: record.loss,
                });
            }
            Ok(learner)
        })?;
        match self.validate(&learner.network)? {
            Some(metrics) => self.complete(learner, phase, metrics, journal),
            None => Err(self.interrupted(&learner)),
        }
    }

    /// Takes a step: forward pass, loss, gradients, optimizer.
    fn step(&self, learner: Learner, phase: &Phase, batch: &Batch) -> Result<(Learner, StepRecord)> {
        let Learner { network, mut optimizer, state } = learner;
        let device = self.run.autodiff();
        let outputs = network.forward(batch.images(&device));
        let loss = mean_squared_error(outputs, self.targets.tensor(batch.indices, &device));
        let gradients = Gradients::backward(&network, loss).clipped(self.run.config.optimizer.gradient_clip);
        let learning_rate = phase.learning_rate(state.phase_steps(phase));
        let record = StepRecord { loss: gradients.loss(), learning_rate, gradient_norm: gradients.norm() };
        if !gradients.are_finite() {
            return Err(self.not_finite(&state, phase, record));
        }
        let network = optimizer.step(network, gradients, learning_rate);
        Ok((Learner { network, optimizer, state }, record))
    }

    /// Computes the metrics on the validation set. Returns `None` if the run was stopped meanwhile.
    fn validate(&self, network: &Network) -> Result<Option<Metrics>> {
        let network = network.valid();
        let device = self.run.device.clone().inner();
        let mut outputs = Vec::new();
        let batches = self.split.validation.chunks(self.run.config.optimizer.batch);
        prefetch(self.examples, batches, |batches| {
            for batch in batches {
                if self.run.is_stopped() {
                    return Ok(None);
                }
                let output = network.forward(batch?.images(&device));
                outputs.extend(output.into_data().iter::<f32>());
            }
            Ok(Some(Metrics::new(&self.targets, &self.split.validation, &outputs)))
        })
    }

    /// Completes an epoch: record, `best`, `last`. In this order a crash in between repeats whatever is missing.
    fn complete(
        &self,
        mut learner: Learner,
        phase: &Phase,
        validation: Metrics,
        journal: &mut Journal,
    ) -> Result<Learner> {
        let state = &mut learner.state;
        let learning_rate = phase.learning_rate(state.phase_steps(phase) - 1);
        if !validation.loss().is_finite() {
            let (loss, gradient_norm) = (validation.loss(), state.gradient_norm);
            return Err(self.not_finite(state, phase, StepRecord { loss, learning_rate, gradient_norm }));
        }
        let record = EpochRecord {
            epoch: state.epoch + 1,
            phase: state.phase + 1,
            steps: state.steps,
            learning_rate,
            training_loss: state.loss_sum / phase.batches as f64,
            gradient_norm: state.gradient_norm,
            validation,
        };
        journal.complete_epoch(&record)?;
        if state.complete_epoch(record, phase) {
            self.snapshot(&learner).save(&self.run.best())?;
        }
        self.save_last(&learner)?;
        Ok(learner)
    }

    /// Returns the contents of a checkpoint, without the training state.
    fn snapshot<'a>(&'a self, learner: &'a Learner) -> Snapshot<'a> {
        let Run { config, device_name, program, .. } = *self.run;
        let InitialWeights { pretrained_sha256, parent } = &self.initial_weights;
        let info = ModelInfo {
            seed: config.seed,
            pretrained_sha256: pretrained_sha256.clone(),
            parent: parent.clone(),
            device: Some(device_name.to_owned()),
            program: program.cloned(),
            epoch: learner.state.last.clone(),
            ..ModelInfo::new(&self.task, self.examples, self.targets.standardization())
        };
        Snapshot { info, config, network: &learner.network, training: None }
    }

    fn save_last(&self, learner: &Learner) -> Result<()> {
        let training = Some((&learner.state, &learner.optimizer));
        Snapshot { training, ..self.snapshot(learner) }.save(&self.run.last())
    }

    /// Saves the state and returns the error that ends the run.
    fn interrupted(&self, learner: &Learner) -> Error {
        let [_, epochs] = learner.state.planned(&self.phases);
        match self.save_last(learner) {
            Ok(()) => {
                Error::Interrupted { epoch: learner.state.epoch + 1, epochs, checkpoint: self.run.last() }
            }
            Err(error) => error,
        }
    }

    fn not_finite(&self, state: &TrainingState, phase: &Phase, record: StepRecord) -> Error {
        Error::NotFinite {
            phase: state.phase,
            epoch: state.epoch + 1,
            batch: (state.batch + 1).min(phase.batches),
            learning_rate: record.learning_rate,
            loss: record.loss,
            gradient_norm: record.gradient_norm,
            checkpoint: Some(self.run.last()).filter(|last| last.exists()),
        }
    }
}
