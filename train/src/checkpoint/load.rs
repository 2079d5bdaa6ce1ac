//! Reading a checkpoint.

use std::path::{Path, PathBuf};

use burn::tensor::Device;
use burn_store::ModuleSnapshot;

use super::files::{MODEL, WEIGHTS, invalid, store};
use super::model_info::ModelInfo;
use crate::error::Result;
use crate::network::Network;

/// A network that was read from a checkpoint.
#[derive(Debug)]
pub struct Checkpoint {
    /// Folder of the checkpoint.
    pub directory: PathBuf,
    /// Contents of `model.json`.
    pub info: ModelInfo,
    /// The network with its weights.
    pub network: Network,
}

impl Checkpoint {
    /// Reads a checkpoint. Errors name the file that is missing, damaged, or of another format or architecture.
    pub fn load(directory: &Path, device: &Device) -> Result<Self> {
        let info = ModelInfo::verified(directory)?;
        let path = directory.join(WEIGHTS);
        let mut network = Network::new(info.task.architecture(), 0, device);
        let problem = match network.load_from(&mut store(&path)) {
            Ok(applied) if applied.unused.is_empty() => None,
            Ok(applied) => Some(format!("the network has no parameters {:?}", applied.unused)),
            Err(error) => Some(error.to_string()),
        };
        if let Some(problem) = problem {
            let problem = format!("its weights do not belong to the network in {MODEL}: {problem}");
            return Err(invalid(&path, &problem));
        }
        Ok(Self { directory: directory.to_owned(), info, network })
    }
}
