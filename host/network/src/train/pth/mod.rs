//! Import and export of the published weights: a PyTorch state dictionary of SV-FourierNet, of any size.
//!
//! The published network starts its crop one pixel later than ours (at h/2 + 1 - side/2). Import multiplies its filters
//! by the phase of that shift, export by the inverse; all other parameters are the same under the same name.

#[cfg(test)]
mod tests;

use super::weights::{self, FILTERS};
use super::{Architecture, Checkpoint, NetworkConfig, Preset, TrainError};
use half::{bf16, f16};
use ndarray::{ArrayD, IxDyn};
use ommatidia_physics::noise::NoiseModel;
use ommatidia_physics::sensor::SensorMaps;
use ommatidia_session::artifact::{ArtifactError, Tensors, write_tensors};
use pytorch_reader::{DType, PytorchError, PytorchReader, Tensor};
use rustfft::num_complex::Complex32;
use std::collections::HashMap;
use std::path::Path;
use thiserror::Error;

/// Sizes of the published network, pixels: side of its filters, used part of its frames, objects.
const PUBLISHED_FILTER: usize = 4200;
const PUBLISHED_FRAME: [usize; 2] = [2886, 3500];
const PUBLISHED_OBJECT: [usize; 2] = [2400, 2400];

/// Parameters that the published module holds but never uses; strict loading needs them.
const UNUSED: [&str; 3] = ["deconvolution.conv.weight", "deconvolution.conv.bias", "deconvolution.activation.weight"];

/// Why weights cannot be imported.
#[derive(Debug, Error)]
pub enum PthError {
    /// The file is not a PyTorch state dictionary.
    #[error("expected a state dictionary as `torch.save` writes it: {0}")]
    File(#[from] PytorchError),
    /// A parameter is missing, or has a wrong type, shape or value.
    #[error("parameter `{name}`: expected {expected}, found {found}")]
    Parameter {
        /// Name of the parameter.
        name: String,
        /// What was expected.
        expected: String,
        /// What was found.
        found: String,
    },
    /// A size that does not follow from the weights.
    #[error(
        "the size of {0} does not follow from the weights: expected --instrument, or --frame and --object, found \
         neither"
    )]
    Size(&'static str),
    /// The sizes do not describe a network, or the network is not an SV-FourierNet.
    #[error(transparent)]
    Train(#[from] TrainError),
    /// The output could not be written.
    #[error(transparent)]
    Artifact(#[from] ArtifactError),
}

/// Properties of a network's instrument that do not follow from its weights.
#[derive(Clone, Debug)]
pub struct ImportConfig {
    /// Rows and columns of frames; None: as published.
    pub frame: Option<[usize; 2]>,
    /// Rows and columns of objects; None: as published.
    pub object: Option<[usize; 2]>,
    /// Noise of the sensor.
    pub noise: NoiseModel,
    /// Maps of the sensor.
    pub maps: SensorMaps,
}

/// Reads a state dictionary as a checkpoint. It may lie deeper in the file, as in `{"model": state dictionary, ...}`,
/// or come from parallel training (names with the prefix `module.`).
///
/// # Errors
/// The file is not PyTorch's, a parameter is missing or has a shape that fits no network, or a size is unknown.
pub fn import(path: &Path, config: ImportConfig) -> Result<Checkpoint, PthError> {
    let found = PytorchReader::new(path)?.into_tensors();
    let prefix = found.keys().find_map(|name| name.strip_suffix(FILTERS[0])).unwrap_or_default();
    let mut tensors = Tensors::new();
    for (name, tensor) in &found {
        if let Some(name) = name.strip_prefix(prefix)
            && !UNUSED.contains(&name)
        {
            tensors.insert(name.into(), values(tensor)?);
        }
    }
    let network = network_config(&tensors, &config)?;
    network.check()?;
    for (name, shape) in weights::shapes(&network) {
        let found = tensors.get(&name).map_or_else(|| "none".into(), |t| format!("shape {:?}", t.shape()));
        if tensors.get(&name).is_none_or(|t| t.shape() != shape) {
            return Err(PthError::Parameter { name, expected: format!("shape {shape:?}"), found });
        }
    }
    let wanted: Vec<String> = weights::shapes(&network).into_iter().map(|(name, _)| name).collect();
    tensors.retain(|name, _| wanted.contains(name));
    shift(&mut tensors, &network, 1.0);
    let training = Preset::Paper.training(config.noise.full_scale_e(), 0);
    Ok(Checkpoint { maps: config.maps, ..Checkpoint::untrained(network, config.noise, training, tensors) })
}

/// Writes the weights of a checkpoint as safetensors for `load_state_dict` of the published module; returns the number
/// of tensors.
///
/// # Errors
/// The network is not an SV-FourierNet, or the file cannot be written.
pub fn export(checkpoint: &Checkpoint, path: &Path) -> Result<usize, PthError> {
    let network = &checkpoint.body.network;
    if network.architecture != Architecture::SvFourierNet {
        let found = network.architecture.name().as_str().to_string();
        return Err(TrainError::Config { field: "network", expected: "svfouriernet".into(), found }.into());
    }
    let mut tensors = checkpoint.weights.clone();
    shift(&mut tensors, network, -1.0);
    let c = network.channels;
    tensors.insert(UNUSED[0].into(), ArrayD::zeros(IxDyn(&[c, c, 3, 3])));
    tensors.insert(UNUSED[1].into(), ArrayD::zeros(IxDyn(&[c])));
    tensors.insert(UNUSED[2].into(), ArrayD::from_elem(IxDyn(&[1]), 0.25));
    let meta = HashMap::from([("format".to_string(), "pt".to_string())]);
    write_tensors(path, meta, &tensors)?;
    Ok(tensors.len())
}

/// The values of a tensor in single precision.
fn values(tensor: &Tensor) -> Result<ArrayD<f32>, PthError> {
    let wrong = |expected: &str, found: String| PthError::Parameter {
        name: tensor.name.clone(),
        expected: expected.into(),
        found,
    };
    let bytes = tensor.read().map_err(|e| wrong("its values in the file", e.to_string()))?;
    let two = |b: &[u8]| [b[0], b[1]];
    let four = |b: &[u8]| [b[0], b[1], b[2], b[3]];
    let eight = |b: &[u8]| [b[0], b[1], b[2], b[3], b[4], b[5], b[6], b[7]];
    // The reader gives the machine's byte order.
    let values: Vec<f32> = match tensor.dtype() {
        DType::F16 => bytes.chunks_exact(2).map(|b| f16::from_ne_bytes(two(b)).to_f32()).collect(),
        DType::BF16 => bytes.chunks_exact(2).map(|b| bf16::from_ne_bytes(two(b)).to_f32()).collect(),
        DType::F32 => bytes.chunks_exact(4).map(|b| f32::from_ne_bytes(four(b))).collect(),
        DType::F64 => bytes.chunks_exact(8).map(|b| f64::from_ne_bytes(eight(b)) as f32).collect(),
        other => return Err(wrong("floating-point numbers", format!("{other:?}"))),
    };
    match values.iter().find(|v| !v.is_finite()) {
        Some(v) => Err(wrong("finite values", v.to_string())),
        None => Ok(weights::array(tensor.shape(), values)),
    }
}

/// The configuration of the network, from the shapes of its parameters.
fn network_config(tensors: &Tensors, config: &ImportConfig) -> Result<NetworkConfig, PthError> {
    let of = |name: &str, axes: usize| -> Result<&[usize], PthError> {
        let wrong = |found: String| PthError::Parameter { name: name.into(), expected: format!("{axes} axes"), found };
        let shape = tensors.get(name).ok_or_else(|| wrong("none".into()))?.shape();
        if shape.len() == axes { Ok(shape) } else { Err(wrong(format!("shape {shape:?}"))) }
    };
    let filters = of(FILTERS[0], 3)?;
    let width = of(&format!("{}.weight", weights::name::BODY), 4)?[0];
    let bottleneck = of(&format!("{}.weight", weights::name::attention(0, 0, 0)), 4)?[0];
    let has = |name: String| tensors.contains_key(&format!("{name}.weight"));
    let (channels, t) = (filters[0], filters[1]);
    let published = t == PUBLISHED_FILTER;
    let frame = config.frame.or(published.then_some(PUBLISHED_FRAME)).ok_or(PthError::Size("the frame"))?;
    let object = config.object.or(published.then_some(PUBLISHED_OBJECT)).ok_or(PthError::Size("the object"))?;
    Ok(NetworkConfig {
        frame,
        object,
        filter_size: t,
        channels,
        width,
        groups: (0..256).take_while(|g| has(weights::name::conv(*g, 0, 0))).count(),
        blocks: (0..256).take_while(|b| has(weights::name::conv(0, *b, 0))).count(),
        reduction: width / bottleneck.max(1),
        architecture: Architecture::SvFourierNet,
        feedback: None,
    })
}

/// Shifts the output of the filters by the n pixels between the two crops, times `sign`:
/// `K exp(2 pi i (k_row + k_col) n / T)`.
fn shift(tensors: &mut Tensors, network: &NetworkConfig, sign: f64) {
    let (t, bins) = (network.filter_size, network.filter_size / 2 + 1);
    let lag = |side: usize| (t / 2 + 1) as f64 - (side / 2) as f64 - ((t - side) / 2) as f64;
    let [rows, cols] = network.object.map(lag);
    let [Some(mut re), Some(mut im)] = FILTERS.map(|name| tensors.remove(name)) else {
        return;
    };
    for (i, (re, im)) in re.iter_mut().zip(im.iter_mut()).enumerate() {
        let turns = (rows * (i / bins % t) as f64 + cols * (i % bins) as f64) / t as f64;
        let (sin, cos) = (sign * std::f64::consts::TAU * turns.fract()).sin_cos();
        let moved = Complex32::new(*re, *im) * Complex32::new(cos as f32, sin as f32);
        (*re, *im) = (moved.re, moved.im);
    }
    tensors.extend(FILTERS.map(String::from).into_iter().zip([re, im]));
}
