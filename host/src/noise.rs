//! The sensor's noise: mixed Poisson-Gaussian, in DN.
//!
//! A pixel that expects `n` electrons reads `y = black + gain * (Poisson(n) + Normal(0, read_noise))`, rounded to
//! whole DN and clipped to `0..=saturation`, so `var(y) = gain * (E[y] - black) + (gain * read_noise)^2 + 1/12`.

use serde::{Deserialize, Serialize};

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
}
