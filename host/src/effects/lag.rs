//! Lag: a part of the charge of the frame before stays behind.
//!
//! `mu -> mu + share mu_before exp(-dt / tau)`, dt = from the start of one exposure to the next. It is added before the Poisson
//! draw: what is left of Poisson counts, electron by electron, is Poisson again. Only the frame directly before counts. With
//! frames at even intervals share and tau are one number, so tau is given. Catalogue 28.

use super::{Descriptor, Effect, FrameContext, Lookalike, Param, Stage};
use ndarray::Array2;

/// See the module.
pub(super) struct Lag;

static DESCRIPTOR: Descriptor = Descriptor {
    id: "lag",
    stage: Stage::Light,
    summary: "mu + share mu_before exp(-dt / tau): charge of the frame before stays behind",
    params: &[Param::strength("share", "1", 0.001, 0.0, 1.0), Param::choice("tau_s", "s", 0.05, [1e-6, 1e4])],
    lookalikes: &[
        Lookalike { id: "thermal_drift", separate_by: "a dark frame after a bright one" },
        Lookalike { id: "background", separate_by: "a dark frame after a bright one" },
        Lookalike { id: "ghost", separate_by: "the same specimen twice: a lag repeats it, a ghost turns it" },
    ],
};

impl Effect for Lag {
    fn descriptor(&self) -> &'static Descriptor {
        &DESCRIPTOR
    }

    fn on_light(&self, p: &[f64], light_e: &mut Array2<f32>, cx: &FrameContext<'_>) {
        let Some(previous) = cx.previous.filter(|b| b.light_e.dim() == light_e.dim()) else { return };
        if p[0] == 0.0 {
            return;
        }
        let left = (p[0] * (-previous.interval_s.max(0.0) / p[1]).exp()) as f32;
        light_e.zip_mut_with(previous.light_e, |v, before| *v += left * before);
    }

    fn needs_previous(&self) -> bool {
        true
    }
}
