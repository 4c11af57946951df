//! Row pattern: a fixed periodic offset over the rows.
//!
//! `y -> y + amplitude cos(2 pi row / period) + quadrature sin(2 pi row / period)`. At a period of 2 (even and odd
//! rows) the sine is zero in every row, and only the amplitude matters.

use super::context::FrameContext;
use super::descriptor::{Descriptor, Lookalike, Param, Stage};
use super::effect::Effect;
use super::evidence::Evidence;
use super::wave::{periods, wave};
use ndarray::{Array2, Axis};

/// The effect; its formula is in the documentation of the module.
pub(super) struct RowPattern;

static DESCRIPTOR: Descriptor = Descriptor {
    id: "row_pattern",
    stage: Stage::Electronics,
    summary: "y + amplitude cos + quadrature sin of 2 pi row / period: a fixed periodic offset over the rows",
    params: &[
        Param::strength("amplitude_dn", "DN", 0.2, -1e4, 1e4),
        Param::strength("quadrature_dn", "DN", 0.2, -1e4, 1e4),
        Param::shape("period_rows", "rows", 4.0, 0.02, [1.0, 1e5], &[2.0, 4.0]),
    ],
    lookalikes: &[
        Lookalike { id: "flicker_banding", separate_by: "darks: a fixed pattern is there too, and does not move" },
        Lookalike { id: "row_noise", separate_by: "repeated frames: row noise differs from frame to frame" },
    ],
};

impl Effect for RowPattern {
    fn descriptor(&self) -> &'static Descriptor {
        &DESCRIPTOR
    }

    fn on_electronics(&self, p: &[f64], frame_dn: &mut Array2<f32>, _cx: &FrameContext<'_>) {
        if p[0] == 0.0 && p[1] == 0.0 {
            return;
        }
        let offsets = wave(frame_dn.nrows(), p[0], p[1], p[2]);
        for (mut row, offset) in frame_dn.outer_iter_mut().zip(offsets) {
            row.mapv_inplace(|v| v + offset);
        }
    }

    fn is_of_the_grid(&self) -> bool {
        true
    }

    fn chances(&self, [rows, _]: [usize; 2], _frames: usize) -> f64 {
        rows as f64 / 2.0
    }

    /// Periods at the peaks in the spectrum of the rows' mean residuals.
    fn guess(&self, evidence: &Evidence<'_>) -> Vec<Vec<f64>> {
        let (sums, weights) = lines(evidence, Axis(0));
        periods(&sums, &weights).into_iter().map(|period| vec![0.0, 0.0, period]).collect()
    }
}

/// Sums over all frames, for each row (axis 0) or column (axis 1): weighted residuals, and weights.
pub(super) fn lines(evidence: &Evidence<'_>, axis: Axis) -> (Vec<f64>, Vec<f64>) {
    let n = evidence.frames.first().map_or(0, |f| f.weight.len_of(axis));
    let (mut sums, mut weights) = (vec![0.0; n], vec![0.0; n]);
    for frame in &evidence.frames {
        let lines = frame.residual_dn.axis_iter(axis).zip(frame.weight.axis_iter(axis));
        for ((residual, weight), (s, w)) in lines.zip(sums.iter_mut().zip(&mut weights)) {
            *s += residual.iter().zip(&weight).map(|(r, w)| f64::from(*r) * f64::from(*w)).sum::<f64>();
            *w += weight.iter().map(|w| f64::from(*w)).sum::<f64>();
        }
    }
    (sums, weights)
}
