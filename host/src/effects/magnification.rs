//! Magnification: the gap between array and sensor is not the calibrated one, so every image grows about its lens's axis.
//!
//! `x -> x + eps x`, x = focus from where the lens's axis meets the sensor. Off-axis lenses move too: that parallax tells it from an
//! error of the stage. Catalogue 6.

use super::{Descriptor, Effect, FrameContext, Lookalike, Param, Ray, RayShift, Stage};

/// See the module.
pub(super) struct Magnification;

static DESCRIPTOR: Descriptor = Descriptor {
    id: "magnification",
    stage: Stage::Geometry,
    summary: "x (1 + eps) about each lens's axis: the gap behind the array has changed",
    params: &[Param::strength("eps", "1", 0.0001, -0.5, 0.5)],
    lookalikes: &[
        Lookalike { id: "stage_scale", separate_by: "a target of known pitch" },
        Lookalike {
            id: "radial_distortion",
            separate_by: "bead scan to the edge: distortion grows with the cube of the field",
        },
        Lookalike { id: "defocus", separate_by: "depth scan: a changed gap also moves the anchors" },
    ],
};

impl Effect for Magnification {
    fn descriptor(&self) -> &'static Descriptor {
        &DESCRIPTOR
    }

    fn shift_ray(&self, p: &[f64], ray: &Ray, _cx: &FrameContext<'_>) -> RayShift {
        if p[0] == 0.0 {
            return RayShift::default();
        }
        RayShift { px: ray.axis_px.map(|x| p[0] * x), z_um: 0.0 }
    }
}
