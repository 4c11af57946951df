//! Exposure offset: the shutter is open longer (or shorter) than it says, by the same time at every exposure.
//!
//! `mu -> mu (t + dt) / t`, t = exposure. Catalogue 26.

use super::{Descriptor, Effect, FrameContext, Lookalike, Param, Stage};
use ndarray::Array2;

/// See the module.
pub(super) struct ExposureOffset;

static DESCRIPTOR: Descriptor = Descriptor {
    id: "exposure_offset",
    stage: Stage::Light,
    summary: "mu (t + dt) / t: each exposure is longer by dt than it says",
    params: &[Param::strength("dt_ms", "ms", 0.01, -1000.0, 1000.0)],
    lookalikes: &[
        Lookalike { id: "nonlinearity", separate_by: "a ladder of lamp powers at one exposure" },
        Lookalike { id: "metadata_fault", separate_by: "two exposures: an offset weighs less in the longer one" },
        Lookalike { id: "lamp_drift", separate_by: "the first frame again at the end" },
    ],
};

impl Effect for ExposureOffset {
    fn descriptor(&self) -> &'static Descriptor {
        &DESCRIPTOR
    }

    fn on_light(&self, p: &[f64], light_e: &mut Array2<f32>, cx: &FrameContext<'_>) {
        if p[0] != 0.0 && cx.exposure_ms > 0.0 {
            let longer = ((cx.exposure_ms + p[0]) / cx.exposure_ms).max(0.0) as f32;
            light_e.mapv_inplace(|v| v * longer);
        }
    }
}
