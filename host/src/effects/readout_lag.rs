//! Readout lag: the amplifier has not settled when a pixel is read, so a part of the pixel before is left in it.
//!
//! `y_x -> y_x + share (y_{x-1} - y_x)` along the row, in the order of the columns; the first column has none before it.
//! Catalogue 34.

use super::{Descriptor, Effect, FrameContext, Lookalike, Param, Stage};
use ndarray::Array2;

/// See the module.
pub(super) struct ReadoutLag;

static DESCRIPTOR: Descriptor = Descriptor {
    id: "readout_lag",
    stage: Stage::Electronics,
    summary: "y + share (y_before - y) along the row: the amplifier settles late",
    params: &[Param::strength("share", "1", 0.002, -0.5, 0.9)],
    lookalikes: &[
        Lookalike { id: "rank_truncation", separate_by: "flip the readout: a coma of the lens stays, the lag turns" },
        Lookalike { id: "interpixel_capacitance", separate_by: "covariance of flats: a lag has it along rows only" },
        Lookalike { id: "array_shift", separate_by: "flip the readout: a shift of the array stays" },
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
