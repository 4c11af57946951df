//! Least squares with total variation and non-negativity by ADMM (paper, section 2E; S. Boyd et al., Found. Trends Mach. Learn. 3, 1 (2011)):
//! `min_x 1/2 ||A x - y||^2 + tau TV(x)`, x >= 0.
//!
//! Two models of A: the PSF of the field's centre everywhere, whose linear systems FFTs solve exactly, and the calibrated low-rank model with its exact
//! transpose, whose systems conjugate gradients solve in part, each from where the last one ended. Both know the sensor's edge.
//! In both, A is divided by its norm and y by its maximum, and tau follows the noise, so that one setting serves all frames.

mod low_rank;
mod shift_invariant;
#[cfg(test)]
mod tests;
mod tv;

pub use low_rank::LowRankAdmm;
pub use shift_invariant::ShiftInvariantAdmm;

use super::MethodError;
use super::frame::FrameCorrection;
use crate::forward::Forward;
use crate::instrument::Instrument;
use crate::noise::NoiseModel;
use ndarray::{Array2, ArrayView2};
use serde::{Deserialize, Serialize};

/// How to iterate and how strongly to regularise.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct AdmmConfig {
    /// Most iterations, at least 1.
    pub iterations: usize,
    /// It ends early where an iteration changes x by less than this part of its length.
    pub settled: f64,
    /// Steps of conjugate gradients in each, for the low-rank model.
    pub inner: usize,
    /// tau over the frame's root mean squared noise.
    pub tv: f64,
    /// Penalty on the distance between the gradients and their shrunk copy, and between x and its non-negative copy; the norm of A is 1.
    pub penalty: f64,
}

impl AdmmConfig {
    /// For the low-rank model. tau was chosen on simulated scenes, never on those that a method is judged on.
    pub fn low_rank() -> Self {
        Self { iterations: 200, settled: 2e-3, inner: 3, tv: 0.1, penalty: 0.01 }
    }

    /// For one PSF: each iteration costs five transforms.
    pub fn shift_invariant() -> Self {
        Self { iterations: 400, settled: 2e-3, inner: 0, tv: 0.03, penalty: 0.01 }
    }

    /// Whether an iteration from `before` to `after` has changed next to nothing.
    fn has_settled(&self, before: ArrayView2<'_, f32>, after: ArrayView2<'_, f32>) -> bool {
        let square = |v: f32| f64::from(v).powi(2);
        let change = before.iter().zip(after).map(|(b, a)| square(a - b)).sum::<f64>();
        change < self.settled.powi(2) * after.iter().map(|&a| square(a)).sum::<f64>()
    }

    /// Plans the method with the low-rank model of an instrument.
    ///
    /// # Errors
    /// The model cannot be planned, or no light reaches the sensor from anywhere.
    pub fn build_low_rank(&self, instrument: &Instrument) -> anyhow::Result<LowRankAdmm> {
        LowRankAdmm::new(*self, instrument)
    }

    /// Plans the method with the PSF of the object's centre.
    ///
    /// # Errors
    /// The model cannot be planned, or the PSF is dark.
    pub fn build_shift_invariant(&self, instrument: &Instrument) -> anyhow::Result<ShiftInvariantAdmm> {
        let grid = &instrument.manifest.object;
        let source = (grid.rows / 2, grid.cols / 2);
        let mut point = Array2::zeros((grid.rows, grid.cols));
        point[source] = 1.0;
        let psf = Forward::new(instrument)?.operator().apply(point.view())?;
        Ok(ShiftInvariantAdmm::new(*self, instrument, psf.view(), source)?)
    }
}

/// A frame as the solvers want it.
struct Scaled {
    /// Light, divided by its maximum.
    y: Array2<f32>,
    /// tau in the units of y.
    tau: f32,
}

/// Checks, corrects and scales a frame; None for a dark one, whose object is dark.
fn scaled(
    correction: &FrameCorrection,
    noise: &NoiseModel,
    tv: f64,
    frame_dn: ArrayView2<'_, f32>,
) -> Result<Option<Scaled>, MethodError> {
    let light = correction.light_dn(frame_dn)?;
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
