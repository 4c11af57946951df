//! Least squares with total variation and non-negativity by the alternating direction method of multipliers (ADMM; S.
//! Boyd et al., Found. Trends Mach. Learn. 3, 1 (2011); Yang et al. 2024, section 2E):
//! `min_x 1/2 ||A x - y||^2 + tau TV(x)`, x >= 0.
//!
//! There are two models of A. [`ShiftInvariantAdmm`] uses the PSF of the field's centre everywhere; FFTs solve its
//! linear systems exactly. [`LowRankAdmm`] uses the calibrated low-rank model and its exact transpose; a few steps of
//! conjugate gradients solve its systems approximately, each starting from the last solution. Both treat the edge of
//! the sensor as a boundary of the measurement. A is divided by its norm and y by its maximum, and tau is proportional
//! to the noise, so that one setting serves all frames.

mod low_rank;
mod shift_invariant;
#[cfg(test)]
mod tests;
mod tv;

pub use low_rank::LowRankAdmm;
pub use shift_invariant::ShiftInvariantAdmm;

use crate::forward::Forward;
use crate::instrument::Instrument;
use crate::noise::NoiseModel;
use crate::sensor::{FrameError, FrameInput};
use ndarray::{Array2, ArrayView2};
use serde::{Deserialize, Serialize};

/// Iterations and regularisation of ADMM.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct AdmmConfig {
    /// Maximum number of iterations, at least 1.
    pub iterations: usize,
    /// Iterations end early where one changes x by less than this fraction of its norm.
    pub settled: f64,
    /// Conjugate-gradient steps in each iteration; used by the low-rank model only.
    pub inner: usize,
    /// tau relative to the root mean squared noise of the frame.
    pub tv: f64,
    /// Penalty mu on the distance between the gradients and their shrunk copy, and between x and its non-negative copy;
    /// the norm of A is 1.
    pub penalty: f64,
}

impl AdmmConfig {
    /// Default for the low-rank model. tau was chosen on simulated scenes, never on those that a method is judged on.
    pub fn low_rank() -> Self {
        Self { iterations: 200, settled: 2e-3, inner: 3, tv: 0.1, penalty: 0.01 }
    }

    /// Default for one PSF, where each iteration costs five transforms.
    pub fn shift_invariant() -> Self {
        Self { iterations: 400, settled: 2e-3, inner: 0, tv: 0.03, penalty: 0.01 }
    }

    /// Whether an iteration from `before` to `after` changed x by less than the tolerance `settled`.
    fn has_settled(&self, before: ArrayView2<'_, f32>, after: ArrayView2<'_, f32>) -> bool {
        let square = |v: f32| f64::from(v).powi(2);
        let change = before.iter().zip(after).map(|(b, a)| square(a - b)).sum::<f64>();
        change < self.settled.powi(2) * after.iter().map(|&a| square(a)).sum::<f64>()
    }

    /// Plans the method with the low-rank model of an instrument.
    ///
    /// # Errors
    /// The model cannot be planned, or no light reaches the sensor from any object pixel.
    pub fn build_low_rank(&self, instrument: &Instrument) -> anyhow::Result<LowRankAdmm> {
        LowRankAdmm::new(*self, instrument)
    }

    /// Plans the method with the PSF of the object's centre.
    ///
    /// # Errors
    /// The model cannot be planned, or the PSF holds no light.
    pub fn build_shift_invariant(&self, instrument: &Instrument) -> anyhow::Result<ShiftInvariantAdmm> {
        let grid = &instrument.manifest.object;
        let source = [grid.rows / 2, grid.cols / 2];
        let mut point = Array2::zeros((grid.rows, grid.cols));
        point[source] = 1.0;
        let psf = Forward::new(instrument)?.operator().apply(point.view())?;
        Ok(ShiftInvariantAdmm::new(*self, instrument, psf.view(), source)?)
    }
}

/// A frame in the units of the solvers.
struct Scaled {
    /// Light divided by its maximum.
    y: Array2<f32>,
    /// tau in the units of y.
    tau: f32,
}

/// Checks, corrects and scales a frame; None for a frame without light, whose object is 0.
fn scaled(
    input: &FrameInput,
    noise: &NoiseModel,
    tv: f64,
    frame_dn: ArrayView2<'_, f32>,
) -> Result<Option<Scaled>, FrameError> {
    let light = input.light_dn(frame_dn)?;
    let peak = light.iter().fold(0.0f32, |m, &v| m.max(v));
    if peak <= 0.0 {
        return Ok(None);
    }
    // Mixed Poisson and Gaussian: variance = gain signal + (gain read noise)^2, DN^2.
    let mean = light.iter().map(|&v| f64::from(v.max(0.0))).sum::<f64>() / light.len() as f64;
    let sigma_dn = (noise.gain_dn_per_e * mean + (noise.gain_dn_per_e * noise.read_noise_e).powi(2)).sqrt();
    let tau = (tv * sigma_dn / f64::from(peak)) as f32;
    Ok(Some(Scaled { y: light / peak, tau }))
}
