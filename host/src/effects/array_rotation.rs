//! Turned array: the lenses sit on a grid that is turned on the sensor; each image keeps its own direction.
//!
//! `anchor_l -> anchor_l + angle (col_l, -row_l)`, (row_l, col_l) = anchor from the centre of the array; a small angle, in mrad,
//! positive from the column axis to the row axis (clockwise on a screen). Catalogue 4.

use super::{Descriptor, Effect, FrameContext, Lookalike, Param, Ray, RayShift, Stage};

/// See the module.
pub(super) struct ArrayRotation;

static DESCRIPTOR: Descriptor = Descriptor {
    id: "array_rotation",
    stage: Stage::Geometry,
    summary: "anchor_l + angle (col_l, -row_l): the array is turned about its centre",
    params: &[Param::strength("angle_mrad", "mrad", 0.05, -200.0, 200.0)],
    lookalikes: &[
        Lookalike { id: "lens_decentre", separate_by: "bead scan: a rotation moves all lenses by one law" },
        Lookalike {
            id: "stage_scale",
            separate_by: "bead scan: a skewed stage moves foci by the field, alike in every lens",
        },
    ],
};

impl Effect for ArrayRotation {
    fn descriptor(&self) -> &'static Descriptor {
        &DESCRIPTOR
    }

    fn shift_ray(&self, p: &[f64], ray: &Ray, _cx: &FrameContext<'_>) -> RayShift {
        if p[0] == 0.0 {
            return RayShift::default();
        }
        let [row, col] = ray.anchor_px;
        RayShift { px: [1e-3 * p[0] * col, -1e-3 * p[0] * row], z_um: 0.0 }
    }
}
