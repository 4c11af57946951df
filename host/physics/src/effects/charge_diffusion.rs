//! Charge diffusion: photo-electrons diffuse before they are collected. This blurs the light and leaves the noise
//! white.
//!
//! `mu -> g * mu`, a convolution with a Gaussian g of standard deviation `sigma_px`, which conserves the
//! charge. Source: Janesick, *Scientific Charge-Coupled Devices*, 2001, ch. 4.

use super::context::FrameContext;
use super::descriptor::{Descriptor, Lookalike, Param, Stage};
use super::effect::Effect;
use super::smooth::spread;
use ndarray::Array2;

/// The effect; its formula is in the documentation of the module.
pub(super) struct ChargeDiffusion;

static DESCRIPTOR: Descriptor = Descriptor {
    id: "charge_diffusion",
    stage: Stage::Light,
    summary: "g_sigma * mu before the Poisson draw: electrons diffuse before they are collected",
    params: &[Param::square("sigma_px", "px", 0.05, 3.0)],
    lookalikes: &[
        Lookalike {
            id: "interpixel_capacitance",
            separate_by: "covariance of flats: capacitance correlates neighbours, diffusion does not",
        },
        Lookalike { id: "defocus", separate_by: "depth scan: diffusion is the same at every depth" },
        Lookalike { id: "motion_blur", separate_by: "beads: diffusion blurs them too, motion does not" },
    ],
};

impl Effect for ChargeDiffusion {
    fn descriptor(&self) -> &'static Descriptor {
        &DESCRIPTOR
    }

    fn on_light(&self, p: &[f64], light_e: &mut Array2<f32>, _cx: &FrameContext<'_>) {
        if p[0] > 0.0 {
            let variance = p[0] * p[0];
            spread(light_e, [variance, variance, 0.0]);
        }
    }
}
