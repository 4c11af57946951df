//! Stage scale: positions of sources, as the session gives them, are off by a linear map.
//!
//! `s -> (I + A) s`, s = (row, col) from the centre of the object, so a focus moves by `A` times its field. The same in every lens.
//! Catalogue 1.

use super::{Descriptor, Effect, FrameContext, Lookalike, Param, Ray, RayShift, Stage};

/// See the module.
pub(super) struct StageScale;

const fn entry(name: &'static str) -> Param {
    Param::strength(name, "1", 0.0002, -0.5, 0.5)
}

static DESCRIPTOR: Descriptor = Descriptor {
    id: "stage_scale",
    stage: Stage::Geometry,
    summary: "(I + A) s: the positions of sources are scaled or skewed",
    params: &[entry("row_by_row"), entry("col_by_col"), entry("row_by_col"), entry("col_by_row")],
    lookalikes: &[
        Lookalike { id: "magnification", separate_by: "a target of known pitch" },
        Lookalike { id: "array_rotation", separate_by: "bead scan: a turned array moves whole images, lens by lens" },
        Lookalike { id: "metadata_fault", separate_by: "check the units and axes of the tables" },
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
        RayShift { px: [p[0] * row + p[2] * col, p[1] * col + p[3] * row], z_um: 0.0 }
    }
}
