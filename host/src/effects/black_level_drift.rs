//! Black-level drift: the mean signal without light changes with time.
//!
//! `y -> y + rate time`.

use super::context::FrameContext;
use super::descriptor::{Descriptor, Lookalike, Param, Stage};
use super::effect::Effect;
use ndarray::Array2;

/// The effect; its formula is in the documentation of the module.
pub(super) struct BlackLevelDrift;

static DESCRIPTOR: Descriptor = Descriptor {
    id: "black_level_drift",
    stage: Stage::Electronics,
    summary: "y + rate time: the black level drifts with time",
    params: &[Param::strength("rate_dn_per_s", "DN/s", 0.5, -1e4, 1e4)],
    lookalikes: &[
        Lookalike {
            id: "dark_current",
            separate_by: "darks at several exposures: a drift does not depend on the exposure",
        },
        Lookalike { id: "background", separate_by: "frames with the lamp off: background disappears" },
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
