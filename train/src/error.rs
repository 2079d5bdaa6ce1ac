//! What can go wrong in training, and with what training leaves behind.

use std::path::PathBuf;

use datagen::Kind;

use crate::net::BadNetwork;

/// An error of this crate.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// A value of the training configuration that makes no training.
    #[error("{key} = {value}: expected {expected}")]
    Config {
        /// Key, dotted.
        key: &'static str,
        /// What it says.
        value: String,
        /// What it may say.
        expected: &'static str,
    },
    /// A value of a phase that makes no training.
    #[error("phases.{index}.{key} = {value}: expected {expected}")]
    Phase {
        /// Number of the phase, from 0.
        index: usize,
        /// Key of the phase.
        key: &'static str,
        /// What it says.
        value: String,
        /// What it may say.
        expected: &'static str,
    },
    /// A key that this kind of network needs, or that means nothing to it.
    #[error("network.{key}: {problem} for kind = \"{kind}\"")]
    KeyOfKind {
        /// Key below `network`.
        key: &'static str,
        /// Missing or meaningless.
        problem: &'static str,
        /// What is trained.
        kind: Kind,
    },
    /// A network that cannot be built.
    #[error("network.{0}")]
    Network(#[from] BadNetwork),
    /// A dataset that cannot be read.
    #[error(transparent)]
    Dataset(#[from] datagen::Error),
    /// Two datasets that one network cannot learn from.
    #[error(
        "datasets {} and {} differ in their camera ({key}: {first_value} and {second_value}); \
         one network learns one camera", first.display(), second.display()
    )]
    CamerasDiffer {
        /// One dataset.
        first: PathBuf,
        /// The other.
        second: PathBuf,
        /// What differs.
        key: &'static str,
        /// The one's.
        first_value: f64,
        /// The other's.
        second_value: f64,
    },
    /// A row that cannot be learned from.
    #[error("dataset {}, row {row}: {problem}", path.display())]
    Row {
        /// Directory of the dataset.
        path: PathBuf,
        /// Number of the row within the dataset.
        row: usize,
        /// What is wrong with it.
        problem: String,
    },
    /// Decoded images that cannot be written.
    #[error(
        "{}: {source}; the decoded images of the dataset take {} MB there", path.display(),
        bytes.div_ceil(1_000_000)
    )]
    Cache {
        /// File that was to be.
        path: PathBuf,
        /// Its size.
        bytes: u64,
        /// Why.
        source: std::io::Error,
    },
    /// An image that the network's input cannot be made of.
    #[error(
        "an image of {}x{} pixels cannot become a network input of {}x{}: it must have the same aspect ratio and be \
         at least as large", image[0], image[1], input[0], input[1]
    )]
    ImageSize {
        /// Width and height of the image.
        image: [usize; 2],
        /// Width and height of the input.
        input: [usize; 2],
    },
    /// Too few examples to train and to validate.
    #[error("{found} examples in all datasets: training and validation need at least {needed}")]
    TooFewExamples {
        /// How many there are.
        found: usize,
        /// How many there must be.
        needed: usize,
    },
    /// Labels that are not numbers.
    #[error(
        "a label of the training examples is not finite; check the datasets with `flowservo dataset verify`"
    )]
    LabelsNotFinite,
    /// Training diverged.
    #[error(
        "the loss is {loss} and the norm of the gradient {gradient_norm} in epoch {epoch}, batch {batch}, at learning \
         rate {learning_rate:.3e}; {}; try a smaller phases.{phase}.learning_rate", last_good(checkpoint.as_ref())
    )]
    NotFinite {
        /// Number of the phase, from 0.
        phase: usize,
        /// Epoch, from 1.
        epoch: usize,
        /// Batch within the epoch, from 1.
        batch: usize,
        /// Learning rate of the step that was not taken.
        learning_rate: f64,
        /// Loss of the batch.
        loss: f64,
        /// Norm of the gradient over all parameters.
        gradient_norm: f64,
        /// The last checkpoint, if there is one.
        checkpoint: Option<PathBuf>,
    },
    /// Stopped by the user; everything is saved.
    #[error(
        "interrupted in epoch {epoch} of {epochs}; the state is saved in {}, and --resume continues exactly there",
        checkpoint.display()
    )]
    Interrupted {
        /// Epoch, from 1.
        epoch: usize,
        /// Epochs of the whole run.
        epochs: usize,
        /// The saved state.
        checkpoint: PathBuf,
    },
    /// A new run would overwrite another.
    #[error("{} already holds a run: continue it with --resume, or choose another directory", directory.display())]
    RunExists {
        /// Directory of the run.
        directory: PathBuf,
    },
    /// Nothing to continue.
    #[error("{} holds no run to resume (no \"last\" in it): start it without --resume", directory.display())]
    NothingToResume {
        /// Directory of the run.
        directory: PathBuf,
    },
    /// The run that is to be continued is another one.
    #[error(
        "{} was trained with {key} = {was}, and now it is {is}: resume with the same configuration and datasets, or \
         choose another directory", directory.display()
    )]
    OtherRun {
        /// Directory of the run.
        directory: PathBuf,
        /// What differs, dotted.
        key: String,
        /// In the run.
        was: String,
        /// Now.
        is: String,
    },
    /// A file of published weights that a network cannot begin from.
    #[error("pretrained weights {}: {problem}", path.display())]
    Pretrained {
        /// The file.
        path: PathBuf,
        /// What is wrong with it.
        problem: String,
    },
    /// A model that learned something else than the run that is to begin from it.
    #[error(
        "{model} has {key} = {was}, and this configuration has {is}: a run begins from a model of the same network with \
         the same outputs"
    )]
    OtherTask {
        /// The model.
        model: String,
        /// What differs, dotted.
        key: String,
        /// In the model.
        was: String,
        /// In the configuration.
        is: String,
    },
    /// A file or directory that cannot be read or written.
    #[error("{}: {source}", path.display())]
    Io {
        /// Which.
        path: PathBuf,
        /// Why.
        source: std::io::Error,
    },
    /// A file of a checkpoint that is not what it should be.
    #[error("checkpoint file {}: {problem}", path.display())]
    Checkpoint {
        /// Which.
        path: PathBuf,
        /// What is wrong with it.
        problem: String,
    },
    /// A file of a checkpoint that was changed or damaged.
    #[error("checkpoint file {} is damaged: its SHA-256 is {found}, recorded was {expected}", path.display())]
    Digest {
        /// Which.
        path: PathBuf,
        /// What was recorded.
        expected: String,
        /// What it is.
        found: String,
    },
    /// A checkpoint of the other network.
    #[error("checkpoint {} is one of kind \"{found}\", and \"{expected}\" is needed", path.display())]
    OtherKind {
        /// Directory of the checkpoint.
        path: PathBuf,
        /// What it holds.
        found: Kind,
        /// What was asked for.
        expected: Kind,
    },
    /// A checkpoint trained for another camera.
    #[error("checkpoint {} was trained for a camera with {key} = {trained}, and this one has {found}", path.display())]
    OtherCamera {
        /// Directory of the checkpoint.
        path: PathBuf,
        /// What differs.
        key: &'static str,
        /// The camera it was trained for.
        trained: f64,
        /// The camera it is used with.
        found: f64,
    },
}

fn last_good(checkpoint: Option<&PathBuf>) -> String {
    match checkpoint {
        Some(path) => format!("the last good state is in {}", path.display()),
        None => "no checkpoint was written yet".to_owned(),
    }
}

/// Result of this crate.
pub type Result<T, E = Error> = std::result::Result<T, E>;
