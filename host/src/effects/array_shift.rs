//! Shifted array: every chief ray is displaced by the same amount.
//!
//! `anchor_l -> anchor_l + (row_px, col_px)`.

use super::context::{FrameContext, Ray, RayShift};
use super::descriptor::{Descriptor, Lookalike, Param, Stage};
use super::effect::Effect;

/// The effect; its formula is in the documentation of the module.
pub(super) struct ArrayShift;

static DESCRIPTOR: Descriptor = Descriptor {
    id: "array_shift",
    stage: Stage::Geometry,
    summary: "anchor_l + (row_px, col_px): the whole array is displaced",
    params: &[Param::strength("row_px", "px", 0.005, -50.0, 50.0), Param::strength("col_px", "px", 0.005, -50.0, 50.0)],
    lookalikes: &[
        Lookalike {
            id: "lens_decentre",
            separate_by: "bead scan: a shifted array moves the images of all lenses equally",
        },
        Lookalike {
            id: "thermal_drift",
            separate_by: "repeated frames of a bead at rest: only a drift grows with time",
        },
        Lookalike {
            id: "radial_distortion",
            separate_by: "bead scan over the field: distortion grows with the field angle",
        },
    ],
};

impl Effect for ArrayShift {
    fn descriptor(&self) -> &'static Descriptor {
        &DESCRIPTOR
    }

    fn shift_ray(&self, p: &[f64], _ray: &Ray, _cx: &FrameContext<'_>) -> RayShift {
        RayShift { px: [p[0], p[1]], z_um: 0.0 }
    }
}
