//! The sensor's noise: mixed Poisson-Gaussian, in DN.
//!
//! A pixel that expects `n` electrons reads `y = black + gain * (Poisson(n) + Normal(0, read_noise))`, rounded to
//! whole DN and clipped to `0..=saturation`, so `var(y) = gain * (E[y] - black) + (gain * read_noise)^2 + 1/12`.

mod draw;
mod measure;
mod stats;

pub use draw::{draw_electrons, draw_poisson};
pub use measure::{MapErrors, NoiseCalibration, NoiseConfig, NoiseError, NoiseNote, ROUNDING_DN2, measure_noise};

use ndarray::Array2;
use serde::{Deserialize, Serialize};

/// Where a figure of the noise model comes from.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Source {
    /// Measured on frames made for it.
    Measured,
    /// Read off other frames (the dark parts of the bead scan): may hold stray light.
    Inferred,
    /// Not measurable on the session: an assumed value.
    #[default]
    Nominal,
}

/// Where each figure of a [`NoiseModel`] comes from.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Sources {
    /// Of the black level.
    pub black_level: Source,
    /// Of the gain.
    pub gain: Source,
    /// Of the read noise.
    pub read_noise: Source,
}

/// Calibrated noise of the sensor.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct NoiseModel {
    /// Mean signal without light, DN.
    pub black_level_dn: f64,
    /// Conversion gain, DN per electron.
    pub gain_dn_per_e: f64,
    /// Standard error of the gain, DN per electron.
    pub gain_sigma: f64,
    /// Read noise, electrons rms, quantization excluded.
    pub read_noise_e: f64,
    /// Standard error of the read noise, electrons.
    pub read_noise_sigma: f64,
    /// The highest code, `2^bit_depth - 1`, DN.
    pub saturation_dn: f64,
    /// Where the figures come from.
    #[serde(default)]
    pub sources: Sources,
}

impl NoiseModel {
    /// Variance, DN^2, of a pixel whose expected value is `expected_dn`: photons, reading and rounding.
    ///
    /// The variance comes from the model, never from the measured counts: weighting by counts biases a mean
    /// (-5 % at 20 electrons).
    pub fn variance_dn2(&self, expected_dn: f64) -> f64 {
        let light = (expected_dn - self.black_level_dn).max(0.0);
        self.gain_dn_per_e * light + (self.gain_dn_per_e * self.read_noise_e).powi(2) + 1.0 / 12.0
    }

    /// Full scale of the converter above the black level, electrons.
    pub fn full_scale_e(&self) -> f64 {
        (self.saturation_dn - self.black_level_dn) / self.gain_dn_per_e
    }
}

/// One over the response of each pixel; 1 where it answers with less than half the mean: a dead pixel has no light to give back.
pub fn inverse_response(response: &Array2<f32>) -> Array2<f32> {
    response.mapv(|r| if r >= 0.5 { 1.0 / r } else { 1.0 })
}
