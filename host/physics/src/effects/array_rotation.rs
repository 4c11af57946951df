//! Rotated array: the grid of lenses is rotated on the sensor; the image of each lens keeps its orientation.
//!
//! `anchor_l -> R anchor_l + (row_px, col_px)` with `R (row, col) = (row cos a + col sin a, col cos a - row sin a)`,
//! where the anchor is relative to the centre of the array. The angle a is in mrad, positive from the column axis to
//! the row axis (clockwise on a screen). The displacement says about which point it turned: a mount has its pivot
//! anywhere.

use super::context::{FrameContext, Ray, RayShift};
use super::descriptor::{Descriptor, Lookalike, Param, Stage};
use super::effect::Effect;

/// The effect; its formula is in the documentation of the module.
pub(super) struct ArrayRotation;

/// The angle, and the displacement of the centre.
pub(super) static ROTATION: [Param; 3] = [
    Param::strength("angle_mrad", "mrad", 0.05, -200.0, 200.0),
    Param::strength("row_px", "px", 0.005, -50.0, 50.0),
    Param::strength("col_px", "px", 0.005, -50.0, 50.0),
];

static DESCRIPTOR: Descriptor = Descriptor {
    id: "array_rotation",
    stage: Stage::Geometry,
    summary: "anchor_l rotated by the angle about the centre of the array, + (row_px, col_px): about any point",
    params: &ROTATION,
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
        RayShift::by_px(turned_by(p, ray.anchor_px))
    }
}

/// By how much a point (row, col) from the centre is displaced by the parameters of [`ROTATION`].
pub(super) fn turned_by(p: &[f64], [row, col]: [f64; 2]) -> [f64; 2] {
    if p.iter().all(|v| *v == 0.0) {
        return [0.0; 2];
    }
    let (sin, cos) = (1e-3 * p[0]).sin_cos();
    [(cos - 1.0) * row + sin * col + p[1], (cos - 1.0) * col - sin * row + p[2]]
}
