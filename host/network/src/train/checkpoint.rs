//! The checkpoint: a trained network, its training history, and the state that is needed to continue training.

use super::adam::{Adam, MeanNorms};
use super::{FeatureSteps, FilterMask, Loss, NetworkConfig, TrainConfig, TrainError, weights};
use ndarray::{Array2, Array3, ArrayView2, ArrayViewD, Axis, Ix3};
use ommatidia_model::metrics::Case;
use ommatidia_physics::noise::NoiseModel;
use ommatidia_physics::sensor::{FrameInput, SensorMaps};
use ommatidia_session::artifact::{self, ArtifactError, Header, Provenance, Tensors};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::path::Path;

/// Kind of the artifact.
pub const KIND: &str = "checkpoint";
/// Version of its layout.
pub const VERSION: u32 = 1;

const OFFSET: &str = "sensor.offset_dn";
const GAIN: &str = "sensor.inverse_gain";
pub(super) const FRAMES: &str = "validation.frames_dn";
pub(super) const OBJECTS: &str = "validation.objects";
pub(super) const SAMPLES: &str = "validation.reconstructions";
const CURRENT: &str = "optim.weight.";
const FIRST: &str = "optim.first.";
const SECOND: &str = "optim.second.";

/// Figures of one validation, in single precision so that JSON keeps every bit.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CurvePoint {
    /// Number of steps taken.
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

impl CurvePoint {
    /// Whether weights with these figures are better than those of `other`, for a training with `loss`. The published
    /// loss has its published criterion, a higher SSIM (Yang et al. 2024). The loss that is judged by NRMSE as well has
    /// a lower held-out loss: SSIM of scenes that are mostly dark changes by more with their noise than with training.
    pub fn is_better_than(&self, other: &Self, loss: Loss) -> bool {
        match loss {
            Loss::BceMse => self.ssim > other.ssim,
            Loss::BceMseNrmse => self.validation_loss < other.validation_loss,
        }
    }
}

/// The header of a checkpoint: everything but the tensors.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Body {
    /// Shape of the network.
    pub network: NetworkConfig,
    /// Noise of the sensor that the network was trained for; its black level and saturation apply to the network's
    /// frames.
    pub noise: NoiseModel,
    /// Settings of the training.
    pub training: TrainConfig,
    /// Figures of every validation.
    pub curve: Vec<CurvePoint>,
    /// Step of the best weights ([`CurvePoint::is_better_than`]).
    pub best_step: u64,
    /// Number of steps taken.
    pub step: u64,
    /// Mean lengths of past gradients.
    pub norms: MeanNorms,
    /// Mask of the filters: the lags at which their kernels may differ from 0; None: all.
    #[serde(default, rename = "support", skip_serializing_if = "Option::is_none")]
    pub filter_mask: Option<FilterMask>,
    /// Steps of the features that the network was trained to bear with weights and features of 8 bits; None: it was
    /// trained without roundings.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub feature_steps: Option<FeatureSteps>,
    /// Number of times that the loss diverged and the run went back to its last checkpoint; each time halves the
    /// learning rates.
    #[serde(default, skip_serializing_if = "is_zero")]
    pub slowed: u32,
}

fn is_zero(n: &u32) -> bool {
    *n == 0
}

/// A checkpoint in memory.
#[derive(Clone, Debug)]
pub struct Checkpoint {
    /// Header: shapes, settings, history.
    pub body: Body,
    /// The best weights, by their names in the reference implementation's state dictionary.
    pub weights: Tensors,
    /// Maps of the sensor that frames are corrected with before the network.
    pub maps: SensorMaps,
    /// Held-out raw frames with their objects, for measuring what changes of the network cost.
    pub cases: Vec<Case>,
    /// Reconstructions of the first of these cases by the best weights, each scaled to its object: for people to look
    /// at while the network trains.
    pub samples: Vec<Array2<f32>>,
    /// The weights after the last step.
    pub current: Tensors,
    /// State of the optimiser.
    pub adam: Adam,
}

impl Checkpoint {
    /// A checkpoint before the first step: no history, no sensor maps, no held-out cases.
    pub fn untrained(network: NetworkConfig, noise: NoiseModel, training: TrainConfig, weights: Tensors) -> Self {
        let body = Body {
            network,
            noise,
            training,
            curve: Vec::new(),
            best_step: 0,
            step: 0,
            norms: MeanNorms::default(),
            filter_mask: None,
            feature_steps: None,
            slowed: 0,
        };
        let adam = Adam::new(&weights);
        let maps = SensorMaps::default();
        Self { body, current: weights.clone(), weights, maps, cases: Vec::new(), samples: Vec::new(), adam }
    }

    /// Checks and corrects the raw frames of the network's sensor.
    ///
    /// # Errors
    /// A sensor map has another shape than the network's frames.
    pub fn frame_input(&self) -> Result<FrameInput, TrainError> {
        Ok(FrameInput::new(self.body.noise.black_level_dn, self.maps.clone(), self.body.network.frame)?)
    }

    /// Writes the checkpoint: whole, or not at all.
    ///
    /// # Errors
    /// The file cannot be written.
    pub fn write(&self, path: &Path, provenance: Provenance) -> Result<(), ArtifactError> {
        let mut tensors: BTreeMap<String, ArrayViewD<'_, f32>> =
            self.weights.iter().map(|(name, t)| (name.clone(), t.view())).collect();
        // Before the first step the optimiser holds zeros; it is not written, since it takes three times the bytes of
        // the weights.
        let state = [(CURRENT, &self.current), (FIRST, &self.adam.first), (SECOND, &self.adam.second)];
        for (prefix, of) in state.into_iter().filter(|_| self.body.step > 0) {
            tensors.extend(of.iter().map(|(name, t)| (format!("{prefix}{name}"), t.view())));
        }
        for (name, map) in [(OFFSET, &self.maps.offset_dn), (GAIN, &self.maps.inverse_response)] {
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

    /// Reads the checkpoint at `path`.
    ///
    /// # Errors
    /// The file is missing, cut short, not a checkpoint, or of another version; a tensor is missing, has the wrong
    /// shape, or holds values that are not finite.
    pub fn read(path: &Path) -> Result<Self, TrainError> {
        let (header, mut tensors) = artifact::read::<Body>(path, KIND, VERSION)?;
        let body = header.body;
        body.network.check()?;
        body.filter_mask.as_ref().map_or(Ok(()), |mask| mask.check(&body.network.fourier()))?;
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
        let maps = SensorMaps { offset_dn: map(OFFSET)?, inverse_response: map(GAIN)?, unusable: None };
        let adam = Adam { steps: body.step, first, second, norms: body.norms };
        Ok(Self { body, weights, maps, cases, samples, current, adam })
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

/// The stored held-out frames and objects.
fn cases(path: &Path, network: &NetworkConfig, tensors: &mut Tensors) -> Result<Vec<Case>, ArtifactError> {
    // Imported weights have no cases.
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
