//! Brighter-fatter: charge in a pixel bends the field lines, so that later electrons end up next to it.
//!
//! `Q_i -> Q_i + alpha / full_scale sum_n (Q_n - Q_i) (Q_n + Q_i) / 2`, n = the four neighbours: the flow over each border grows with
//! the charge beside it. It keeps the charge, widens bright spots, and takes variance from flats and puts it between neighbours.
//! Catalogue 24 (Antilogus et al., JINST 9, C03048, 2014).

use super::smooth::couple;
use super::{Descriptor, Effect, FrameContext, Lookalike, Param, Stage};
use ndarray::Array2;

/// See the module.
pub(super) struct BrighterFatter;

static DESCRIPTOR: Descriptor = Descriptor {
    id: "brighter_fatter",
    stage: Stage::Charge,
    summary: "Q + alpha / full scale sum_n (Q_n^2 - Q^2) / 2: bright spots repel charge",
    params: &[Param::strength("alpha", "1", 0.005, 0.0, 0.1)],
    lookalikes: &[
        Lookalike { id: "nonlinearity", separate_by: "covariance of flats: a bend of the response has none" },
        Lookalike { id: "noise_scale", separate_by: "covariance of flats: a wrong gain has none" },
        Lookalike {
            id: "interpixel_capacitance",
            separate_by: "foci at two light levels: a capacitance widens both alike",
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
        // What flows is the coupling of the squares.
        let square = charge_e.mapv(|q| q.max(0.0).powi(2));
        let mut coupled = square.clone();
        couple(&mut coupled, (p[0] / 2.0 / cx.full_scale_e) as f32);
        coupled -= &square;
        *charge_e += &coupled;
    }
}
