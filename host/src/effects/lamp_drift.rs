//! Lamp drift: the lamp's power changes with time.
//!
//! `mu -> mu (1 + rate time)`, in every frame that has light. Catalogue 21.

use super::{Descriptor, Effect, FrameContext, Lookalike, Param, Stage};
use crate::session::Role;
use ndarray::Array2;

/// See the module.
pub(super) struct LampDrift;

static DESCRIPTOR: Descriptor = Descriptor {
    id: "lamp_drift",
    stage: Stage::Light,
    summary: "mu (1 + rate time): the lamp's power drifts",
    params: &[Param::strength("rate_per_s", "1/s", 0.01, -1e3, 1e3)],
    lookalikes: &[
        Lookalike { id: "photobleaching", separate_by: "flats between the frames: bleaching spares them" },
        Lookalike { id: "exposure_offset", separate_by: "the first frame again at the end" },
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
