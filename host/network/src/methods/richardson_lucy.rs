//! Richardson-Lucy deconvolution with the whole spatially varying model.
//!
//! The iterations ([`ommatidia_model::richardson_lucy`]) are stopped early, which regularises them. The method uses every PSF
//! that the networks were trained with, and needs many passes over the model for each frame.

use super::frame::frame_input;
use super::{MethodError, Reconstruct};
use ndarray::{Array2, ArrayView2};
use ommatidia_model::forward::Forward;
use ommatidia_model::instrument::Instrument;
use ommatidia_model::richardson_lucy::RichardsonLucy as Iterations;
use ommatidia_physics::sensor::FrameInput;
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
        let solver = Iterations::new(Forward::new(instrument)?.operator().clone(), &instrument.noise)?;
        if !solver.sees() {
            return Err(MethodError::NoLens.into());
        }
        Ok(RichardsonLucy { input: frame_input(instrument)?, solver, iterations: self.iterations.max(1) })
    }
}

/// The planned method.
#[derive(Clone, Debug)]
pub struct RichardsonLucy {
    input: FrameInput,
    solver: Iterations,
    iterations: usize,
}

impl Reconstruct for RichardsonLucy {
    fn name(&self) -> &str {
        "richardson-lucy"
    }

    fn reconstruct(&self, frame_dn: ArrayView2<'_, f32>) -> anyhow::Result<Array2<f32>> {
        let y = self.solver.measured(self.input.light_dn(frame_dn)?.view());
        let mut x = self.solver.even(&y);
        for _ in 0..self.iterations {
            self.solver.step(&y, &mut x)?;
        }
        Ok(x)
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use ommatidia_model::metrics::compare;
    use ommatidia_model::testing::square_array as instrument;

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
