//! Halo: part of the light of each point is scattered far outside the PSF window, e.g. by turbid media or dirty optics.
//!
//! `mu -> (1 - weight) mu + weight (g * mu)` with a Gaussian g of standard deviation `sigma_px`. It acts on specimens
//! and beads, whose light is lost where it is scattered off the sensor. A flat field, which is lit from beyond the
//! sensor as well, does not show it.

use super::context::FrameContext;
use super::descriptor::{Descriptor, Lookalike, Param, Stage};
use super::effect::Effect;
use super::smooth::gaussian_blur;
use ndarray::Array2;

/// The effect; its formula is in the documentation of the module.
pub(super) struct Halo;

static DESCRIPTOR: Descriptor = Descriptor {
    id: "halo",
    stage: Stage::Light,
    summary: "(1 - weight) mu + weight g_sigma * mu: scattered light around each point",
    params: &[
        Param::strength("weight", "1", 0.001, 0.0, 1.0),
        Param::shape("sigma_px", "px", 12.0, 2.0, [0.5, 500.0], &[4.0, 12.0, 36.0]),
    ],
    lookalikes: &[
        Lookalike { id: "veiling_glare", separate_by: "a single bright bead: glare is even over the sensor" },
        Lookalike {
            id: "charge_diffusion",
            separate_by: "a single bright bead: diffusion reaches only one or two pixels",
        },
        Lookalike {
            id: "ghost",
            separate_by: "a single bright bead off the centre: a ghost appears on the other side of the centre",
        },
    ],
};

impl Effect for Halo {
    fn descriptor(&self) -> &'static Descriptor {
        &DESCRIPTOR
    }

    fn on_light(&self, p: &[f64], light_e: &mut Array2<f32>, cx: &FrameContext<'_>) {
        if p[0] == 0.0 || !cx.shows_specimen() {
            return;
        }
        let scattered = gaussian_blur(light_e, p[1]);
        let w = p[0] as f32;
        light_e.zip_mut_with(&scattered, |v, s| *v = (1.0 - w) * *v + w * s);
    }
}
