//! Readout lag: the amplifier has not settled when a pixel is read, so part of the previous pixel remains in the
//! reading.
//!
//! `y_x -> y_x + share (y_{x-1} - y_x)` along the row, in the order of the columns; the first column has no previous
//! pixel.

use super::context::FrameContext;
use super::descriptor::{Descriptor, Lookalike, Param, Stage};
use super::effect::Effect;
use ndarray::Array2;

/// The effect; its formula is in the documentation of the module.
pub(super) struct ReadoutLag;

static DESCRIPTOR: Descriptor = Descriptor {
    id: "readout_lag",
    stage: Stage::Electronics,
    summary: "y + share (y_before - y) along the row: the amplifier has not settled when a pixel is read",
    params: &[Param::strength("share", "1", 0.002, -0.5, 0.9)],
    lookalikes: &[
        Lookalike {
            id: "rank_truncation",
            separate_by: "reverse the readout direction: coma of a lens does not change, a lag changes sides",
        },
        Lookalike {
            id: "interpixel_capacitance",
            separate_by: "covariance of flats: a readout lag correlates neighbours along rows only",
        },
        Lookalike {
            id: "array_shift",
            separate_by: "reverse the readout direction: a shift of the array does not change",
        },
    ],
};

impl Effect for ReadoutLag {
    fn descriptor(&self) -> &'static Descriptor {
        &DESCRIPTOR
    }

    fn on_electronics(&self, p: &[f64], frame_dn: &mut Array2<f32>, _cx: &FrameContext<'_>) {
        if p[0] == 0.0 {
            return;
        }
        let share = p[0] as f32;
        for mut row in frame_dn.outer_iter_mut() {
            let mut before = row.first().copied().unwrap_or(0.0);
            for v in &mut row {
                let own = *v;
                *v += share * (before - own);
                before = own;
            }
        }
    }
}
