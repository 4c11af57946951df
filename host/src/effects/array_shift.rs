//! Re-mounted array: every chief ray moves by the same amount.
//!
//! `anchor_l -> anchor_l + (row_px, col_px)`. Catalogue 4.

use super::{Descriptor, Effect, FrameContext, Param, Stage};
use crate::instrument::Geometry;

/// See the module.
pub(super) struct ArrayShift;

static DESCRIPTOR: Descriptor = Descriptor {
    id: "array_shift",
    stage: Stage::Geometry,
    summary: "anchor_l + (row_px, col_px): the whole array has moved",
    params: &[
        Param { name: "row_px", unit: "px", off: 0.0, step: 0.1, min: -50.0, max: 50.0 },
        Param { name: "col_px", unit: "px", off: 0.0, step: 0.1, min: -50.0, max: 50.0 },
    ],
};

impl Effect for ArrayShift {
    fn descriptor(&self) -> &'static Descriptor {
        &DESCRIPTOR
    }

    fn on_geometry(&self, p: &[f64], geometry: &mut Geometry, _cx: &FrameContext) {
        if p[0] == 0.0 && p[1] == 0.0 {
            return;
        }
        for anchor in &mut geometry.anchors_px {
            anchor[0] += p[0];
            anchor[1] += p[1];
        }
    }
}
