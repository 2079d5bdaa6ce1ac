//! Import of published weights: a safetensors file of FlowNetS or FlowNetC with the names of the public PyTorch code
//! (`state_dict` of `FlowNetPytorch` or flownet2-pytorch).
//!
//! ```text
//! published           here
//! conv3_1.0.weight    trunk.conv3_1.weight
//! conv3_1.0.bias      trunk.conv3_1.bias
//! ```
//!
//! The published decoder is ignored, and the head starts untrained. The published networks were trained on images that were
//! normalized differently (RGB / 255 minus a mean). Training compensates for that.

use std::path::{Path, PathBuf};

use burn::tensor::{Device, Tensor};
use burn_store::burn_pack;
use burn_store::{ModuleSnapshot, ModuleStore, SafetensorsStore, bridge};
use datagen::digest::digest_of_file;

use crate::error::{Error, Result};
use crate::network::Network;

/// Axes of a published weight `[out, in, kernel, kernel]` in the order used here, `[kernel, kernel, in, out]`.
const AXES: [usize; 4] = [2, 3, 1, 0];

/// Result of an import.
#[derive(Debug, Clone, PartialEq)]
pub struct Imported {
    /// The file.
    pub path: PathBuf,
    /// Its SHA-256.
    pub sha256: String,
    /// Parameters taken from the file.
    pub matched: Vec<String>,
    /// Parameters that are not in the file and keep their initial values.
    pub kept: Vec<String>,
    /// Tensors of the file that the network does not have.
    pub unused: Vec<String>,
    /// Parameters with a different shape in the file, which keep their initial values.
    pub other_shape: Vec<OtherShape>,
}

/// A parameter with a different shape in the file. Shapes are in the published layout, `[out, in, kernel, kernel]`.
#[derive(Debug, Clone, PartialEq)]
pub struct OtherShape {
    /// Its name in the network.
    pub parameter: String,
    /// Shape in the network.
    pub ours: Vec<usize>,
    /// Shape in the file.
    pub theirs: Vec<usize>,
}

/// Replaces parameters of a network's trunk with those in a file. Fails if none match.
pub(crate) fn import(path: &Path, network: &mut Network, device: &Device) -> Result<Imported> {
    let bad = |problem: String| Error::Pretrained { path: path.to_owned(), problem };
    if !path.is_file() {
        return Err(bad("the file does not exist".to_owned()));
    }
    let mut imported = Imported {
        path: path.to_owned(),
        sha256: digest_of_file(path)?,
        matched: Vec::new(),
        kept: Vec::new(),
        unused: Vec::new(),
        other_shape: Vec::new(),
    };
    let parameters = network.collect(None, None, true);
    let mut store = SafetensorsStore::from_file(path);
    let tensors = store.get_all_tensors().map_err(|error| {
        bad(format!(
            "not a safetensors file ({error}); `safetensors.torch.save_file` writes one from a state_dict"
        ))
    })?;
    let mut converted = Vec::new();
    for (name, tensor) in tensors {
        let ours = our_name(name).filter(|ours| !imported.matched.contains(ours));
        let Some(parameter) = parameters.iter().find(|parameter| Some(&parameter.name) == ours.as_ref())
        else {
            imported.unused.push(name.clone());
            continue;
        };
        let (parameter, ours, theirs) =
            (parameter.name.clone(), published(&parameter.shape), tensor.shape.to_vec());
        if ours == theirs {
            let value = ours_of(tensor, parameter.clone(), device);
            converted.push(value.map_err(|error| bad(format!("{name}: {error}")))?);
            imported.matched.push(parameter);
        } else {
            imported.other_shape.push(OtherShape { parameter, ours, theirs });
        }
    }
    let names = parameters.into_iter().map(|parameter| parameter.name);
    let differs = |name: &String| imported.other_shape.iter().any(|other| other.parameter == *name);
    imported.kept = names.filter(|name| !imported.matched.contains(name) && !differs(name)).collect();
    if imported.matched.is_empty() {
        return Err(bad(no_match(&imported)));
    }
    let applied = network.apply(converted, None, None, true);
    applied.errors.first().map_or(Ok(imported), |error| Err(bad(error.to_string())))
}

/// Returns the name of a published parameter in our networks. Prefixes of PyTorch wrappers are ignored.
fn our_name(theirs: &str) -> Option<String> {
    let mut name = theirs;
    while let Some(inner) = ["module.", "state_dict."].iter().find_map(|prefix| name.strip_prefix(prefix)) {
        name = inner;
    }
    let (layer, kind) = name.split_once(".0.")?;
    Some(format!("trunk.{layer}.{kind}"))
}

/// Converts the shape of one of our parameters to the published layout.
fn published(ours: &[usize]) -> Vec<usize> {
    let mut theirs = ours.to_vec();
    if ours.len() == AXES.len() {
        AXES.iter().zip(ours).for_each(|(&axis, &size)| theirs[axis] = size);
    }
    theirs
}

/// Converts a published tensor to one of our parameters.
fn ours_of(
    tensor: &burn_pack::Tensor,
    name: String,
    device: &Device,
) -> Result<burn_pack::Tensor, burn_pack::Error> {
    let data = bridge::to_data(tensor)?.convert::<f32>();
    if data.shape().num_dims() != AXES.len() {
        return Ok(bridge::from_data(data, name, None));
    }
    let weight = Tensor::<4>::from_data(data, device).permute(AXES);
    Ok(bridge::from_data(weight.into_data(), name, None))
}

/// Explains why nothing in a file matches.
fn no_match(imported: &Imported) -> String {
    if let Some(OtherShape { parameter, ours, theirs }) = imported.other_shape.first() {
        return format!(
            "no parameter has the same shape as in the network: {parameter} is {theirs:?} in the file and {ours:?} here; \
             the published networks have network.width = 1.0"
        );
    }
    let found = imported.unused.iter().take(3).cloned().collect::<Vec<_>>().join(", ");
    format!(
        "none of its {} tensors has a known name: expected names like conv3_1.0.weight and conv3_1.0.bias, as in the \
         public PyTorch code, and found [{found}, ...]",
        imported.unused.len()
    )
}

#[cfg(test)]
mod tests {
    use std::fs;
    use std::sync::atomic::{AtomicBool, Ordering};

    use burn::tensor::activation::leaky_relu;
    use burn::tensor::module::conv2d;
    use burn::tensor::ops::ConvOptions;
    use burn::tensor::{TensorData, Tolerance};
    use datagen::Kind;
    use serde_json::{Map, Value, json};

    use super::*;
    use crate::checkpoint::load::Checkpoint;
    use crate::config::TrainConfig;
    use crate::config::tests::tiny;
    use crate::data::examples::tests::squares;
    use crate::network::conv::leaky_conv2d;
    use crate::training::fit::tests::still;
    use crate::training::{Event, Run, fit};

    /// Returns the value of a weight's element.
    fn value(index: usize) -> f32 {
        (index as f32 * 0.7).sin()
    }

    /// Writes a safetensors file: length of the header, header, numbers.
    fn write(path: &Path, tensors: &[(String, Vec<usize>)]) {
        let (mut header, mut numbers) = (Map::new(), Vec::new());
        for (name, shape) in tensors {
            let begin = numbers.len();
            (0..shape.iter().product()).for_each(|index| numbers.extend(value(index).to_le_bytes()));
            let entry = json!({"dtype": "F32", "shape": shape, "data_offsets": [begin, numbers.len()]});
            header.insert(name.clone(), entry);
        }
        let header = Value::Object(header).to_string();
        let length = (header.len() as u64).to_le_bytes();
        fs::write(path, [&length, header.as_bytes(), &numbers].concat()).unwrap();
    }

    /// Returns names and shapes of FlowNetS at the width of [`tiny`], with `first` input channels and one decoder layer.
    fn flownet_s(prefix: &str, first: usize) -> Vec<(String, Vec<usize>)> {
        let layers = ["1", "2", "3", "3_1", "4", "4_1", "5", "5_1", "6", "6_1"];
        let channels = [first, 1, 3, 5, 5, 10, 10, 10, 10, 20, 20];
        let kernels = [7, 5, 5, 3, 3, 3, 3, 3, 3, 3];
        let mut tensors = vec![(format!("{prefix}predict_flow6.weight"), vec![2, 20, 3, 3])];
        for (i, layer) in layers.iter().enumerate() {
            let (outputs, kernel) = (channels[i + 1], kernels[i]);
            tensors
                .push((format!("{prefix}conv{layer}.0.weight"), vec![outputs, channels[i], kernel, kernel]));
            tensors.push((format!("{prefix}conv{layer}.0.bias"), vec![outputs]));
        }
        tensors
    }

    fn network(config: &TrainConfig) -> Network {
        Network::new(config.task().unwrap().architecture(), 1, &Device::flex())
    }

    fn weight(network: &Network, name: &str) -> TensorData {
        let parameters = network.collect(None, None, true);
        bridge::to_data(parameters.iter().find(|parameter| parameter.name == name).unwrap()).unwrap()
    }

    #[test]
    fn an_imported_layer_computes_the_same() {
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join("flownets.safetensors");
        write(&path, &flownet_s("state_dict.module.", 6));
        let device = Device::flex();
        let mut network = network(&tiny(Kind::Approach));
        import(&path, &mut network, &device).unwrap();
        let floats = |shape: &[usize]| {
            TensorData::new((0..shape.iter().product()).map(value).collect::<Vec<f32>>(), shape.to_vec())
        };
        let image = Tensor::<4>::from_data(floats(&[1, 9, 8, 3]), &device);
        let theirs = conv2d(
            image.clone().permute([0, 3, 1, 2]),
            Tensor::from_data(floats(&[5, 3, 5, 5]), &device),
            Some(Tensor::from_data(floats(&[5]), &device)),
            ConvOptions::new([2, 2], [2, 2], [1, 1], 1),
        );
        let ours = ["weight", "bias"].map(|kind| weight(&network, &format!("trunk.conv3.{kind}")));
        let [weight, bias] = ours;
        let (weight, bias) = (Tensor::from_data(weight, &device), Tensor::from_data(bias, &device));
        let ours = leaky_conv2d(image, weight, bias, 2).permute([0, 3, 1, 2]).into_data();
        ours.assert_approx_eq::<f32>(&leaky_relu(theirs, 0.1).into_data(), Tolerance::rel_abs(1e-5, 1e-5));
    }

    #[test]
    fn every_tensor_and_parameter_is_reported() {
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join("flownets.safetensors");
        let mut tensors = flownet_s("module.", 6);
        tensors.retain(|(name, _)| !name.ends_with("conv6_1.0.bias"));
        write(&path, &tensors);
        // The first layer of a network for single images has a different shape.
        let mut network = network(&tiny(Kind::Avoidance));
        let before = weight(&network, "trunk.conv1.weight");
        let found = import(&path, &mut network, &Device::flex()).unwrap();
        assert_eq!(found.sha256, datagen::digest::digest(&fs::read(&path).unwrap()));
        assert_eq!(found.matched.len(), 18);
        assert_eq!(found.unused, ["module.predict_flow6.weight"]);
        let head = ["hidden1", "hidden2", "output"].map(|layer| format!("head.{layer}"));
        let head = head.iter().flat_map(|layer| [format!("{layer}.weight"), format!("{layer}.bias")]);
        assert_eq!(found.kept, [vec!["trunk.conv6_1.bias".to_owned()], head.collect()].concat());
        let (parameter, ours, theirs) = ("trunk.conv1.weight".to_owned(), vec![1, 3, 7, 7], vec![1, 6, 7, 7]);
        assert_eq!(found.other_shape, [OtherShape { parameter, ours, theirs }]);
        assert_eq!(weight(&network, "trunk.conv1.weight"), before);
    }

    #[test]
    fn an_unrelated_file_is_refused() {
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join("weights.safetensors");
        let mut network = network(&tiny(Kind::Approach));
        let mut refused = || import(&path, &mut network, &Device::flex()).unwrap_err().to_string();
        assert!(refused().ends_with("weights.safetensors: the file does not exist"));
        fs::write(&path, "PK").unwrap();
        assert!(refused().contains("not a safetensors file"));
        write(&path, &[("features.0.weight".to_owned(), vec![2, 3])]);
        assert!(refused().contains("expected names like conv3_1.0.weight"));
        write(&path, &[("conv1.0.weight".to_owned(), vec![64, 6, 7, 7])]);
        assert!(refused().contains("trunk.conv1.weight is [64, 6, 7, 7] in the file and [1, 6, 7, 7] here"));
    }

    #[test]
    fn a_run_starts_from_the_file_and_does_not_need_it_again() {
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join("flownets.safetensors");
        write(&path, &flownet_s("", 6));
        let config = TrainConfig { pretrained: Some(path.clone()), ..tiny(Kind::Approach) };
        let (device, run) = (Device::flex(), directory.path().join("run"));
        let examples = squares(&config.task().unwrap(), 32);
        let stop = AtomicBool::new(false);
        let mut imports = 0;
        for resume in [false, true] {
            let run = Run { resume, ..still(&config, &run, &device, &stop) };
            let ended = fit(&run, &examples, &mut |event| match event {
                Event::Imported(imported) => imports += imported.matched.len(),
                _ => stop.store(!resume, Ordering::Relaxed),
            });
            assert_eq!(ended.is_ok(), resume);
            stop.store(false, Ordering::Relaxed);
            let _ = fs::remove_file(&path);
        }
        assert_eq!(imports, 20);
        let info = Checkpoint::load(&run.join("best"), &device).unwrap().info;
        assert_eq!(info.pretrained_sha256.unwrap().len(), 64);
    }
}
