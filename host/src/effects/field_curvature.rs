//! Field curvature: the best focus lies on a bowl about each lens's axis.
//!
//! `z -> z + a r^2`, r = focus from where the lens's axis meets the sensor, mm; a in um/mm^2. Catalogue 8.

use super::{Descriptor, Effect, FrameContext, Lookalike, Param, Ray, RayShift, Stage};

/// See the module.
pub(super) struct FieldCurvature;

static DESCRIPTOR: Descriptor = Descriptor {
    id: "field_curvature",
    stage: Stage::Geometry,
    summary: "h(z + a r^2) about each lens's axis: the field of best focus is curved",
    params: &[Param::strength("a_um_per_mm2", "um/mm^2", 200.0, -1e5, 1e5)],
    lookalikes: &[
        Lookalike { id: "defocus", separate_by: "depth scan at the centre and at the edge of the field" },
        Lookalike { id: "rank_truncation", separate_by: "depth scan, or a model of higher rank" },
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
        RayShift { px: [0.0, 0.0], z_um: p[0] * (y * y + x * x) * mm * mm }
    }
}
