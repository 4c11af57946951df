//! Lag: part of the charge of the previous frame remains in the pixels.
//!
//! `mu -> mu + share mu_before exp(-dt / tau)`, where dt is the time from the start of one exposure to the next. The
//! remaining charge is added before the Poisson draw: a random share of Poisson counts is again Poisson distributed.
//! Only the previous frame counts. For frames at even intervals share and tau cannot be separated, so tau is set and
//! not fitted.

use super::context::FrameContext;
use super::descriptor::{Descriptor, Lookalike, Param, Stage};
use super::effect::Effect;
use ndarray::Array2;

/// The effect; its formula is in the documentation of the module.
pub(super) struct Lag;

static DESCRIPTOR: Descriptor = Descriptor {
    id: "lag",
    stage: Stage::Light,
    summary: "mu + share mu_before exp(-dt / tau): charge of the previous frame remains",
    params: &[Param::strength("share", "1", 0.001, 0.0, 1.0), Param::choice("tau_s", "s", 0.05, [1e-6, 1e4])],
    lookalikes: &[
        Lookalike {
            id: "thermal_drift",
            separate_by: "a dark frame after a bright one: only a lag leaves an image in it",
        },
        Lookalike {
            id: "background",
            separate_by: "a dark frame after a bright one: only a lag leaves an image in it",
        },
        Lookalike {
            id: "ghost",
            separate_by: "the same specimen twice: a lag repeats its image, a ghost rotates it by 180 degrees",
        },
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
