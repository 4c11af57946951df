//! Stage scale: the positions of sources in the session are wrong by a linear map.
//!
//! `s -> (I + A) s` with s = (row, col) from the centre of the object, so a focus is displaced by `A` times its field,
//! equally in every lens.

use super::context::{FrameContext, Ray, RayShift};
use super::descriptor::{Descriptor, Lookalike, Param, Stage};
use super::effect::Effect;

/// The effect; its formula is in the documentation of the module.
pub(super) struct StageScale;

const fn entry(name: &'static str) -> Param {
    Param::strength(name, "1", 0.0002, -0.5, 0.5)
}

static DESCRIPTOR: Descriptor = Descriptor {
    id: "stage_scale",
    stage: Stage::Geometry,
    summary: "(I + A) s: the recorded positions of sources are scaled or skewed",
    params: &[entry("row_by_row"), entry("col_by_col"), entry("row_by_col"), entry("col_by_row")],
    lookalikes: &[
        Lookalike { id: "magnification", separate_by: "a target of known pitch, which does not depend on the stage" },
        Lookalike {
            id: "array_rotation",
            separate_by: "bead scan: a rotated array moves the whole image of each lens",
        },
        Lookalike { id: "metadata_fault", separate_by: "check the units and axes in the session's tables" },
    ],
};

impl Effect for StageScale {
    fn descriptor(&self) -> &'static Descriptor {
        &DESCRIPTOR
    }

    fn shift_ray(&self, p: &[f64], ray: &Ray, _cx: &FrameContext<'_>) -> RayShift {
        if p.iter().all(|v| *v == 0.0) {
            return RayShift::default();
        }
        let [row, col] = ray.field_px;
        RayShift::by_px([p[0] * row + p[2] * col, p[1] * col + p[3] * row])
    }
}
