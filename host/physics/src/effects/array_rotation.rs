//! Rotated array: the grid of lenses is rotated on the sensor; the image of each lens keeps its orientation.
//!
//! `anchor_l -> anchor_l + angle (col_l, -row_l)`, where (row_l, col_l) is the anchor relative to the centre of the
//! array. The angle is small, in mrad, positive from the column axis to the row axis (clockwise on a screen).

use super::context::{FrameContext, Ray, RayShift};
use super::descriptor::{Descriptor, Lookalike, Param, Stage};
use super::effect::Effect;

/// The effect; its formula is in the documentation of the module.
pub(super) struct ArrayRotation;

static DESCRIPTOR: Descriptor = Descriptor {
    id: "array_rotation",
    stage: Stage::Geometry,
    summary: "anchor_l + angle (col_l, -row_l): the array is rotated about its centre",
    params: &[Param::strength("angle_mrad", "mrad", 0.05, -200.0, 200.0)],
    lookalikes: &[
        Lookalike { id: "lens_decentre", separate_by: "bead scan: a rotation moves all lenses by one common angle" },
        Lookalike {
            id: "stage_scale",
            separate_by: "bead scan: a skewed stage moves foci in proportion to the field, equally in every lens",
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
        RayShift::by_px([1e-3 * p[0] * col, -1e-3 * p[0] * row])
    }
}
