//! Distortion about the centre of the object, as a relay lens in front of the array makes it.
//!
//! A source at the distance r from the centre of the object appears at `s (1 + k1 r^2)`, so that its focus moves by
//! `k1 r^2` times its field, equally in every lens; r in mm.

use super::context::{FrameContext, Ray, RayShift};
use super::descriptor::{Descriptor, Lookalike, Param, Stage};
use super::effect::Effect;

/// The effect; its formula is in the documentation of the module.
pub(super) struct ObjectDistortion;

static DESCRIPTOR: Descriptor = Descriptor {
    id: "object_distortion",
    stage: Stage::Geometry,
    summary: "s (1 + k1 r^2) about the centre of the object: a relay lens distorts, equally in every lens",
    params: &[Param::strength("k1_per_mm2", "mm^-2", 0.02, -100.0, 100.0)],
    lookalikes: &[
        Lookalike {
            id: "radial_distortion",
            separate_by: "bead scan: a relay distorts about the same place of the object in every lens",
        },
        Lookalike {
            id: "stage_scale",
            separate_by: "bead scan to the edge: distortion grows with the cube of the field",
        },
        Lookalike {
            id: "magnification",
            separate_by: "bead scan to the edge: distortion grows with the cube of the field",
        },
    ],
};

impl Effect for ObjectDistortion {
    fn descriptor(&self) -> &'static Descriptor {
        &DESCRIPTOR
    }

    fn shift_ray(&self, p: &[f64], ray: &Ray, _cx: &FrameContext<'_>) -> RayShift {
        if p[0] == 0.0 {
            return RayShift::default();
        }
        let [y, x] = ray.object_um.map(|um| um * 1e-3);
        let stretch = p[0] * (y * y + x * x);
        RayShift::by_px(ray.field_px.map(|f| stretch * f))
    }
}
