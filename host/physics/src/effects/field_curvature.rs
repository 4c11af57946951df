//! Field curvature: the surface of best focus is curved about the axis of each lens.
//!
//! `z -> z + a r^2`, where r is the distance of a focus from the point where the axis of the lens meets the sensor, mm,
//! and a is in um/mm^2.

use super::context::{FrameContext, Ray, RayShift};
use super::descriptor::{Descriptor, Lookalike, Param, Stage};
use super::effect::Effect;

/// The effect; its formula is in the documentation of the module.
pub(super) struct FieldCurvature;

static DESCRIPTOR: Descriptor = Descriptor {
    id: "field_curvature",
    stage: Stage::Geometry,
    summary: "h(z + a r^2) about the axis of each lens: the surface of best focus is curved",
    params: &[Param::strength("a_um_per_mm2", "um/mm^2", 200.0, -1e5, 1e5)],
    lookalikes: &[
        Lookalike {
            id: "defocus",
            separate_by: "depth scan at the centre and at the edge: only a curved field focuses at different depths",
        },
        Lookalike {
            id: "rank_truncation",
            separate_by: "depth scan, or a model of higher rank: a higher rank removes a truncation",
        },
    ],
};

impl Effect for FieldCurvature {
    fn descriptor(&self) -> &'static Descriptor {
        &DESCRIPTOR
    }

    fn shift_ray(&self, p: &[f64], ray: &Ray, _cx: &FrameContext<'_>) -> RayShift {
        if p[0] == 0.0 {
            return RayShift::default();
        }
        let mm = ray.pixel_pitch_um * 1e-3;
        let [y, x] = ray.axis_px;
        RayShift::by_um(p[0] * (y * y + x * x) * mm * mm)
    }
}
