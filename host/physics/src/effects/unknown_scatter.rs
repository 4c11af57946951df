//! Unnamed scatter: light of each point goes to places round it, by a law of any form.
//!
//! `mu -> mu + sum_k w_k (g_k * mu - mu)` with Gaussians g_k of standard deviations [`SIGMAS_PX`]. Each is twice as
//! wide as the one before, so that their sum follows any law that falls with the distance from a few pixels to a
//! hundred; shares of both signs make rings. It acts on specimens and beads: a flat field, which is lit from beyond the
//! sensor as well, does not show it. Light that is scattered off the sensor is lost.

use super::context::FrameContext;
use super::descriptor::{Descriptor, Param, Stage};
use super::effect::Effect;
use super::smooth::{changed, gaussian_blur};
use ndarray::{Array2, Zip};

/// The effect; its formula is in the documentation of the module.
pub(super) struct UnknownScatter;

/// Standard deviations of the Gaussians, px.
const SIGMAS_PX: [f64; 5] = [3.0, 6.0, 12.0, 24.0, 48.0];

const fn share(name: &'static str) -> Param {
    Param::strength(name, "1", 0.001, -1.0, 1.0)
}

static DESCRIPTOR: Descriptor = Descriptor {
    id: "unknown_scatter",
    stage: Stage::Light,
    summary: "mu + sum w_k (g_k * mu - mu): an unnamed term, light goes to places round each point",
    params: &[share("of_3_px"), share("of_6_px"), share("of_12_px"), share("of_24_px"), share("of_48_px")],
    lookalikes: &[],
};

impl Effect for UnknownScatter {
    fn descriptor(&self) -> &'static Descriptor {
        &DESCRIPTOR
    }

    fn on_light(&self, p: &[f64], light_e: &mut Array2<f32>, cx: &FrameContext<'_>) {
        if !cx.shows_specimen() {
            return;
        }
        let mut moved = Array2::<f32>::zeros(light_e.dim());
        for (share, sigma_px) in p.iter().zip(SIGMAS_PX).filter(|(share, _)| **share != 0.0) {
            let share = *share as f32;
            let blurred = gaussian_blur(light_e, sigma_px);
            Zip::from(&mut moved).and(&blurred).and(&*light_e).for_each(|m, to, from| *m += share * (to - from));
        }
        light_e.zip_mut_with(&moved, |v, m| *v = changed(*v, *m));
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use ommatidia_session::Role;

    #[test]
    fn shares_of_a_point_lie_round_it_and_a_flat_stays_even() {
        let mut point = Array2::<f32>::zeros((201, 201));
        point[[100, 100]] = 1e4;
        let cx = FrameContext { role: Role::Scene, ..FrameContext::default() };
        let p = [0.0, 0.05, 0.0, 0.1, 0.0];
        let mut scene = point.clone();
        UnknownScatter.on_light(&p, &mut scene, &cx);
        // 1 / (2 pi sigma^2) of each share at the centre, and all light is kept.
        let centre = 8500.0 + 500.0 / (std::f64::consts::TAU * 36.0) + 1000.0 / (std::f64::consts::TAU * 576.0);
        assert!((f64::from(scene[[100, 100]]) / centre - 1.0).abs() < 1e-4, "{}", scene[[100, 100]]);
        assert!((scene.sum() / 1e4 - 1.0).abs() < 1e-3, "{}", scene.sum());
        let at_24 = 500.0 / (std::f64::consts::TAU * 36.0) * (-8.0f64).exp()
            + 1000.0 / (std::f64::consts::TAU * 576.0) * (-0.5f64).exp();
        assert!((f64::from(scene[[124, 100]]) / at_24 - 1.0).abs() < 1e-2, "{} {at_24}", scene[[124, 100]]);
        let mut flat = Array2::from_elem((20, 30), 50.0f32);
        UnknownScatter.on_light(&p, &mut flat, &FrameContext { role: Role::Flat, ..FrameContext::default() });
        assert!(flat.iter().all(|v| *v == 50.0));
    }
}
