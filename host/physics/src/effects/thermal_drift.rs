//! Thermal drift: the whole image moves with time.
//!
//! `x -> x + v time`, v in px/s.

use super::context::{FrameContext, Ray, RayShift};
use super::descriptor::{Descriptor, Lookalike, Param, Stage};
use super::effect::Effect;

/// The effect; its formula is in the documentation of the module.
pub(super) struct ThermalDrift;

static DESCRIPTOR: Descriptor = Descriptor {
    id: "thermal_drift",
    stage: Stage::Geometry,
    summary: "x + v time: the whole image moves with time",
    params: &[
        Param::strength("row_px_per_s", "px/s", 0.05, -1e3, 1e3),
        Param::strength("col_px_per_s", "px/s", 0.05, -1e3, 1e3),
    ],
    lookalikes: &[
        Lookalike { id: "array_shift", separate_by: "repeated frames of a bead at rest: only a drift grows with time" },
        Lookalike {
            id: "array_jump",
            separate_by: "more frames around the moment: a drift moves in all of them, a jump between two",
        },
        Lookalike { id: "lag", separate_by: "a dark frame after a bright one: only a lag leaves an image in it" },
    ],
};

impl Effect for ThermalDrift {
    fn descriptor(&self) -> &'static Descriptor {
        &DESCRIPTOR
    }

    fn shift_ray(&self, p: &[f64], _ray: &Ray, cx: &FrameContext<'_>) -> RayShift {
        if p.iter().all(|v| *v == 0.0) {
            return RayShift::default();
        }
        RayShift::by_px([p[0] * cx.time_s, p[1] * cx.time_s])
    }
}
