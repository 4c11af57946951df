//! Background: light that leaks through the filters and autofluorescence, proportional to exposure and lamp power.
//!
//! `mu -> mu + rate t P (1 + gradient . s)`, with the exposure t, the lamp power P, and the position s from the centre
//! in half heights and half widths (-1..1).

use super::context::FrameContext;
use super::descriptor::{Descriptor, Lookalike, Param, Stage};
use super::effect::Effect;
use ndarray::Array2;

/// The effect; its formula is in the documentation of the module.
pub(super) struct Background;

static DESCRIPTOR: Descriptor = Descriptor {
    id: "background",
    stage: Stage::Light,
    summary: "mu + rate t P (1 + gradient . s): filter leak and autofluorescence with a linear gradient",
    params: &[
        Param::strength("rate_e_per_ms", "e-/px/ms", 0.02, 0.0, 1e6),
        Param::shape("gradient_row", "1", 0.0, 0.1, [-1.0, 1.0], &[0.0]),
        Param::shape("gradient_col", "1", 0.0, 0.1, [-1.0, 1.0], &[0.0]),
    ],
    lookalikes: &[
        Lookalike { id: "dark_current", separate_by: "frames with the lamp off: background disappears" },
        Lookalike {
            id: "veiling_glare",
            separate_by: "two light levels of the specimen: glare follows its light, background the lamp power",
        },
        Lookalike { id: "black_level_drift", separate_by: "frames with the lamp off: background disappears" },
    ],
};

impl Effect for Background {
    fn descriptor(&self) -> &'static Descriptor {
        &DESCRIPTOR
    }

    fn on_light(&self, p: &[f64], light_e: &mut Array2<f32>, cx: &FrameContext<'_>) {
        if p[0] == 0.0 {
            return;
        }
        let level = p[0] * cx.exposure_ms * cx.illumination;
        let along = |i: usize, n: usize| 2.0 * (i as f64 + 0.5) / n as f64 - 1.0;
        let (rows, cols) = light_e.dim();
        let across: Vec<f64> = (0..cols).map(|c| p[2] * along(c, cols)).collect();
        for (r, mut row) in light_e.outer_iter_mut().enumerate() {
            let down = 1.0 + p[1] * along(r, rows);
            row.iter_mut().zip(&across).for_each(|(v, x)| *v += (level * (down + x).max(0.0)) as f32);
        }
    }
}
