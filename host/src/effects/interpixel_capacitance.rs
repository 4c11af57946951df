//! Interpixel capacitance: each pixel reads part of the charge of its neighbours. It acts after the Poisson draw, so
//! the noise of neighbours becomes correlated.
//!
//! `Q -> Q (1 - 4 alpha) + alpha (up + down + left + right)`; pixels at the edge keep the share of missing neighbours.
//! Source: Moore, Ninkov, Forrest, Opt. Eng. 45, 076402, 2006.

use super::context::FrameContext;
use super::descriptor::{Descriptor, Lookalike, Param, Stage};
use super::effect::Effect;
use super::smooth::couple;
use ndarray::Array2;

/// The effect; its formula is in the documentation of the module.
pub(super) struct InterpixelCapacitance;

static DESCRIPTOR: Descriptor = Descriptor {
    id: "interpixel_capacitance",
    stage: Stage::Charge,
    summary: "Q (1 - 4 alpha) + alpha sum of 4 neighbours, after the Poisson draw: neighbours share their charge",
    params: &[Param::strength("alpha", "1", 0.005, 0.0, 0.25)],
    lookalikes: &[
        Lookalike {
            id: "charge_diffusion",
            separate_by: "covariance of flats: capacitance correlates neighbours, diffusion does not",
        },
        Lookalike { id: "defocus", separate_by: "flats: capacitance correlates the noise of neighbours" },
        Lookalike {
            id: "readout_lag",
            separate_by: "covariance of flats: a readout lag correlates neighbours along rows only",
        },
    ],
};

impl Effect for InterpixelCapacitance {
    fn descriptor(&self) -> &'static Descriptor {
        &DESCRIPTOR
    }

    fn on_charge(&self, p: &[f64], charge_e: &mut Array2<f32>, _cx: &FrameContext<'_>) {
        if p[0] > 0.0 {
            couple(charge_e, p[0] as f32);
        }
    }
}
