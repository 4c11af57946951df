//! The checkpoint: a trained network, how it came to be, and all that is needed to go on.

use super::adam::{Adam, MeanNorms};
use super::{NetworkConfig, TrainConfig, TrainError, weights};
use crate::artifact::{self, ArtifactError, Header, Provenance, Tensors};
use crate::noise::NoiseModel;
use ndarray::Array2;
use serde::{Deserialize, Serialize};
use std::path::Path;

/// Kind of the artifact.
pub const KIND: &str = "checkpoint";
/// Version of its layout.
pub const VERSION: u32 = 1;

const OFFSET: &str = "sensor.offset_dn";
const GAIN: &str = "sensor.inverse_gain";
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
}

/// Corrections of the sensor that come before the network.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct SensorMaps {
    /// Offset of each pixel relative to the black level, DN.
    pub offset_dn: Option<Array2<f32>>,
    /// Inverse relative gain of each pixel, 1 = nominal.
    pub inverse_gain: Option<Array2<f32>>,
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
        let mut tensors = self.weights.clone();
        for (prefix, of) in [(CURRENT, &self.current), (FIRST, &self.adam.first), (SECOND, &self.adam.second)] {
            tensors.extend(of.iter().map(|(name, t)| (format!("{prefix}{name}"), t.clone())));
        }
        for (name, map) in [(OFFSET, &self.maps.offset_dn), (GAIN, &self.maps.inverse_gain)] {
            if let Some(map) = map {
                tensors.insert(name.into(), map.clone().into_dyn());
            }
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
        let weights = weights::take(path, &body.network, &mut tensors, "")?;
        let current = weights::take(path, &body.network, &mut tensors, CURRENT)?;
        let first = weights::take(path, &body.network, &mut tensors, FIRST)?;
        let second = weights::take(path, &body.network, &mut tensors, SECOND)?;
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
        Ok(Self { body, weights, maps, current, adam })
    }
}
