//! Rotated sensor: every focus turns about the centre of the array, so that the image of each lens turns as well.
//!
//! `x -> R x + (row_px, col_px)` with `R (row, col) = (row cos a + col sin a, col cos a - row sin a)`, where x is the
//! focus relative to the centre of the array. The angle a is in mrad, positive from the column axis to the row axis
//! (clockwise on a screen). The displacement says about which point it turned.

use super::array_rotation::{ROTATION, turned_by};
use super::context::{FrameContext, Ray, RayShift};
use super::descriptor::{Descriptor, Lookalike, Stage};
use super::effect::Effect;

/// The effect; its formula is in the documentation of the module.
pub(super) struct SensorRotation;

static DESCRIPTOR: Descriptor = Descriptor {
    id: "sensor_rotation",
    stage: Stage::Geometry,
    summary: "x rotated by the angle about the centre of the array, + (row_px, col_px): the sensor is rotated",
    params: &ROTATION,
    lookalikes: &[
        Lookalike {
            id: "array_rotation",
            separate_by: "bead scan: a rotated sensor turns the image of each lens about its anchor as well",
        },
        Lookalike { id: "stage_scale", separate_by: "bead scan: a skewed stage leaves the anchors where they are" },
    ],
};

impl Effect for SensorRotation {
    fn descriptor(&self) -> &'static Descriptor {
        &DESCRIPTOR
    }

    fn shift_ray(&self, p: &[f64], ray: &Ray, _cx: &FrameContext<'_>) -> RayShift {
        RayShift::by_px(turned_by(p, [0, 1].map(|i| ray.anchor_px[i] + ray.field_px[i])))
    }
}
