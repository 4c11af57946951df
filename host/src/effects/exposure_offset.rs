//! Exposure offset: every exposure is longer (or shorter) than recorded by the same time.
//!
//! `mu -> mu (t + dt) / t` with the recorded exposure t.

use super::context::FrameContext;
use super::descriptor::{Descriptor, Lookalike, Param, Stage};
use super::effect::Effect;
use ndarray::Array2;

/// The effect; its formula is in the documentation of the module.
pub(super) struct ExposureOffset;

static DESCRIPTOR: Descriptor = Descriptor {
    id: "exposure_offset",
    stage: Stage::Light,
    summary: "mu (t + dt) / t: each exposure is longer by dt than recorded",
    params: &[Param::strength("dt_ms", "ms", 0.01, -1000.0, 1000.0)],
    lookalikes: &[
        Lookalike {
            id: "nonlinearity",
            separate_by: "several lamp powers at one exposure: only nonlinearity depends on the power",
        },
        Lookalike {
            id: "metadata_fault",
            separate_by: "two exposures: an exposure offset matters less in the longer one",
        },
        Lookalike { id: "lamp_drift", separate_by: "the first frame repeated at the end: only a drift changes it" },
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
