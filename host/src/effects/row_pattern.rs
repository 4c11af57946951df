//! Row pattern: a fixed wave of the offset along the rows, by default from even to odd.
//!
//! `y -> y + amplitude cos(2 pi (row / period + phase))`. Catalogue 32.

use super::{Descriptor, Effect, FrameContext, Param, Stage};
use ndarray::Array2;
use std::f64::consts::TAU;

/// See the module.
pub(super) struct RowPattern;

static DESCRIPTOR: Descriptor = Descriptor {
    id: "row_pattern",
    stage: Stage::Electronics,
    summary: "y + amplitude cos(2 pi (row / period + phase)): fixed offset by row",
    params: &[
        Param::strength("amplitude_dn", "DN", 0.5, -1e4, 1e4),
        Param::shape("period_rows", "rows", 2.0, 0.1, [1.0, 1e5], &[]),
        Param::shape("phase", "turns", 0.0, 0.05, [-1.0, 1.0], &[]),
    ],
    lookalikes: &[],
};

impl Effect for RowPattern {
    fn descriptor(&self) -> &'static Descriptor {
        &DESCRIPTOR
    }

    fn on_electronics(&self, p: &[f64], frame_dn: &mut Array2<f32>, _cx: &FrameContext<'_>) {
        if p[0] == 0.0 {
            return;
        }
        for (r, mut row) in frame_dn.outer_iter_mut().enumerate() {
            let offset = (p[0] * (TAU * (r as f64 / p[1] + p[2])).cos()) as f32;
            row.mapv_inplace(|v| v + offset);
        }
    }
}
