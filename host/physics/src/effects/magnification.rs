//! Magnification: the gap between array and sensor differs from the calibrated one, so every image is scaled about the
//! axis of its lens.
//!
//! `x -> x + eps x`, where x is a focus relative to the point where the axis of its lens meets the sensor. The anchors
//! of off-axis lenses move too; this parallax distinguishes the effect from an error of the stage. Foci grow as the
//! image does.

use super::context::{FrameContext, Ray, RayShift};
use super::descriptor::{Descriptor, Lookalike, Param, Stage};
use super::effect::Effect;

/// The effect; its formula is in the documentation of the module.
pub(super) struct Magnification;

static DESCRIPTOR: Descriptor = Descriptor {
    id: "magnification",
    stage: Stage::Geometry,
    summary: "x (1 + eps) about the axis of each lens: the gap behind the array has changed",
    params: &[Param::strength("eps", "1", 0.0001, -0.5, 0.5)],
    lookalikes: &[
        Lookalike { id: "stage_scale", separate_by: "a target of known pitch, which does not depend on the stage" },
        Lookalike {
            id: "radial_distortion",
            separate_by: "bead scan to the edge: distortion grows with the cube of the field angle",
        },
        Lookalike { id: "defocus", separate_by: "depth scan: a changed gap also moves the anchors" },
        Lookalike { id: "spectral_shift", separate_by: "bead scan: a wavelength leaves the foci where they are" },
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
        RayShift { px: ray.axis_px.map(|x| p[0] * x), growth: p[0], ..RayShift::default() }
    }
}
