//! One lens passes more or less light than calibrated (dirt, a finger print, a new filter edge).
//!
//! `mu_l -> (1 + change) mu_l` for one lens l; the effect may be given once a lens. Catalogue 15.

use super::{Descriptor, Effect, FrameContext, Param, Stage};
use ndarray::Array2;

/// See the module.
pub(super) struct LensGain;

static DESCRIPTOR: Descriptor = Descriptor {
    id: "lens_gain",
    stage: Stage::Lens,
    summary: "(1 + change) mu_l: one lens passes more or less light",
    params: &[
        Param { name: "change", unit: "1", off: 0.0, step: 0.05, min: -1.0, max: 10.0 },
        Param { name: "lens", unit: "index", off: 0.0, step: 1.0, min: 0.0, max: 65535.0 },
    ],
};

impl Effect for LensGain {
    fn descriptor(&self) -> &'static Descriptor {
        &DESCRIPTOR
    }

    fn on_lens(&self, p: &[f64], image_e: &mut Array2<f32>, cx: &FrameContext) {
        if p[0] != 0.0 && cx.lens == p[1] as usize {
            image_e.mapv_inplace(|v| v * (1.0 + p[0]) as f32);
        }
    }
}
