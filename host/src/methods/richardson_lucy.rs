//! Richardson-Lucy deconvolution with the whole spatially varying model: the maximum of the Poisson likelihood over
//! objects >= 0.
//!
//! `x <- x . A'(y / (A x + b)) / A'1` (W. H. Richardson, J. Opt. Soc. Am. 62, 55 (1972); L. B. Lucy, Astron. J. 79, 745
//! (1974)), stopped early, which regularises it. Read noise enters as a constant background `b` on both sides: it gives
//! a Poisson variable the variance of the mixed Poisson and Gaussian one (D. L. Snyder et al., J. Opt. Soc. Am. A 10,
//! 1014 (1993)). The method uses every PSF that the networks were trained with, and needs many passes over the model
//! for each frame.

use super::frame::frame_input;
use super::{MethodError, Reconstruct};
use crate::forward::Forward;
use crate::instrument::Instrument;
use crate::psf::LowRankOperator;
use crate::sensor::FrameInput;
use ndarray::{Array2, ArrayView2, Zip};
use serde::{Deserialize, Serialize};

/// Settings of the Richardson-Lucy method.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RichardsonLucyConfig {
    /// Number of iterations, at least 1.
    pub iterations: usize,
}

impl Default for RichardsonLucyConfig {
    fn default() -> Self {
        Self { iterations: 40 }
    }
}

impl RichardsonLucyConfig {
    /// Plans the method for an instrument. The model is the instrument's optics, without its effects.
    ///
    /// # Errors
    /// The instrument's model cannot be planned, or no light reaches the sensor from any object pixel.
    pub fn build(&self, instrument: &Instrument) -> anyhow::Result<RichardsonLucy> {
        let operator = Forward::new(instrument)?.operator().clone();
        let sensitivity = operator.adjoint(Array2::ones(operator.sensor_shape()).view())?;
        let noise = &instrument.noise;
        if !sensitivity.iter().any(|&v| v > 0.0) {
            return Err(MethodError::NoLens.into());
        }
        Ok(RichardsonLucy {
            input: frame_input(instrument)?,
            operator,
            sensitivity,
            // A variable of variance gain * signal + (gain * read noise)^2 is, up to the gain, Poisson distributed with
            // mean signal + gain * read noise^2.
            background_dn: (noise.gain_dn_per_e * noise.read_noise_e.powi(2)).max(1e-3) as f32,
            iterations: self.iterations.max(1),
        })
    }
}

/// The planned method.
#[derive(Clone, Debug)]
pub struct RichardsonLucy {
    input: FrameInput,
    operator: LowRankOperator,
    /// A'1: light that the sensor receives from each object pixel, DN per unit.
    sensitivity: Array2<f32>,
    background_dn: f32,
    iterations: usize,
}

impl RichardsonLucy {
    /// One iteration on `x`, in place; `y` is the measured light plus the background, DN.
    fn step(&self, y: &Array2<f32>, x: &mut Array2<f32>) -> anyhow::Result<()> {
        let mut ratio = self.operator.apply(x.view())?;
        // The truncated basis can give slightly negative light; the background keeps the quotient finite.
        Zip::from(&mut ratio).and(y).for_each(|r, &y| *r = y / (r.max(0.0) + self.background_dn));
        let back = self.operator.adjoint(ratio.view())?;
        Zip::from(x).and(&back).and(&self.sensitivity).for_each(|x, &b, &s| {
            *x = if s > 0.0 { *x * (b / s).max(0.0) } else { 0.0 };
        });
        Ok(())
    }
}

impl Reconstruct for RichardsonLucy {
    fn name(&self) -> &str {
        "richardson-lucy"
    }

    fn reconstruct(&self, frame_dn: ArrayView2<'_, f32>) -> anyhow::Result<Array2<f32>> {
        let y = self.input.light_dn(frame_dn)?.mapv(|v| (v + self.background_dn).max(0.0));
        let light: f64 = y.iter().map(|&v| f64::from(v)).sum();
        let sensitivity: f64 = self.sensitivity.iter().map(|&v| f64::from(v.max(0.0))).sum();
        let even = (light / sensitivity).max(f64::from(f32::MIN_POSITIVE)) as f32;
        let mut x = Array2::from_elem(self.sensitivity.dim(), even);
        for _ in 0..self.iterations {
            self.step(&y, &mut x)?;
        }
        Ok(x)
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use crate::metrics::compare;
    use crate::testing::square_array as instrument;

    fn object() -> Array2<f32> {
        Array2::from_shape_fn((20, 20), |(r, c)| if (r * 7 + c * 3) % 11 == 0 { 100.0 } else { 2.0 })
    }

    /// Each focus is blurred by a kernel whose transfer function is at least 0.6, so no frequency is lost.
    fn blurred() -> Instrument {
        let mut instrument = instrument(3, [60, 60], [20, 20]);
        for lens in 0..9 {
            for (i, v) in [0.05f32, 0.1, 0.05, 0.1, 0.8, 0.1, 0.05, 0.1, 0.05].into_iter().enumerate() {
                instrument.psf.basis[[lens, 0, i / 3, i % 3]] = v;
            }
        }
        instrument
    }

    /// Poisson log-likelihood of `y` given the mean `A x + b`, without terms that do not depend on x.
    fn likelihood(method: &RichardsonLucy, y: &Array2<f32>, x: &Array2<f32>) -> f64 {
        let model = method.operator.apply(x.view()).unwrap() + method.background_dn;
        y.iter().zip(&model).map(|(&y, &m)| f64::from(y) * f64::from(m).ln() - f64::from(m)).sum()
    }

    #[test]
    fn each_step_raises_the_likelihood() {
        let instrument = blurred();
        let method = RichardsonLucyConfig::default().build(&instrument).unwrap();
        let y = method.operator.apply(object().view()).unwrap() + method.background_dn;
        let mut x = Array2::from_elem((20, 20), 10.0f32);
        let mut before = likelihood(&method, &y, &x);
        for _ in 0..10 {
            method.step(&y, &mut x).unwrap();
            let after = likelihood(&method, &y, &x);
            assert!(after > before, "{after} {before}");
            before = after;
        }
    }

    #[test]
    fn it_undoes_blur_and_overlap() {
        let instrument = blurred();
        let frame = Forward::new(&instrument).unwrap().operator().apply(object().view()).unwrap() + 64.0;
        let judge = |iterations| {
            let method = RichardsonLucyConfig { iterations }.build(&instrument).unwrap();
            compare(method.reconstruct(frame.view()).unwrap().view(), object().view()).unwrap().nrmse
        };
        let (few, many) = (judge(2), judge(200));
        assert!(many < 0.05 && many < 0.2 * few, "{few} {many}");
    }

    #[test]
    fn a_dark_frame_gives_a_dark_object() {
        let method = RichardsonLucyConfig::default().build(&blurred()).unwrap();
        let dark = method.reconstruct(Array2::from_elem((60, 60), 0.0).view()).unwrap();
        assert!(dark.iter().all(|v| v.is_finite() && *v >= 0.0 && *v < 1e-3));
    }
}
