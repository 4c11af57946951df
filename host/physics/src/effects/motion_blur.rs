//! Motion blur: the specimen moves during the exposure.
//!
//! `mu -> g * mu` with a Gaussian g of the variances var_row and var_col and the covariance cov, px^2: to second order
//! in the frequency, the blur of any motion with these variances. Scenes only: the bead does not move.

use super::context::FrameContext;
use super::descriptor::{Descriptor, Lookalike, Param, Stage};
use super::effect::Effect;
use super::smooth::spread;
use ndarray::Array2;
use ommatidia_session::Role;

/// The effect; its formula is in the documentation of the module.
pub(super) struct MotionBlur;

static DESCRIPTOR: Descriptor = Descriptor {
    id: "motion_blur",
    stage: Stage::Light,
    summary: "blur with variances var_row, var_col and covariance cov: the specimen moves during the exposure",
    params: &[
        Param::strength("var_row_px2", "px^2", 0.005, 0.0, 25.0),
        Param::strength("var_col_px2", "px^2", 0.005, 0.0, 25.0),
        Param::strength("cov_px2", "px^2", 0.005, -25.0, 25.0),
    ],
    lookalikes: &[
        Lookalike { id: "defocus", separate_by: "repeats at a shorter exposure: motion blur shrinks" },
        Lookalike { id: "rank_truncation", separate_by: "repeats at a shorter exposure: motion blur shrinks" },
        Lookalike { id: "charge_diffusion", separate_by: "beads: diffusion blurs them too, motion does not" },
    ],
};

impl Effect for MotionBlur {
    fn descriptor(&self) -> &'static Descriptor {
        &DESCRIPTOR
    }

    fn on_light(&self, p: &[f64], light_e: &mut Array2<f32>, cx: &FrameContext<'_>) {
        if cx.role == Role::Scene && p.iter().any(|v| *v != 0.0) {
            spread(light_e, [p[0], p[1], p[2]]);
        }
    }
}
