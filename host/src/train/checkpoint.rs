//! The checkpoint: a trained network, how it came to be, and all that is needed to go on.

use super::adam::{Adam, MeanNorms};
use super::{NetworkConfig, Support, TrainConfig, TrainError, weights};
use crate::artifact::{self, ArtifactError, Header, Provenance, Tensors};
use crate::evaluate::Case;
use crate::forward::ForwardError;
use crate::instrument::Instrument;
use crate::noise::NoiseModel;
use ndarray::{Array2, Array3, ArrayView2, ArrayViewD, Axis, Ix3};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::path::Path;

/// Kind of the artifact.
pub const KIND: &str = "checkpoint";
/// Version of its layout.
pub const VERSION: u32 = 1;

const OFFSET: &str = "sensor.offset_dn";
const GAIN: &str = "sensor.inverse_gain";
const FRAMES: &str = "validation.frames_dn";
const OBJECTS: &str = "validation.objects";
const SAMPLES: &str = "validation.reconstructions";
const CURRENT: &str = "optim.weight.";
const FIRST: &str = "optim.first.";
const SECOND: &str = "optim.second.";

/// One validation. Single precision: what is written as JSON is read as the same bits.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CurvePoint {
    /// Steps taken.
    pub step: u64,
    /// Mean loss of the training steps since the last point.
    pub train_loss: f32,
    /// Mean loss on the held-out pairs.
    pub validation_loss: f32,
    /// Mean peak signal-to-noise ratio on the held-out pairs, dB.
    pub psnr_db: f32,
    /// Mean structural similarity on the held-out pairs.
    pub ssim: f32,
}

/// The small numbers of a checkpoint.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Body {
    /// Shape of the network.
    pub network: NetworkConfig,
    /// Noise of the sensor that it was trained for; black level and saturation are those of its frames.
    pub noise: NoiseModel,
    /// How it was trained.
    pub training: TrainConfig,
    /// Every validation.
    pub curve: Vec<CurvePoint>,
    /// Step whose weights these are: the best at validation.
    pub best_step: u64,
    /// Steps taken.
    pub step: u64,
    /// Lengths of past gradients.
    pub norms: MeanNorms,
    /// The lags that the filters are held to; None: all.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub support: Option<Support>,
    /// Times that the loss was no number and the run went back to its last checkpoint, each time with half the learning rates.
    #[serde(default, skip_serializing_if = "is_zero")]
    pub slowed: u32,
}

fn is_zero(n: &u32) -> bool {
    *n == 0
}

/// Corrections of the sensor that come before the network.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct SensorMaps {
    /// Offset of each pixel relative to the black level, DN.
    pub offset_dn: Option<Array2<f32>>,
    /// Inverse relative gain of each pixel, 1 = nominal.
    pub inverse_gain: Option<Array2<f32>>,
}

impl SensorMaps {
    /// Those of an instrument with its effects.
    ///
    /// # Errors
    /// The parts of the instrument disagree.
    pub fn of(instrument: &Instrument) -> Result<Self, ForwardError> {
        let tables = instrument.sensor_tables()?;
        Ok(Self { offset_dn: tables.offset_dn, inverse_gain: tables.inverse_response })
    }

    /// Corrects light above black, DN, in C order: `(light - offset) * inverse_gain`.
    pub fn correct(&self, light_dn: &mut [f32]) {
        if let Some(offset) = &self.offset_dn {
            light_dn.iter_mut().zip(offset).for_each(|(v, o)| *v -= o);
        }
        if let Some(gain) = &self.inverse_gain {
            light_dn.iter_mut().zip(gain).for_each(|(v, g)| *v *= g);
        }
    }
}

/// A checkpoint in memory.
#[derive(Clone, Debug)]
pub struct Checkpoint {
    /// The small numbers.
    pub body: Body,
    /// The best weights, by the names of the reference implementation's state dictionary.
    pub weights: Tensors,
    /// Maps of the sensor.
    pub maps: SensorMaps,
    /// Held-out frames as the sensor delivers them, with their objects: whoever changes the network can see what it costs.
    pub cases: Vec<Case>,
    /// What the best weights make of the first of these, each at one free scale of its object: for people to look at while it trains.
    pub samples: Vec<Array2<f32>>,
    /// The weights after the last step.
    pub current: Tensors,
    /// The optimiser.
    pub adam: Adam,
}

impl Checkpoint {
    /// Writes it, whole or not at all.
    ///
    /// # Errors
    /// The file cannot be written.
    pub fn write(&self, path: &Path, provenance: Provenance) -> Result<(), ArtifactError> {
        let mut tensors: BTreeMap<String, ArrayViewD<'_, f32>> =
            self.weights.iter().map(|(name, t)| (name.clone(), t.view())).collect();
        // Weights that no step has touched need no optimiser beside them: at the paper's size it is three times their bytes.
        let state = [(CURRENT, &self.current), (FIRST, &self.adam.first), (SECOND, &self.adam.second)];
        for (prefix, of) in state.into_iter().filter(|_| self.body.step > 0) {
            tensors.extend(of.iter().map(|(name, t)| (format!("{prefix}{name}"), t.view())));
        }
        for (name, map) in [(OFFSET, &self.maps.offset_dn), (GAIN, &self.maps.inverse_gain)] {
            if let Some(map) = map {
                tensors.insert(name.into(), map.view().into_dyn());
            }
        }
        let stack = |image: &dyn Fn(&Case) -> ArrayView2<'_, f32>| {
            ndarray::stack(Axis(0), &self.cases.iter().map(image).collect::<Vec<_>>()).map(Array3::into_dyn)
        };
        let stacks = (stack(&|c| c.frame_dn.view()), stack(&|c| c.truth.view()));
        if let (Ok(frames), Ok(objects)) = &stacks {
            tensors.insert(FRAMES.into(), frames.view());
            tensors.insert(OBJECTS.into(), objects.view());
        }
        let samples = ndarray::stack(Axis(0), &self.samples.iter().map(|image| image.view()).collect::<Vec<_>>());
        let samples = samples.map(Array3::into_dyn);
        if let Ok(samples) = &samples {
            tensors.insert(SAMPLES.into(), samples.view());
        }
        let header = Header { kind: KIND.into(), version: VERSION, provenance, body: self.body.clone() };
        artifact::write(path, &header, &tensors)
    }

    /// Reads it.
    ///
    /// # Errors
    /// The file is missing, no checkpoint, cut short, of another version; a tensor is missing, has the wrong shape, or holds values that are
    /// no numbers.
    pub fn read(path: &Path) -> Result<Self, TrainError> {
        let (header, mut tensors) = artifact::read::<Body>(path, KIND, VERSION)?;
        let body = header.body;
        body.network.check()?;
        body.support.as_ref().map_or(Ok(()), |support| support.check(&body.network.fourier()))?;
        let weights = weights::take(path, &body.network, &mut tensors, "")?;
        let (current, first, second) = if body.step > 0 {
            let mut state = |prefix| weights::take(path, &body.network, &mut tensors, prefix);
            (state(CURRENT)?, state(FIRST)?, state(SECOND)?)
        } else {
            let fresh = Adam::new(&weights);
            (weights.clone(), fresh.first, fresh.second)
        };
        let cases = cases(path, &body.network, &mut tensors)?;
        let samples = samples(path, &body.network, &mut tensors)?;
        let shape = body.network.frame.map(Some);
        let mut map = |name: &str| -> Result<Option<Array2<f32>>, ArtifactError> {
            if !tensors.contains_key(name) {
                return Ok(None);
            }
            let map = artifact::take(path, &mut tensors, name, &shape)?;
            Ok(map.into_dimensionality().ok())
        };
        let maps = SensorMaps { offset_dn: map(OFFSET)?, inverse_gain: map(GAIN)? };
        let adam = Adam { steps: body.step, first, second, norms: body.norms };
        Ok(Self { body, weights, maps, cases, samples, current, adam })
    }
}

/// A held-out frame, its object, and what the best weights make of it.
#[derive(Clone, Debug)]
pub struct Sample {
    /// The frame and its object.
    pub case: Case,
    /// The reconstruction, at one free scale of the object.
    pub found: Array2<f32>,
}

impl Sample {
    /// Those that a checkpoint keeps; nothing else of the file is read.
    ///
    /// # Errors
    /// As [`Checkpoint::read`].
    pub fn of(path: &Path) -> Result<Vec<Self>, ArtifactError> {
        let index = artifact::Index::<Body>::open(path, KIND, VERSION)?;
        // Imported weights have none, and runs that have not been judged yet.
        let count = index.shape(SAMPLES).ok().and_then(|shape| shape.first().copied()).unwrap_or(0);
        let image = |name, i| Ok(index.read_entry(name, i)?.into_dimensionality().unwrap_or_default());
        let sample = |i| {
            Ok(Self {
                case: Case { frame_dn: image(FRAMES, i)?, truth: image(OBJECTS, i)? },
                found: image(SAMPLES, i)?,
            })
        };
        (0..count).map(sample).collect()
    }
}

/// The stored reconstructions.
fn samples(path: &Path, network: &NetworkConfig, tensors: &mut Tensors) -> Result<Vec<Array2<f32>>, ArtifactError> {
    if !tensors.contains_key(SAMPLES) {
        return Ok(Vec::new());
    }
    let [rows, cols] = network.object.map(Some);
    let stack = artifact::take(path, tensors, SAMPLES, &[None, rows, cols])?;
    let stack: Array3<f32> = stack.into_dimensionality::<Ix3>().unwrap_or_default();
    Ok(stack.outer_iter().map(|image| image.to_owned()).collect())
}

/// The held-out frames and objects.
fn cases(path: &Path, network: &NetworkConfig, tensors: &mut Tensors) -> Result<Vec<Case>, ArtifactError> {
    // Imported weights have none.
    if !tensors.contains_key(FRAMES) {
        return Ok(Vec::new());
    }
    let mut stack = |name: &str, size: [usize; 2], count: Option<usize>| -> Result<Array3<f32>, ArtifactError> {
        let stack = artifact::take(path, tensors, name, &[count, Some(size[0]), Some(size[1])])?;
        Ok(stack.into_dimensionality::<Ix3>().unwrap_or_default())
    };
    let frames = stack(FRAMES, network.frame, None)?;
    let objects = stack(OBJECTS, network.object, Some(frames.len_of(Axis(0))))?;
    let pairs = frames.outer_iter().zip(objects.outer_iter());
    Ok(pairs.map(|(f, o)| Case { frame_dn: f.to_owned(), truth: o.to_owned() }).collect())
}
