//! Lamp drift: the power of the lamp changes with time.
//!
//! `mu -> mu (1 + rate time)`, in every frame that has light.

use super::context::FrameContext;
use super::descriptor::{Descriptor, Lookalike, Param, Stage};
use super::effect::Effect;
use crate::session::Role;
use ndarray::Array2;

/// The effect; its formula is in the documentation of the module.
pub(super) struct LampDrift;

static DESCRIPTOR: Descriptor = Descriptor {
    id: "lamp_drift",
    stage: Stage::Light,
    summary: "mu (1 + rate time): the power of the lamp drifts with time",
    params: &[Param::strength("rate_per_s", "1/s", 0.01, -1e3, 1e3)],
    lookalikes: &[
        Lookalike { id: "photobleaching", separate_by: "flats between the frames: bleaching does not dim them" },
        Lookalike {
            id: "exposure_offset",
            separate_by: "the first frame repeated at the end: only a drift changes it",
        },
    ],
};

impl Effect for LampDrift {
    fn descriptor(&self) -> &'static Descriptor {
        &DESCRIPTOR
    }

    fn on_light(&self, p: &[f64], light_e: &mut Array2<f32>, cx: &FrameContext<'_>) {
        if p[0] != 0.0 && cx.role != Role::Dark {
            let power = (1.0 + p[0] * cx.time_s).max(0.0) as f32;
            light_e.mapv_inplace(|v| v * power);
        }
    }
}
