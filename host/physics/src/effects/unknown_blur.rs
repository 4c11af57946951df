//! Unnamed blur: the image of each lens is wider, or narrower, than in the calibration.
//!
//! A PSF whose second moments change by `V_l` is `g * h` with a Gaussian g of these variances, to first order
//! `h + (V_rr d2/dr2 + V_cc d2/dc2 + 2 V_rc d2/drdc) h / 2`. Negative variances sharpen the image.

use super::context::FrameContext;
use super::descriptor::{Descriptor, Param, Stage};
use super::effect::Effect;
use super::smooth::spread;
use ndarray::Array2;

/// The effect; its formula is in the documentation of the module.
pub(super) struct UnknownBlur;

const fn variance(name: &'static str) -> Param {
    Param::strength(name, "px^2", 0.01, -0.4, 10.0).per_lens()
}

static DESCRIPTOR: Descriptor = Descriptor {
    id: "unknown_blur",
    stage: Stage::Lens,
    summary: "h + V h'' / 2: an unnamed term, the image of each lens is wider or narrower than in the calibration",
    params: &[variance("var_row_px2"), variance("var_col_px2"), variance("cov_px2")],
    lookalikes: &[],
};

impl Effect for UnknownBlur {
    fn descriptor(&self) -> &'static Descriptor {
        &DESCRIPTOR
    }

    fn on_lens(&self, p: &[f64], image_e: &mut Array2<f32>, cx: &FrameContext<'_>) {
        let lenses = p.len() / DESCRIPTOR.params.len();
        if cx.lens >= lenses {
            return;
        }
        let of = |which: usize| p[which * lenses + cx.lens];
        let variances = [of(0), of(1), of(2)];
        if variances.iter().any(|v| *v != 0.0) {
            spread(image_e, variances);
        }
    }
}
