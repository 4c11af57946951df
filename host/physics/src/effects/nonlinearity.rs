//! Nonlinearity: the response falls below a straight line towards full scale.
//!
//! `Q -> Q - beta Q^2 / full_scale`.

use super::context::FrameContext;
use super::descriptor::{Descriptor, Lookalike, Param, Stage};
use super::effect::Effect;
use ndarray::Array2;

/// The effect; its formula is in the documentation of the module.
pub(super) struct Nonlinearity;

static DESCRIPTOR: Descriptor = Descriptor {
    id: "nonlinearity",
    stage: Stage::Charge,
    summary: "Q - beta Q^2 / full scale: the response falls below a straight line towards full scale",
    params: &[Param::strength("beta", "1", 0.005, -0.5, 0.5)],
    lookalikes: &[
        Lookalike {
            id: "exposure_offset",
            separate_by: "several lamp powers at one exposure: only nonlinearity depends on the power",
        },
        Lookalike {
            id: "saturation",
            separate_by: "leave out the brightest pixels: nonlinearity remains, saturation does not",
        },
        Lookalike {
            id: "brighter_fatter",
            separate_by: "covariance of flats: nonlinearity does not correlate neighbours",
        },
        Lookalike {
            id: "adc_nonlinearity",
            separate_by: "histogram of a bright ramp: a converter step is at one code, a nonlinearity is smooth",
        },
    ],
};

impl Effect for Nonlinearity {
    fn descriptor(&self) -> &'static Descriptor {
        &DESCRIPTOR
    }

    fn bends_noise(&self) -> bool {
        true
    }

    fn on_charge(&self, p: &[f64], charge_e: &mut Array2<f32>, cx: &FrameContext<'_>) {
        if p[0] == 0.0 || cx.full_scale_e <= 0.0 {
            return;
        }
        let bend = (p[0] / cx.full_scale_e) as f32;
        charge_e.mapv_inplace(|q| q - bend * q * q);
    }
}
