//! Converter step: readings above one code are offset, e.g. where the converter switches to a second gain or reference.
//!
//! `y -> y + step` where `y - black > at` times full scale.

use super::context::FrameContext;
use super::descriptor::{Descriptor, Lookalike, Param, Stage};
use super::effect::Effect;
use ndarray::Array2;

/// The effect; its formula is in the documentation of the module.
pub(super) struct AdcNonlinearity;

static DESCRIPTOR: Descriptor = Descriptor {
    id: "adc_nonlinearity",
    stage: Stage::Electronics,
    summary: "y + step above a share of full scale: a step of the converter at one code",
    params: &[
        Param::strength("step_dn", "DN", 1.0, -1e4, 1e4),
        Param::shape("at", "share of full scale", 0.25, 0.01, [0.0, 1.0], &[0.125, 0.25, 0.5]),
    ],
    lookalikes: &[
        Lookalike {
            id: "nonlinearity",
            separate_by: "histogram of a bright ramp: a converter step is at one code, a nonlinearity is smooth",
        },
        Lookalike {
            id: "saturation",
            separate_by: "histogram of a bright ramp: a converter step leaves a gap at one code",
        },
    ],
};

impl Effect for AdcNonlinearity {
    fn descriptor(&self) -> &'static Descriptor {
        &DESCRIPTOR
    }

    fn on_electronics(&self, p: &[f64], frame_dn: &mut Array2<f32>, cx: &FrameContext<'_>) {
        if p[0] == 0.0 {
            return;
        }
        let code = (cx.black_level_dn + p[1] * cx.full_scale_e * cx.gain_dn_per_e) as f32;
        let step = p[0] as f32;
        frame_dn.mapv_inplace(|v| if v > code { v + step } else { v });
    }
}
