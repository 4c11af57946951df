//! Saturation: the wells of the pixels are full below the full scale of the converter.
//!
//! `Q -> Q (1 + (W^-8 - 1) (Q / full scale)^8)^(-1/8)`, W = 1 - below: charge at full scale becomes W of full scale,
//! the depth of the well, and small charges hardly change. Because the transition is smooth, a fit can start from a
//! well as deep as the full scale. Of the lost charge, the share `spill` goes to the pixels above and below, half each
//! (blooming along the column).

use super::context::FrameContext;
use super::descriptor::{Descriptor, Lookalike, Param, Stage};
use super::effect::Effect;
use ndarray::Array2;

/// The effect; its formula is in the documentation of the module.
pub(super) struct Saturation;

static DESCRIPTOR: Descriptor = Descriptor {
    id: "saturation",
    stage: Stage::Charge,
    summary: "Q is limited to (1 - below) full scale, lost charge spills along the column: the wells are full early",
    params: &[
        Param::strength("below", "share of full scale", 0.1, 0.0, 0.95),
        Param::shape("spill", "1", 0.0, 0.1, [0.0, 1.0], &[0.0]),
    ],
    lookalikes: &[
        Lookalike {
            id: "nonlinearity",
            separate_by: "leave out the brightest pixels: nonlinearity remains, saturation does not",
        },
        Lookalike {
            id: "adc_nonlinearity",
            separate_by: "histogram of a bright ramp: a converter step leaves a gap at one code",
        },
    ],
};

fn eighth_power(q: f64) -> f64 {
    let q2 = q * q;
    let q4 = q2 * q2;
    q4 * q4
}

impl Effect for Saturation {
    fn descriptor(&self) -> &'static Descriptor {
        &DESCRIPTOR
    }

    fn on_charge(&self, p: &[f64], charge_e: &mut Array2<f32>, cx: &FrameContext<'_>) {
        if p[0] == 0.0 || cx.full_scale_e <= 0.0 {
            return;
        }
        let bend = 1.0 / eighth_power(1.0 - p[0]) - 1.0;
        let mut lost = Array2::<f32>::zeros(if p[1] > 0.0 { charge_e.dim() } else { (0, 0) });
        for ((r, c), v) in charge_e.indexed_iter_mut().filter(|(_, v)| **v > 0.0) {
            let q = f64::from(*v);
            let kept = (q / (1.0 + bend * eighth_power(q / cx.full_scale_e)).sqrt().sqrt().sqrt()) as f32;
            if let Some(lost) = lost.get_mut((r, c)) {
                *lost = *v - kept;
            }
            *v = kept;
        }
        let half = (p[1] / 2.0) as f32;
        for (r, row) in lost.outer_iter().enumerate() {
            let near = [r.checked_sub(1), Some(r + 1).filter(|n| *n < lost.nrows())];
            for n in near.into_iter().flatten() {
                charge_e.row_mut(n).scaled_add(half, &row);
            }
        }
    }
}
