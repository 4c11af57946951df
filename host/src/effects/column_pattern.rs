//! Column pattern: a fixed periodic offset over the columns, e.g. from one converter per column or a few in turn.
//!
//! `y -> y + amplitude cos(2 pi col / period) + quadrature sin(2 pi col / period)`. At a period of 2 (even and odd
//! columns) the sine is zero in every column, and only the amplitude matters.

use super::context::FrameContext;
use super::descriptor::{Descriptor, Lookalike, Param, Stage};
use super::effect::Effect;
use super::evidence::Evidence;
use super::row_pattern::lines;
use super::wave::{periods, wave};
use ndarray::{Array2, Axis};

/// The effect; its formula is in the documentation of the module.
pub(super) struct ColumnPattern;

static DESCRIPTOR: Descriptor = Descriptor {
    id: "column_pattern",
    stage: Stage::Electronics,
    summary: "y + amplitude cos + quadrature sin of 2 pi col / period: a fixed periodic offset over the columns",
    params: &[
        Param::strength("amplitude_dn", "DN", 0.2, -1e4, 1e4),
        Param::strength("quadrature_dn", "DN", 0.2, -1e4, 1e4),
        Param::shape("period_cols", "columns", 4.0, 0.02, [1.0, 1e5], &[2.0, 4.0]),
    ],
    lookalikes: &[
        Lookalike { id: "pixel_mosaic", separate_by: "darks: an alternating gain has no effect without light" },
        Lookalike { id: "dsnu", separate_by: "darks: a pattern is the same in every row" },
    ],
};

impl Effect for ColumnPattern {
    fn descriptor(&self) -> &'static Descriptor {
        &DESCRIPTOR
    }

    fn on_electronics(&self, p: &[f64], frame_dn: &mut Array2<f32>, _cx: &FrameContext<'_>) {
        if p[0] == 0.0 && p[1] == 0.0 {
            return;
        }
        let offsets = wave(frame_dn.ncols(), p[0], p[1], p[2]);
        for mut row in frame_dn.outer_iter_mut() {
            row.iter_mut().zip(&offsets).for_each(|(v, offset)| *v += offset);
        }
    }

    fn chances(&self, [_, cols]: [usize; 2], _frames: usize) -> f64 {
        cols as f64 / 2.0
    }

    /// Periods at the peaks in the spectrum of the columns' mean residuals.
    fn guess(&self, evidence: &Evidence<'_>) -> Vec<Vec<f64>> {
        let (sums, weights) = lines(evidence, Axis(1));
        periods(&sums, &weights).into_iter().map(|period| vec![0.0, 0.0, period]).collect()
    }

    fn is_of_the_grid(&self) -> bool {
        true
    }
}
