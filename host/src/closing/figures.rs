//! How well a state predicts what no fit has seen, and pictures of what it leaves.

use super::file::Account;
use super::model::Model;
use super::observe::Observations;
use super::refit::Fitted;
use super::result::{Closing, Figures};
use crate::session::Role;
use ndarray::{Array2, Array3};

/// The frames that figures are told of.
pub(super) fn judged(seen: &Observations) -> impl Iterator<Item = usize> + '_ {
    (0..seen.frames.len()).filter(|k| matches!(seen.frames[*k].role, Role::Scene | Role::Bead))
}

/// Figures on what no fit has seen: held-out scenes, or the held-out blocks where no scene is.
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

/// The account with the residuals of up to four scenes, held-out ones first.
pub(super) fn pictured(model: &Model<'_>, before: &Fitted, now: &Fitted, closing: Closing) -> Account {
    let seen = model.seen;
    let mut frames: Vec<usize> = judged(seen).collect();
    frames.sort_by_key(|k| !seen.frames[*k].held_out);
    frames.truncate(4);
    let pull = |f: &Fitted, k: usize| &f.predicted[k].residual_dn * &f.predicted[k].inverse_sigma;
    let stack = |image: &dyn Fn(usize) -> Array2<f32>| {
        let mut out = Array3::zeros((frames.len(), seen.sensor[0], seen.sensor[1]));
        for (k, mut target) in frames.iter().zip(out.outer_iter_mut()) {
            target.assign(&image(*k));
        }
        out
    };
    Account {
        measured_dn: stack(&|k| seen.frames[k].measured.clone()),
        before: stack(&|k| pull(before, k)),
        after: stack(&|k| pull(now, k)),
        frames: frames.iter().map(|k| seen.frames[*k].info.frame).collect(),
        closing,
    }
}
