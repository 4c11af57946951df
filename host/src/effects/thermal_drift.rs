//! Thermal drift: the whole image wanders with time.
//!
//! `x -> x + v time`, v in px/s. Catalogue 3.

use super::{Descriptor, Effect, FrameContext, Lookalike, Param, Ray, RayShift, Stage};

/// See the module.
pub(super) struct ThermalDrift;

static DESCRIPTOR: Descriptor = Descriptor {
    id: "thermal_drift",
    stage: Stage::Geometry,
    summary: "x + v time: the image wanders",
    params: &[
        Param::strength("row_px_per_s", "px/s", 0.05, -1e3, 1e3),
        Param::strength("col_px_per_s", "px/s", 0.05, -1e3, 1e3),
    ],
    lookalikes: &[
        Lookalike { id: "array_shift", separate_by: "a bead at rest, frame after frame" },
        Lookalike { id: "lag", separate_by: "a dark frame after a bright one" },
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
        RayShift { px: [p[0] * cx.time_s, p[1] * cx.time_s], z_um: 0.0 }
    }
}
