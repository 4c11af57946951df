//! Brighter-fatter effect: charge in a pixel bends the field lines, so that later electrons are collected next to it.
//!
//! `Q_i -> Q_i + alpha / full_scale sum_n (Q_n - Q_i) (Q_n + Q_i) / 2` over the four neighbours n: the flow over each
//! border grows with the charge on both sides. The effect conserves charge, widens bright spots, lowers the variance of
//! flats and correlates neighbouring pixels. Source: Antilogus et al., JINST 9, C03048, 2014.

use super::context::FrameContext;
use super::descriptor::{Descriptor, Lookalike, Param, Stage};
use super::effect::Effect;
use super::smooth::couple;
use ndarray::Array2;

/// The effect; its formula is in the documentation of the module.
pub(super) struct BrighterFatter;

static DESCRIPTOR: Descriptor = Descriptor {
    id: "brighter_fatter",
    stage: Stage::Charge,
    summary: "Q + alpha / full scale sum_n (Q_n^2 - Q^2) / 2: bright spots repel charge",
    params: &[Param::strength("alpha", "1", 0.005, 0.0, 0.1)],
    lookalikes: &[
        Lookalike {
            id: "nonlinearity",
            separate_by: "covariance of flats: nonlinearity does not correlate neighbours",
        },
        Lookalike { id: "noise_scale", separate_by: "covariance of flats: a wrong gain does not correlate neighbours" },
        Lookalike {
            id: "interpixel_capacitance",
            separate_by: "foci at two light levels: capacitance widens both equally",
        },
    ],
};

impl Effect for BrighterFatter {
    fn descriptor(&self) -> &'static Descriptor {
        &DESCRIPTOR
    }

    fn on_charge(&self, p: &[f64], charge_e: &mut Array2<f32>, cx: &FrameContext<'_>) {
        if p[0] == 0.0 || cx.full_scale_e <= 0.0 {
            return;
        }
        // The flow is the coupling of the squares.
        let square = charge_e.mapv(|q| q.max(0.0).powi(2));
        let mut coupled = square.clone();
        couple(&mut coupled, (p[0] / 2.0 / cx.full_scale_e) as f32);
        coupled -= &square;
        *charge_e += &coupled;
    }
}
