//! Rotated sensor: every focus turns about the centre of the array, so that the image of each lens turns as well.
//!
//! `x -> x + angle (col, -row)`, where (row, col) is the focus relative to the centre of the array. The angle is small,
//! in mrad, positive from the column axis to the row axis (clockwise on a screen). The PSFs themselves keep their
//! orientation: a small angle moves their light by far less than the foci.

use super::context::{FrameContext, Ray, RayShift};
use super::descriptor::{Descriptor, Lookalike, Param, Stage};
use super::effect::Effect;

/// The effect; its formula is in the documentation of the module.
pub(super) struct SensorRotation;

static DESCRIPTOR: Descriptor = Descriptor {
    id: "sensor_rotation",
    stage: Stage::Geometry,
    summary: "x + angle (col, -row): the sensor is rotated about the centre of the array",
    params: &[Param::strength("angle_mrad", "mrad", 0.05, -200.0, 200.0)],
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
        if p[0] == 0.0 {
            return RayShift::default();
        }
        let [row, col] = [0, 1].map(|i| ray.anchor_px[i] + ray.field_px[i]);
        RayShift::by_px([1e-3 * p[0] * col, -1e-3 * p[0] * row])
    }
}
