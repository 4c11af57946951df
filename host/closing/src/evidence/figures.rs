//! How well a state predicts held-out data.

use crate::data::{Observations, Shown};
use crate::fit::{Fitted, Model};
use ommatidia_session::Role;
use serde::{Deserialize, Serialize};

/// What figures are computed from: frames whose content is known without the frame itself. The specimen of an unknown
/// frame is estimated from that frame, so that its own blur would be its model, and any figure of it hollow.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum JudgedOn {
    /// Scenes of known objects, and bead frames.
    #[default]
    Known,
    /// Flats and darks: the sensor is judged, the optics are not.
    Even,
    /// No frame of known content.
    Nothing,
}

impl JudgedOn {
    /// What a session allows.
    pub fn of(seen: &Observations) -> Self {
        let has = |known: fn(&Shown) -> bool| seen.frames.iter().any(|f| known(&f.shown));
        match () {
            () if has(|shown| matches!(shown, Shown::Object(_) | Shown::Bead(_))) => Self::Known,
            () if has(|shown| *shown == Shown::Even) => Self::Even,
            () => Self::Nothing,
        }
    }

    /// Whether frames that show this count.
    fn counts(self, shown: &Shown) -> bool {
        match self {
            Self::Known => matches!(shown, Shown::Object(_) | Shown::Bead(_)),
            Self::Even => matches!(shown, Shown::Even | Shown::Dark),
            Self::Nothing => false,
        }
    }
}

/// JSON has no NaN: a figure that is not judged is null.
fn nullable<'de, D: serde::Deserializer<'de>>(from: D) -> Result<f64, D::Error> {
    Ok(Option::<f64>::deserialize(from)?.unwrap_or(f64::NAN))
}

/// How well held-out data are predicted; NaN, in JSON null, where nothing of known content is there to judge.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Figures {
    /// chi-squared per pixel, with the variance of the noise model.
    #[serde(deserialize_with = "nullable")]
    pub chi2_ndf: f64,
    /// `||measured - predicted|| / ||measured||` of the light above the black level; noise contributes to it.
    #[serde(deserialize_with = "nullable")]
    pub nrmse: f64,
    /// Pearson correlation coefficient.
    #[serde(deserialize_with = "nullable")]
    pub pcc: f64,
}

impl Figures {
    /// Figures where nothing can be judged.
    const NONE: Self = Self { chi2_ndf: f64::NAN, nrmse: f64::NAN, pcc: f64::NAN };
}

/// The frames that the figures are computed from.
pub(crate) fn judged(seen: &Observations) -> impl Iterator<Item = usize> + '_ {
    let on = JudgedOn::of(seen);
    (0..seen.frames.len()).filter(move |k| on.counts(&seen.frames[*k].shown))
}

/// Scenes, of known and unknown objects, and beads.
pub(crate) fn pictured_frames(seen: &Observations) -> impl Iterator<Item = usize> + '_ {
    (0..seen.frames.len()).filter(|k| matches!(seen.frames[*k].role, Role::Scene | Role::Bead))
}

/// Figures on held-out data: the held-out frames of [`JudgedOn`], or, if no frame is held out, the held-out blocks of
/// all of them.
pub fn figures(model: &Model<'_>, fitted: &Fitted) -> Figures {
    let seen = model.seen;
    let mut frames: Vec<usize> = judged(seen).filter(|k| seen.frames[*k].held_out).collect();
    let whole = !frames.is_empty();
    if !whole {
        frames = judged(seen).collect();
    }
    if frames.is_empty() {
        return Figures::NONE;
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
