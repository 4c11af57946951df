//! Background: filter leak and autofluorescence, in proportion to exposure and lamp power.
//!
//! `mu -> mu + rate t P (1 + gradient . s)`, s = position from the centre in half heights and half widths (-1..1).
//! Catalogue 19.

use super::{Descriptor, Effect, FrameContext, Lookalike, Param, Stage};
use ndarray::Array2;

/// See the module.
pub(super) struct Background;

static DESCRIPTOR: Descriptor = Descriptor {
    id: "background",
    stage: Stage::Light,
    summary: "mu + rate t P (1 + gradient . s): leak and autofluorescence, with a slope",
    params: &[
        Param::strength("rate_e_per_ms", "e-/px/ms", 0.02, 0.0, 1e6),
        Param::shape("gradient_row", "1", 0.0, 0.1, [-1.0, 1.0], &[0.0]),
        Param::shape("gradient_col", "1", 0.0, 0.1, [-1.0, 1.0], &[0.0]),
    ],
    lookalikes: &[
        Lookalike { id: "dark_current", separate_by: "frames with the lamp off" },
        Lookalike {
            id: "veiling_glare",
            separate_by: "two light levels of the specimen: glare follows its light, background the lamp",
        },
        Lookalike { id: "black_level_drift", separate_by: "frames with the lamp off" },
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
