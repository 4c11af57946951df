//! Unnamed warp: the image of each lens is displaced, turned, stretched and sheared by itself.
//!
//! A focus of lens l at `f` = (row, col) from its anchor moves by `s_l + M_l f / 100 px`, with two components of s and
//! four of M for each lens.

use super::context::{FrameContext, Ray, RayShift};
use super::descriptor::{Descriptor, Param, Stage};
use super::effect::Effect;

/// The effect; its formula is in the documentation of the module.
pub(super) struct UnknownWarp;

const fn moved(name: &'static str) -> Param {
    Param::strength(name, "px", 0.01, -20.0, 20.0).per_lens()
}

static DESCRIPTOR: Descriptor = Descriptor {
    id: "unknown_warp",
    stage: Stage::Geometry,
    summary: "f + s_l + M_l f: an unnamed term, the image of each lens is displaced, turned, stretched and sheared",
    params: &[
        moved("row_px"),
        moved("col_px"),
        moved("row_by_row"),
        moved("row_by_col"),
        moved("col_by_row"),
        moved("col_by_col"),
    ],
    lookalikes: &[],
};

/// Distance from the anchor at which a component of M is the displacement, pixels.
const UNIT_PX: f64 = 100.0;

impl Effect for UnknownWarp {
    fn descriptor(&self) -> &'static Descriptor {
        &DESCRIPTOR
    }

    fn shift_ray(&self, p: &[f64], ray: &Ray, _cx: &FrameContext<'_>) -> RayShift {
        let lenses = p.len() / DESCRIPTOR.params.len();
        if ray.lens >= lenses {
            return RayShift::default();
        }
        let of = |which: usize| p[which * lenses + ray.lens];
        let [r, c] = ray.field_px.map(|v| v / UNIT_PX);
        RayShift::by_px([of(0) + of(2) * r + of(3) * c, of(1) + of(4) * r + of(5) * c])
    }
}
