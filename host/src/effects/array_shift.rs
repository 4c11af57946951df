//! Re-mounted array: every chief ray moves by the same amount.
//!
//! `anchor_l -> anchor_l + (row_px, col_px)`. Catalogue 4.

use super::{Descriptor, Effect, FrameContext, Lookalike, Param, Ray, RayShift, Stage};

/// See the module.
pub(super) struct ArrayShift;

static DESCRIPTOR: Descriptor = Descriptor {
    id: "array_shift",
    stage: Stage::Geometry,
    summary: "anchor_l + (row_px, col_px): the whole array has moved",
    params: &[Param::strength("row_px", "px", 0.005, -50.0, 50.0), Param::strength("col_px", "px", 0.005, -50.0, 50.0)],
    lookalikes: &[
        Lookalike { id: "lens_decentre", separate_by: "bead scan: a shifted array moves every lens alike" },
        Lookalike { id: "thermal_drift", separate_by: "a bead at rest, frame after frame" },
        Lookalike { id: "radial_distortion", separate_by: "bead scan over the field: distortion grows with the field" },
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
