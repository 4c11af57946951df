//! What a noise measurement needs and returns.

use super::bend::Bend;
use super::notes::NoiseNote;
use crate::noise::model::NoiseModel;
use ndarray::Array2;
use serde::{Deserialize, Serialize};

/// Values that a user gives for a session whose darks and flats do not determine them.
///
/// A value that was given is better than an estimate from a specimen or from bead frames. Darks and flats are better
/// than a value that was given.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct NoiseConfig {
    /// Gain, DN per electron. None: estimated where that is possible, else [`NoiseConfig::GAIN_DN_PER_E`].
    pub nominal_gain_dn_per_e: Option<f64>,
    /// Read noise, electrons rms. None: estimated where that is possible, else [`NoiseConfig::READ_NOISE_E`].
    pub nominal_read_noise_e: Option<f64>,
}

impl NoiseConfig {
    /// Gain of a session that does not show it, where none is given, DN per electron.
    pub const GAIN_DN_PER_E: f64 = 1.0;
    /// Read noise of a session that does not show it, where none is given, electrons rms.
    pub const READ_NOISE_E: f64 = 2.0;
}

/// A value and its standard error.
#[derive(Clone, Copy, Debug)]
pub(super) struct Estimate {
    pub value: f64,
    pub sigma: f64,
}

impl Estimate {
    /// Whether a value that was given is the same within three standard errors, or 2 %: what agrees needs no word.
    pub fn agrees_with(&self, given: f64) -> bool {
        (given - self.value).abs() <= (3.0 * self.sigma).max(0.02 * self.value)
    }
}

/// Errors of the pixel maps of a sensor: rms difference between a map and the true pattern; 0 if there is no map.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct MapErrors {
    /// Error of the offsets, DN.
    pub offset_dn: f64,
    /// Relative error of the responses.
    pub response: f64,
    /// Relative error of the variances without light.
    pub reading: f64,
}

/// Measured noise of a sensor.
#[derive(Clone, Debug)]
pub struct NoiseCalibration {
    /// Noise common to all pixels.
    pub model: NoiseModel,
    /// Offset of each pixel from the black level, [sensor rows, sensor cols], DN; `None` without darks.
    pub offset_dn: Option<Array2<f32>>,
    /// Response of each pixel relative to the mean, [sensor rows, sensor cols]; `None` if the flats show no spread
    /// beyond their noise, or without darks (offsets would look like responses).
    pub response: Option<Array2<f32>>,
    /// Variance of each pixel without light, rounding included, [sensor rows, sensor cols], DN^2; `None` if the pixels
    /// do not differ significantly, or if there are too few darks.
    pub reading_dn2: Option<Array2<f32>>,
    /// The bend of the response; `None` if the flats show none, or cannot.
    pub bend: Option<Bend>,
    /// Errors of these maps.
    pub map_errors: MapErrors,
    /// Photon transfer, [level, (mean above black, variance, fitted variance)], DN and DN^2.
    pub photon_transfer: Array2<f32>,
    /// Warnings: values that the session does not determine, and the consequences.
    pub notes: Vec<NoiseNote>,
}

/// Pixels with a read noise above this many times the common one are excluded from foci.
const USELESS: f32 = 5.0;
/// Pixels with a relative response outside this range are excluded from foci.
const ANSWERS: std::ops::Range<f32> = 0.5..2.0;

impl NoiseCalibration {
    /// Pixels to exclude from foci, [sensor rows, sensor cols]: pixels with telegraph noise and hot pixels (read noise
    /// far above the common one), and dead pixels. `None` if there are none.
    pub fn useless(&self) -> Option<Array2<bool>> {
        let common_dn2 = self.model.variance_dn2(self.model.black_level_dn) as f32;
        let noisy = self.reading_dn2.as_ref().map(|map| map.mapv(|v| v > USELESS * USELESS * common_dn2));
        let dead = self.response.as_ref().map(|map| map.mapv(|r| !ANSWERS.contains(&r)));
        let both = match (noisy, dead) {
            (Some(a), Some(b)) => Some(&a | &b),
            (a, b) => a.or(b),
        };
        both.filter(|map| map.iter().any(|useless| *useless))
    }
}
