//! Tilt: the specimen is tilted against the plane of best focus.
//!
//! `z -> z + row_um_per_mm y + col_um_per_mm x`, where (y, x) is the position of a source from the centre of the
//! object, mm: equally in every lens. 1 um/mm is 1 mrad to first order. The model covers only the depths of its bead
//! scan, as for `defocus`. Source: the first-order term of depth over the field, next to `field_curvature`, which is
//! the second.

use super::context::{FrameContext, Ray, RayShift};
use super::descriptor::{Descriptor, Lookalike, Param, Stage};
use super::effect::Effect;

/// The effect; its formula is in the documentation of the module.
pub(super) struct Tilt;

/// A specimen that is tilted by more than 45 degrees is not one that somebody meant to lie flat.
const fn slope(name: &'static str) -> Param {
    Param::strength(name, "um/mm", 25.0, -1000.0, 1000.0)
}

static DESCRIPTOR: Descriptor = Descriptor {
    id: "tilt",
    stage: Stage::Geometry,
    summary: "h(z + row y + col x) about the centre of the object: the specimen is tilted out of focus",
    params: &[slope("row_um_per_mm"), slope("col_um_per_mm")],
    lookalikes: &[
        Lookalike {
            id: "defocus",
            separate_by: "depth scan at two opposite edges: only a tilted specimen is in focus at different \
                          depths there",
        },
        Lookalike {
            id: "field_curvature",
            separate_by: "depth scan at two opposite edges: a curved field is in focus at the same depth there",
        },
        Lookalike {
            id: "rank_truncation",
            separate_by: "depth scan, or a model of higher rank: a higher rank removes a truncation",
        },
    ],
};

impl Effect for Tilt {
    fn descriptor(&self) -> &'static Descriptor {
        &DESCRIPTOR
    }

    fn shift_ray(&self, p: &[f64], ray: &Ray, _cx: &FrameContext<'_>) -> RayShift {
        if p.iter().all(|v| *v == 0.0) {
            return RayShift::default();
        }
        let [y_mm, x_mm] = ray.object_um.map(|um| um * 1e-3);
        RayShift::by_um(p[0] * y_mm + p[1] * x_mm)
    }
}
