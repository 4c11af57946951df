//! Dark current: charge that is collected without light.
//!
//! `mu -> mu + rate t 2^((T - 20 C) / doubling)` in every frame, with the exposure t and the temperature T, independent
//! of the lamp. Source of the doubling law: Janesick, *Scientific Charge-Coupled Devices*, 2001, ch. 7.

use super::context::FrameContext;
use super::descriptor::{Descriptor, Lookalike, Param, Stage};
use super::effect::Effect;
use ndarray::Array2;

/// The effect; its formula is in the documentation of the module.
pub(super) struct DarkCurrent;

static DESCRIPTOR: Descriptor = Descriptor {
    id: "dark_current",
    stage: Stage::Light,
    summary: "mu + rate t 2^((T - 20 C) / doubling): charge without light",
    params: &[
        Param::strength("rate_e_per_ms", "e-/px/ms", 0.02, 0.0, 1e6),
        Param::shape("doubling_k", "K", 8.0, 1.0, [1.0, 100.0], &[8.0]),
    ],
    lookalikes: &[
        Lookalike { id: "background", separate_by: "frames with the lamp off: background disappears" },
        Lookalike {
            id: "black_level_drift",
            separate_by: "darks at several exposures: a drift does not depend on the exposure",
        },
    ],
};

impl Effect for DarkCurrent {
    fn descriptor(&self) -> &'static Descriptor {
        &DESCRIPTOR
    }

    fn on_light(&self, p: &[f64], light_e: &mut Array2<f32>, cx: &FrameContext<'_>) {
        if p[0] != 0.0 {
            let charge = (p[0] * cx.exposure_ms * ((cx.temperature_c - 20.0) / p[1]).exp2()) as f32;
            light_e.mapv_inplace(|v| v + charge);
        }
    }
}
