//! Unnamed gradient: a factor on the light that changes slowly over the sensor, by a parabola of the place.
//!
//! `mu -> mu (1 + a y + b x + c y^2 + d x^2 + e y x)` in frames of every role, where y and x go from -1 at the first to
//! 1 at the last row and column. Gains of single lenses change in steps from image to image; a response, a filter or a
//! window that changes slowly looks much the same in them, and this is simpler.

use super::context::FrameContext;
use super::descriptor::{Descriptor, Lookalike, Param, Stage};
use super::effect::Effect;
use ndarray::Array2;

/// The effect; its formula is in the documentation of the module.
pub(super) struct UnknownGradient;

const fn strength(name: &'static str) -> Param {
    Param::strength(name, "1", 0.003, -2.0, 2.0)
}

static DESCRIPTOR: Descriptor = Descriptor {
    id: "unknown_gradient",
    stage: Stage::Light,
    summary: "mu (1 + a y + b x + c y^2 + d x^2 + e y x): an unnamed term, a factor that changes slowly over the \
              sensor",
    params: &[
        strength("by_row"),
        strength("by_col"),
        strength("by_row_squared"),
        strength("by_col_squared"),
        strength("by_row_and_col"),
    ],
    lookalikes: &[
        Lookalike { id: "lens_gain", separate_by: "flats: the gain of a lens changes in steps from image to image" },
        Lookalike {
            id: "excitation_profile",
            separate_by: "move the specimen: a gradient of the sensor does not move",
        },
        Lookalike { id: "vignetting", separate_by: "scenes: vignetting is even about the middle of the sensor" },
    ],
};

impl Effect for UnknownGradient {
    fn descriptor(&self) -> &'static Descriptor {
        &DESCRIPTOR
    }

    fn is_as_smooth_as_a_lamp(&self) -> bool {
        true
    }

    fn on_light(&self, p: &[f64], light_e: &mut Array2<f32>, _cx: &FrameContext<'_>) {
        if p.len() < DESCRIPTOR.params.len() || p.iter().all(|v| *v == 0.0) {
            return;
        }
        let (rows, cols) = light_e.dim();
        let place = |i: usize, n: usize| (2.0 * i as f64 + 1.0 - n as f64) / (n as f64 - 1.0).max(1.0);
        for (r, mut row) in light_e.outer_iter_mut().enumerate() {
            let y = place(r, rows);
            // The parabola along this row.
            let [constant, linear, square] = [1.0 + p[0] * y + p[2] * y * y, p[1] + p[4] * y, p[3]];
            for (c, v) in row.iter_mut().enumerate() {
                let x = place(c, cols);
                *v *= (constant + x * (linear + x * square)).max(0.0) as f32;
            }
        }
    }
}
