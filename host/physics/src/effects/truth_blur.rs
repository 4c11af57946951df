//! Blurred truths: the pictures of the specimens that a session holds are less sharp than the specimens were, as those
//! that were interpolated, or taken by a camera of less resolution.
//!
//! A truth t = g * x of the specimen x, with a Gaussian g of variance var, px^2 of the object, predicts `g * mu` in
//! place of mu: the frames look sharper than predicted. `mu -> g^(-1) * mu`, to first order `mu - var / 2 laplace(mu)`
//! (heat equation). Scenes only. It belongs to the truths, and no instrument has it.

use super::context::FrameContext;
use super::descriptor::{Descriptor, Lookalike, Param, Stage};
use super::effect::Effect;
use super::smooth::spread;
use ndarray::Array2;
use ommatidia_session::Role;

/// The effect; its formula is in the documentation of the module.
pub(super) struct TruthBlur;

static DESCRIPTOR: Descriptor = Descriptor {
    id: "truth_blur",
    stage: Stage::Light,
    summary: "light of scenes without a blur of variance var: the truths of the session are blurred, the specimens not",
    // Beyond 2 px^2 the smallest details are amplified more than a thousandfold.
    params: &[Param::strength("var_px2", "px^2", 0.005, 0.0, 2.0)],
    lookalikes: &[
        Lookalike { id: "defocus", separate_by: "a new bead scan: with blurred truths its PSFs are those of before" },
        Lookalike {
            id: "spectral_shift",
            separate_by: "a new bead scan: with blurred truths its PSFs are those of before",
        },
    ],
};

impl Effect for TruthBlur {
    fn descriptor(&self) -> &'static Descriptor {
        &DESCRIPTOR
    }

    fn is_of_truths(&self) -> bool {
        true
    }

    fn on_light(&self, p: &[f64], light_e: &mut Array2<f32>, cx: &FrameContext<'_>) {
        if cx.role == Role::Scene && p[0] != 0.0 {
            spread(light_e, [-p[0], -p[0], 0.0]);
        }
    }
}
