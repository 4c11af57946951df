//! The published weights: a PyTorch state dictionary of SV-FourierNet, of any size, into a checkpoint and out again.
//!
//! The published network crops one pixel later than ours (from h/2 + 1 - side/2), so its filters are multiplied by the phase of that shift on the way
//! in, and by its inverse on the way out; all else is the same parameter under the same name.

#[cfg(test)]
mod tests;

use super::adam::Adam;
use super::weights::{self, FILTERS};
use super::{Body, Checkpoint, Family, MeanNorms, NetworkConfig, Preset, SensorMaps, TrainError};
use crate::artifact::{ArtifactError, Tensors, write_tensors};
use crate::noise::NoiseModel;
use half::{bf16, f16};
use ndarray::{ArrayD, IxDyn};
use pytorch_reader::{DType, PytorchError, PytorchReader, Tensor};
use rustfft::num_complex::Complex32;
use std::collections::HashMap;
use std::path::Path;
use thiserror::Error;

/// Sizes of the published network where nothing else is said: filter, used part of the frame, object.
const PUBLISHED: (usize, [usize; 2], [usize; 2]) = (4200, [2886, 3500], [2400, 2400]);

/// Parameters that the published module holds and never uses, by name and shape in filters C; a strict loader wants them.
const UNUSED: [&str; 3] = ["deconvolution.conv.weight", "deconvolution.conv.bias", "deconvolution.activation.weight"];

/// Why weights cannot be imported.
#[derive(Debug, Error)]
pub enum PthError {
    /// The file is not PyTorch's.
    #[error("expected a state dictionary as `torch.save` writes it: {0}")]
    File(#[from] PytorchError),
    /// A parameter.
    #[error("parameter `{name}`: expected {expected}, found {found}")]
    Parameter {
        /// Its name.
        name: String,
        /// What was expected.
        expected: String,
        /// What was found.
        found: String,
    },
    /// Sizes that no file holds.
    #[error("the weights do not tell {0}: expected --instrument, or --frame and --object, found neither")]
    Size(&'static str),
    /// The network.
    #[error(transparent)]
    Train(#[from] TrainError),
    /// The file.
    #[error(transparent)]
    Artifact(#[from] ArtifactError),
}

/// What weights do not tell of a network.
#[derive(Clone, Debug)]
pub struct Surroundings {
    /// Frame, rows and columns; None: as published.
    pub frame: Option<[usize; 2]>,
    /// Object, rows and columns; None: as published.
    pub object: Option<[usize; 2]>,
    /// The sensor's noise.
    pub noise: NoiseModel,
    /// The sensor's maps.
    pub maps: SensorMaps,
}

/// The checkpoint of a state dictionary, which may lie deeper in the file: `{"model": state dictionary, ...}`, or of parallel training (`module.`).
///
/// # Errors
/// It is no PyTorch file, a parameter is missing or has a shape that fits no network, or sizes are not told.
pub fn import(path: &Path, around: Surroundings) -> Result<Checkpoint, PthError> {
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
    let network = shape(&tensors, &around)?;
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
    let training = Preset::Paper.training(around.noise.full_scale_e(), 0);
    let body = Body {
        network,
        noise: around.noise,
        training,
        curve: Vec::new(),
        best_step: 0,
        step: 0,
        norms: MeanNorms::default(),
        support: None,
        slowed: 0,
    };
    let adam = Adam::new(&tensors);
    Ok(Checkpoint {
        body,
        weights: tensors.clone(),
        maps: around.maps,
        cases: Vec::new(),
        samples: Vec::new(),
        current: tensors,
        adam,
    })
}

/// Writes the weights of a checkpoint as safetensors that `load_state_dict` of the published module takes.
///
/// # Errors
/// The network is no SV-FourierNet, or the file cannot be written.
pub fn export(checkpoint: &Checkpoint, path: &Path) -> Result<usize, PthError> {
    let network = &checkpoint.body.network;
    if network.family != Family::SvFourierNet {
        let family = network.family.name().as_str().to_string();
        return Err(TrainError::Config { field: "network", expected: "svfouriernet".into(), found: family }.into());
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

/// The values of a tensor.
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

/// The shape of the network, told from the shapes of its parameters.
fn shape(tensors: &Tensors, around: &Surroundings) -> Result<NetworkConfig, PthError> {
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
    let published = t == PUBLISHED.0;
    let frame = around.frame.or(published.then_some(PUBLISHED.1)).ok_or(PthError::Size("the frame"))?;
    let object = around.object.or(published.then_some(PUBLISHED.2)).ok_or(PthError::Size("the object"))?;
    Ok(NetworkConfig {
        frame,
        object,
        filter_size: t,
        channels,
        width,
        groups: (0..256).take_while(|g| has(weights::name::conv(*g, 0, 0))).count(),
        blocks: (0..256).take_while(|b| has(weights::name::conv(0, *b, 0))).count(),
        reduction: width / bottleneck.max(1),
        family: Family::SvFourierNet,
    })
}

/// Moves what the filters give by the pixels between the two crops, times `sign`: `K exp(2 pi i (k_row + k_col) n / T)`.
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
