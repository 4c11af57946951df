//! Interpixel capacitance: each pixel shows a part of its neighbours' charge; after the Poisson draw, so the noise of
//! neighbours becomes correlated.
//!
//! `Q -> Q (1 - 4 alpha) + alpha (up + down + left + right)`; edge pixels keep what has no neighbour. Catalogue 23
//! (Moore, Ninkov, Forrest, Opt. Eng. 45, 076402, 2006).

use super::smooth::couple;
use super::{Descriptor, Effect, FrameContext, Lookalike, Param, Stage};
use ndarray::Array2;

/// See the module.
pub(super) struct InterpixelCapacitance;

static DESCRIPTOR: Descriptor = Descriptor {
    id: "interpixel_capacitance",
    stage: Stage::Charge,
    summary: "Q (1 - 4 alpha) + alpha sum of 4 neighbours, after the Poisson draw",
    params: &[Param::strength("alpha", "1", 0.005, 0.0, 0.25)],
    lookalikes: &[
        Lookalike {
            id: "charge_diffusion",
            separate_by: "covariance of flats: capacitance correlates neighbours, diffusion does not",
        },
        Lookalike { id: "defocus", separate_by: "flats: capacitance correlates the noise of neighbours" },
        Lookalike { id: "readout_lag", separate_by: "covariance of flats: a lag has it along rows only" },
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
