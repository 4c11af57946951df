//! Nonlinearity: the response bends down towards full scale.
//!
//! `Q -> Q - beta Q^2 / full_scale`. Catalogue 25.

use super::{Descriptor, Effect, FrameContext, Lookalike, Param, Stage};
use ndarray::Array2;

/// See the module.
pub(super) struct Nonlinearity;

static DESCRIPTOR: Descriptor = Descriptor {
    id: "nonlinearity",
    stage: Stage::Charge,
    summary: "Q - beta Q^2 / full scale: the response bends towards full scale",
    params: &[Param::strength("beta", "1", 0.005, -0.5, 0.5)],
    lookalikes: &[
        Lookalike { id: "exposure_offset", separate_by: "a ladder of lamp powers at one exposure" },
        Lookalike { id: "saturation", separate_by: "leave out the brightest pixels: a bend of the response stays" },
        Lookalike { id: "brighter_fatter", separate_by: "covariance of flats: a bend of the response has none" },
        Lookalike {
            id: "adc_nonlinearity",
            separate_by: "histogram of a bright ramp: a converter jumps at one code, a curve is smooth",
        },
    ],
};

impl Effect for Nonlinearity {
    fn descriptor(&self) -> &'static Descriptor {
        &DESCRIPTOR
    }

    fn on_charge(&self, p: &[f64], charge_e: &mut Array2<f32>, cx: &FrameContext<'_>) {
        if p[0] == 0.0 || cx.full_scale_e <= 0.0 {
            return;
        }
        let bend = (p[0] / cx.full_scale_e) as f32;
        charge_e.mapv_inplace(|q| q - bend * q * q);
    }
}
