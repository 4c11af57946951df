//! Lag: part of the charge of the previous frame remains in the pixels.
//!
//! `mu -> mu + share mu_before exp(-dt / tau)`, where dt is the time from the start of one exposure to the next. The
//! remaining charge is added before the Poisson draw: a random share of Poisson counts is again Poisson distributed.
//! Only the previous frame counts. For frames at even intervals share and tau cannot be separated, so tau is set and
//! not fitted: to 50 ms, or to the interval of the frames where that is so long that such a lag would have faded.

use super::context::FrameContext;
use super::descriptor::{Descriptor, Lookalike, Param, Stage};
use super::effect::Effect;
use super::evidence::{Evidence, EvidenceFrame};
use ndarray::Array2;

/// The effect; its formula is in the documentation of the module.
pub(super) struct Lag;

/// After so many time constants less than a thousandth remains.
const FADED: f64 = 7.0;

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

    /// No share, with a time constant that shows in these frames.
    fn guess(&self, evidence: &Evidence<'_>) -> Vec<Vec<f64>> {
        let tau_s = DESCRIPTOR.params[1].off;
        let of_pair = |f: &[EvidenceFrame<'_>]| {
            let (first, second) = (&f[0].cx, &f[1].cx);
            let pair = first.role == second.role && second.frame == first.frame + 1;
            pair.then_some(second.time_s - first.time_s).filter(|dt| *dt > 0.0)
        };
        let shortest = evidence.frames.windows(2).filter_map(of_pair).fold(f64::INFINITY, f64::min);
        let faded = shortest.is_finite() && shortest > FADED * tau_s;
        vec![vec![0.0, if faded { shortest } else { tau_s }]]
    }

    fn needs_previous(&self) -> bool {
        true
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn frames_far_apart_are_tried_with_a_longer_lag() {
        let tau_s = |interval_s: f64| {
            let frame = |k: usize| EvidenceFrame {
                cx: FrameContext { frame: k, time_s: interval_s * k as f64, ..FrameContext::default() },
                residual_dn: Array2::zeros((2, 2)),
                light_e: Array2::zeros((2, 2)),
                weight: Array2::zeros((2, 2)),
            };
            Lag.guess(&Evidence { frames: (0..3).map(frame).collect() })[0][1]
        };
        assert_eq!([tau_s(0.02), tau_s(0.3), tau_s(1.0), tau_s(60.0)], [0.05, 0.05, 1.0, 60.0]);
        assert_eq!(Lag.guess(&Evidence::default()), [[0.0, 0.05]]);
    }
}
