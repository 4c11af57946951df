//! Photobleaching: dyes fade with the light they have received.
//!
//! `O -> O exp(-rate dose)`, with the dose in s: time times relative light level. Specimens and beads only.

use super::context::FrameContext;
use super::descriptor::{Descriptor, Lookalike, Param, Stage};
use super::effect::Effect;
use crate::session::Role;
use ndarray::Array2;

/// The effect; its formula is in the documentation of the module.
pub(super) struct Photobleaching;

static DESCRIPTOR: Descriptor = Descriptor {
    id: "photobleaching",
    stage: Stage::Object,
    summary: "O exp(-rate dose): dyes fade with the light they received",
    params: &[Param::strength("rate_per_s", "1/s", 0.01, 0.0, 1e3)],
    lookalikes: &[
        Lookalike { id: "lamp_drift", separate_by: "flats between the frames: a fading lamp dims them too" },
        Lookalike { id: "excitation_profile", separate_by: "the same specimen early and late: only bleaching dims it" },
    ],
};

impl Effect for Photobleaching {
    fn descriptor(&self) -> &'static Descriptor {
        &DESCRIPTOR
    }

    fn on_object(&self, p: &[f64], object: &mut Array2<f32>, cx: &FrameContext<'_>) {
        let dose = cx.time_s.max(0.0) * cx.illumination;
        if p[0] == 0.0 || dose == 0.0 || !matches!(cx.role, Role::Scene | Role::Bead) {
            return;
        }
        let left = (-p[0] * dose).exp() as f32;
        object.mapv_inplace(|v| v * left);
    }
}
