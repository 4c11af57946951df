//! Radial distortion: foci are displaced along the radius from the axis of their lens.
//!
//! `x -> x (1 + k1 r^2)`, where x is a focus relative to the point where the axis of its lens meets the sensor, r = |x|
//! in mm, and k1 is in mm^-2. Source: Brown, Photogrammetric Engineering 32, 444, 1966: the first radial term.

use super::context::{FrameContext, Ray, RayShift};
use super::descriptor::{Descriptor, Lookalike, Param, Stage};
use super::effect::Effect;

/// The effect; its formula is in the documentation of the module.
pub(super) struct RadialDistortion;

static DESCRIPTOR: Descriptor = Descriptor {
    id: "radial_distortion",
    stage: Stage::Geometry,
    summary: "x (1 + k1 r^2) about the axis of each lens: foci are displaced along the radius",
    params: &[Param::strength("k1_per_mm2", "mm^-2", 0.005, -20.0, 20.0)],
    lookalikes: &[
        Lookalike {
            id: "magnification",
            separate_by: "bead scan to the edge: distortion grows with the cube of the field angle",
        },
        Lookalike { id: "stage_scale", separate_by: "bead scan: an error of the stage is the same in every lens" },
    ],
};

impl Effect for RadialDistortion {
    fn descriptor(&self) -> &'static Descriptor {
        &DESCRIPTOR
    }

    fn shift_ray(&self, p: &[f64], ray: &Ray, _cx: &FrameContext<'_>) -> RayShift {
        if p[0] == 0.0 {
            return RayShift::default();
        }
        let mm = ray.pixel_pitch_um * 1e-3;
        let [y, x] = ray.axis_px;
        let stretch = p[0] * (y * y + x * x) * mm * mm;
        RayShift::by_px([stretch * y, stretch * x])
    }
}
