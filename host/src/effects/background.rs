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
        let half = [light_e.nrows() as f64 / 2.0, light_e.ncols() as f64 / 2.0];
        for ((r, c), v) in light_e.indexed_iter_mut() {
            let y = (r as f64 + 0.5) / half[0] - 1.0;
            let x = (c as f64 + 0.5) / half[1] - 1.0;
            *v += (level * (1.0 + p[1] * y + p[2] * x).max(0.0)) as f32;
        }
    }
}
