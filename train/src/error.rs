//! Errors of training and of checkpoints.

use std::path::{Path, PathBuf};

use datagen::Kind;

/// An error of this crate.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// An invalid value in the training configuration.
    #[error("{key} = {value}: expected {expected}")]
    Config {
        /// Dotted key.
        key: &'static str,
        /// Its value.
        value: String,
        /// Valid values.
        expected: &'static str,
    },
    /// An invalid value in a phase.
    #[error("phases.{index}.{key} = {value}: expected {expected}")]
    Phase {
        /// Index of the phase, from 0.
        index: usize,
        /// Key of the phase.
        key: &'static str,
        /// Its value.
        value: String,
        /// Valid values.
        expected: &'static str,
    },
    /// A key that this kind of network requires or does not have.
    #[error("network.{key}: {problem} for kind = \"{kind}\"")]
    KeyOfKind {
        /// Key below `network`.
        key: &'static str,
        /// The problem: missing, or not supported.
        problem: &'static str,
        /// Kind of the network.
        kind: Kind,
    },
    /// A network that cannot be built.
    #[error("network.{0}")]
    Network(#[from] InvalidNetwork),
    /// A dataset that cannot be read.
    #[error(transparent)]
    Dataset(#[from] datagen::Error),
    /// Datasets with different cameras.
    #[error(
        "datasets {} and {} have different cameras ({key}: {first_value} and {second_value}); a network is trained for \
         one camera", first.display(), second.display()
    )]
    CamerasDiffer {
        /// One dataset.
        first: PathBuf,
        /// The other dataset.
        second: PathBuf,
        /// Property that differs.
        key: &'static str,
        /// Value in the first dataset.
        first_value: f64,
        /// Value in the second dataset.
        second_value: f64,
    },
    /// An unusable row of a dataset.
    #[error("dataset {}, row {row}: {problem}", path.display())]
    Row {
        /// Folder of the dataset.
        path: PathBuf,
        /// Index of the row in the dataset.
        row: usize,
        /// The problem.
        problem: String,
    },
    /// An image cache that cannot be written.
    #[error("{}: {source}; the decoded images of the dataset need {} MB", path.display(), bytes.div_ceil(1_000_000))]
    Cache {
        /// The cache file.
        path: PathBuf,
        /// Its size.
        bytes: u64,
        /// The cause.
        source: std::io::Error,
    },
    /// An image that does not fit the network's input.
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
    /// Too few examples for training and validation.
    #[error("{found} examples in all datasets: training and validation need at least {needed}")]
    TooFewExamples {
        /// Number of examples.
        found: usize,
        /// Minimum number of examples.
        needed: usize,
    },
    /// A label that is not finite.
    #[error(
        "a label of the training examples is not finite; check the datasets with `flowservo dataset verify`"
    )]
    LabelsNotFinite,
    /// Divergence: a loss or a gradient that is not finite.
    #[error(
        "the loss is {loss} and the norm of the gradient {gradient_norm} in epoch {epoch}, batch {batch}, at learning \
         rate {learning_rate:.3e}; {}; try a smaller phases.{phase}.learning_rate", last_good(checkpoint.as_ref())
    )]
    NotFinite {
        /// Index of the phase, from 0.
        phase: usize,
        /// Epoch, from 1.
        epoch: usize,
        /// Batch within the epoch, from 1.
        batch: usize,
        /// Learning rate of the step, which was not taken.
        learning_rate: f64,
        /// Loss of the batch.
        loss: f64,
        /// Norm of the gradient over all parameters.
        gradient_norm: f64,
        /// The last checkpoint, if there is one.
        checkpoint: Option<PathBuf>,
    },
    /// Stopped by the user, with everything saved.
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
    /// A new run in the folder of another one.
    #[error("{} already contains a run: continue it with --resume, or choose another folder", directory.display())]
    RunExists {
        /// Folder of the run.
        directory: PathBuf,
    },
    /// No run to resume.
    #[error("{} contains no run to resume (no folder `last`): start one without --resume", directory.display())]
    NothingToResume {
        /// Folder of the run.
        directory: PathBuf,
    },
    /// A run with a different configuration or different data than the one to resume.
    #[error(
        "{} was trained with {key} = {was}, but now it is {is}: resume with the same configuration and datasets, or \
         choose another folder", directory.display()
    )]
    OtherRun {
        /// Folder of the run.
        directory: PathBuf,
        /// Dotted key that differs.
        key: String,
        /// Value in the run.
        was: String,
        /// Value now.
        is: String,
    },
    /// Published weights that cannot be imported.
    #[error("pretrained weights {}: {problem}", path.display())]
    Pretrained {
        /// The file.
        path: PathBuf,
        /// The problem.
        problem: String,
    },
    /// A parent model with a different task.
    #[error(
        "{model} has {key} = {was}, but this configuration has {is}: a warm start needs a model with the same network \
         and the same outputs"
    )]
    OtherTask {
        /// The model.
        model: String,
        /// Dotted key that differs.
        key: String,
        /// Value in the model.
        was: String,
        /// Value in the configuration.
        is: String,
    },
    /// A file or folder that cannot be read or written.
    #[error("{}: {source}", path.display())]
    Io {
        /// The file or folder.
        path: PathBuf,
        /// The cause.
        source: std::io::Error,
    },
    /// An invalid file in a checkpoint.
    #[error("checkpoint file {}: {problem}", path.display())]
    Checkpoint {
        /// The file.
        path: PathBuf,
        /// The problem.
        problem: String,
    },
    /// A changed or damaged file in a checkpoint.
    #[error("checkpoint file {} is damaged: its SHA-256 is {found}, but {expected} was recorded", path.display())]
    Digest {
        /// The file.
        path: PathBuf,
        /// Recorded digest.
        expected: String,
        /// Actual digest.
        found: String,
    },
    /// A checkpoint of the other kind of network.
    #[error("checkpoint {} is of kind \"{found}\", but \"{expected}\" is needed", path.display())]
    OtherKind {
        /// Folder of the checkpoint.
        path: PathBuf,
        /// Kind of the checkpoint.
        found: Kind,
        /// Requested kind.
        expected: Kind,
    },
    /// A checkpoint trained for a different camera.
    #[error("checkpoint {} was trained for a camera with {key} = {trained}, but this camera has {found}", path.display())]
    OtherCamera {
        /// Folder of the checkpoint.
        path: PathBuf,
        /// Property that differs.
        key: &'static str,
        /// Value of the camera it was trained for.
        trained: f64,
        /// Value of the camera it is used with.
        found: f64,
    },
}

/// An invalid value in the configuration of a network.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[error("{key} = {value}: expected {expected}")]
pub struct InvalidNetwork {
    /// Key below `network`.
    pub key: &'static str,
    /// Its value.
    pub value: String,
    /// Valid values.
    pub expected: &'static str,
}

fn last_good(checkpoint: Option<&PathBuf>) -> String {
    match checkpoint {
        Some(path) => format!("the last good state is in {}", path.display()),
        None => "no checkpoint was written yet".to_owned(),
    }
}

/// Adds the path to an error of the file system.
pub(crate) fn at(path: &Path) -> impl FnOnce(std::io::Error) -> Error + '_ {
    |source| Error::Io { path: path.to_owned(), source }
}

/// Result of this crate.
pub type Result<T, E = Error> = std::result::Result<T, E>;
