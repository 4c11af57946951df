//! How well a state predicts held-out data.

use crate::closing::data::Observations;
use crate::closing::fit::{Fitted, Model};
use crate::session::Role;
use serde::{Deserialize, Serialize};

/// How well held-out data are predicted.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Figures {
    /// chi-squared per pixel, with the variance of the noise model.
    pub chi2_ndf: f64,
    /// `||measured - predicted|| / ||measured||` of the light above the black level; noise contributes to it.
    pub nrmse: f64,
    /// Pearson correlation coefficient.
    pub pcc: f64,
}

/// The frames that the figures are computed from: scenes and beads.
pub(crate) fn judged(seen: &Observations) -> impl Iterator<Item = usize> + '_ {
    (0..seen.frames.len()).filter(|k| matches!(seen.frames[*k].role, Role::Scene | Role::Bead))
}

/// Figures on held-out data: the held-out scenes and beads, or, if no frame is held out, the held-out blocks of all of
/// them.
pub fn figures(model: &Model<'_>, fitted: &Fitted) -> Figures {
    let seen = model.seen;
    let mut frames: Vec<usize> = judged(seen).filter(|k| seen.frames[*k].held_out).collect();
    let whole = !frames.is_empty();
    if !whole {
        frames = judged(seen).collect();
    }
    let black = model.forward.noise().black_level_dn;
    let (mut chi2, mut n, mut error, mut light) = (0.0, 0.0, 0.0, 0.0);
    let mut s = [0.0f64; 6];
    for k in frames {
        let (here, measured) = (&fitted.predicted[k], &seen.frames[k].measured);
        for (span, held_out) in seen.blocks.iter().zip(&seen.held_out_blocks) {
            if !whole && !held_out {
                continue;
            }
            for p in &seen.pixels[span.clone()] {
                let at = (*p as usize / seen.sensor[1], *p as usize % seen.sensor[1]);
                let (r, w) = (f64::from(here.residual_dn[at]), f64::from(here.inverse_sigma[at]));
                if w <= 0.0 {
                    continue;
                }
                chi2 += r * r * w * w;
                n += 1.0;
                let y = f64::from(measured[at]) - black;
                let mu = y - r;
                error += r * r;
                light += y * y;
                for (sum, v) in s.iter_mut().zip([1.0, y, mu, y * y, mu * mu, y * mu]) {
                    *sum += v;
                }
            }
        }
    }
    let m = s[0].max(1.0);
    let (vy, vm, c) = (s[3] - s[1] * s[1] / m, s[4] - s[2] * s[2] / m, s[5] - s[1] * s[2] / m);
    let pcc = if vy > 0.0 && vm > 0.0 { c / (vy * vm).sqrt() } else { 0.0 };
    Figures { chi2_ndf: chi2 / f64::max(n, 1.0), nrmse: (error / f64::max(light, 1e-30)).sqrt(), pcc }
}
