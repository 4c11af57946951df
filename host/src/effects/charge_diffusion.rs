//! Charge diffusion: photo-electrons wander before they are collected, so it blurs the light but leaves the noise white.
//!
//! `mu -> g * mu`, g of standard deviation `sigma_px`, by explicit diffusion steps that keep the charge. Catalogue 22
//! (Janesick, *Scientific Charge-Coupled Devices*, 2001, ch. 4).

use super::smooth::diffuse;
use super::{Descriptor, Effect, FrameContext, Lookalike, Param, Stage};
use ndarray::Array2;

/// See the module.
pub(super) struct ChargeDiffusion;

static DESCRIPTOR: Descriptor = Descriptor {
    id: "charge_diffusion",
    stage: Stage::Light,
    summary: "g_sigma * mu before the Poisson draw: electrons wander before collection",
    params: &[Param::square("sigma_px", "px", 0.05, 3.0)],
    lookalikes: &[
        Lookalike {
            id: "interpixel_capacitance",
            separate_by: "covariance of flats: capacitance correlates neighbours, diffusion does not",
        },
        Lookalike { id: "defocus", separate_by: "depth scan: diffusion is the same at every depth" },
        Lookalike { id: "motion_blur", separate_by: "beads: diffusion is there too, motion is not" },
    ],
};

impl Effect for ChargeDiffusion {
    fn descriptor(&self) -> &'static Descriptor {
        &DESCRIPTOR
    }

    fn on_light(&self, p: &[f64], light_e: &mut Array2<f32>, _cx: &FrameContext<'_>) {
        if p[0] > 0.0 {
            diffuse(light_e, p[0] * p[0]);
        }
    }
}
