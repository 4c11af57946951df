//! Black-level drift: the mean signal without light wanders with time.
//!
//! `y -> y + rate time`. Catalogue 35.

use super::{Descriptor, Effect, FrameContext, Lookalike, Param, Stage};
use ndarray::Array2;

/// See the module.
pub(super) struct BlackLevelDrift;

static DESCRIPTOR: Descriptor = Descriptor {
    id: "black_level_drift",
    stage: Stage::Electronics,
    summary: "y + rate time: the black level drifts",
    params: &[Param::strength("rate_dn_per_s", "DN/s", 0.5, -1e4, 1e4)],
    lookalikes: &[
        Lookalike { id: "dark_current", separate_by: "darks at several exposures: a drift does not grow with them" },
        Lookalike { id: "background", separate_by: "frames with the lamp off" },
    ],
};

impl Effect for BlackLevelDrift {
    fn descriptor(&self) -> &'static Descriptor {
        &DESCRIPTOR
    }

    fn on_electronics(&self, p: &[f64], frame_dn: &mut Array2<f32>, cx: &FrameContext<'_>) {
        if p[0] != 0.0 {
            let offset = (p[0] * cx.time_s) as f32;
            frame_dn.mapv_inplace(|v| v + offset);
        }
    }
}
