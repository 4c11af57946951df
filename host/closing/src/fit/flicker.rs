//! Scenes whose brightness differs from one to the next: a lamp that flickers, or light that was not written down.
//!
//! Differences of a tenth and more are seen in the records alone ([`super::exposures::units`]). Smaller ones are judged
//! by what they explain: no effect of an instrument changes the light of whole frames at random and nothing else.

use super::exposures::{ALIKE, SCENES, is_explained, scaled, scatter};
use super::record::{Seen, correlation, slope};
use super::{Fitted, Model};
use crate::data::{Fault, Observations, Shown};

/// Relative differences that count, root mean square: the PSFs of a calibration err by less in the light of a frame.
const RMS: f64 = 0.005;
/// Share of the excess of chi-squared of the scenes that they must explain.
const SHARE: f64 = 0.5;
/// Significance of each, standard deviations, root mean square.
const SIGNIFICANT: f64 = 5.0;

/// The light of a scene over that of its prediction.
pub(crate) struct Light {
    /// Relative difference.
    by: f64,
    /// Its significance squared: the fall of chi-squared.
    fall: f64,
    /// Chi-squared of the scene beyond its number of pixels.
    excess: f64,
}

/// Whether the light of scenes differs so that a fit is worth its time, by a regression of images.
pub(crate) fn may_flicker(seen: &Observations, frames: &[Seen]) -> bool {
    let [slopes, alike] = [slope, correlation].map(|of| frames.iter().map(|s| of(&s.measured, &s.own)).collect());
    let (slopes, alike): (Vec<f64>, Vec<f64>) = (slopes, alike);
    if frames.len() < SCENES || alike.iter().any(|r| *r < ALIKE) || slopes.iter().any(|s| *s <= 0.0) {
        return false;
    }
    let logs = beside_median(slopes.iter().map(|s| s.ln()).collect());
    scatter(&logs) > 0.5 * RMS && !is_explained(seen, frames, &logs)
}

/// The light of each of the scenes under a fit of what all of them share.
pub(crate) fn light(model: &Model<'_>, fit: &Fitted) -> Vec<Light> {
    let black_dn = (model.forward.noise().black_level_dn + fit.state.black_dn) as f32;
    let scenes = model.seen.frames.iter().zip(&fit.predicted).filter(|(f, _)| matches!(f.shown, Shown::Object(_)));
    scenes
        .map(|(_, here)| {
            let pixels = here.dn.iter().zip(&here.residual_dn).zip(&here.inverse_sigma);
            let [mut along, mut light, mut excess] = [0.0f64; 3];
            for ((dn, residual), w) in pixels.filter(|(_, w)| **w > 0.0) {
                let [own, left] = [(dn - black_dn) * w, residual * w].map(f64::from);
                along += own * left;
                light += own * own;
                excess += left * left - 1.0;
            }
            let by = along / light.max(f64::MIN_POSITIVE);
            Light { by, fall: by * along, excess }
        })
        .collect()
}

/// Scales the objects of scenes by the light of each, where that explains most of what their prediction leaves and
/// follows nothing that an effect could follow. `frames` are the scenes that were looked at, all of them.
pub(crate) fn flicker(seen: &mut Observations, frames: &[Seen], light: &[Light]) -> Vec<Fault> {
    if frames.len() != light.len() || !explains(light) || light.iter().any(|l| l.by <= -1.0) {
        return Vec::new();
    }
    let logs = beside_median(light.iter().map(|l| l.by.ln_1p()).collect());
    if is_explained(seen, frames, &logs) {
        return Vec::new();
    }
    let factors: Vec<f64> = logs.iter().map(|log| log.exp()).collect();
    scaled(seen, frames, &factors, |i| light[i].fall.sqrt())
}

fn beside_median(logs: Vec<f64>) -> Vec<f64> {
    let usual = super::record::median(logs.clone()).unwrap_or(0.0);
    logs.into_iter().map(|v| v - usual).collect()
}

/// Whether differences of light are large, certain, and most of the excess. A scene that stands alone is no flicker.
fn explains(light: &[Light]) -> bool {
    let n = light.len() as f64;
    let sum = |of: fn(&Light) -> f64| light.iter().map(of).sum::<f64>();
    let (squares, fall) = (sum(|l| l.by * l.by), sum(|l| l.fall));
    let alone = light.iter().any(|l| l.by * l.by > 0.5 * squares);
    let is_large = (squares / n).sqrt() > RMS && fall > SIGNIFICANT.powi(2) * n;
    light.len() >= SCENES && is_large && !alone && fall > SHARE * sum(|l| l.excess)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn scenes_that_flicker_are_found_and_one_that_stands_alone_or_a_blur_is_not() {
        let is_found = |factors: [f64; 6], other: f64| {
            let light = factors.map(|by| Light { by, fall: by * by * 1e6, excess: by * by * 1e6 + other });
            explains(&light)
        };
        let flicker = [0.05, -0.04, 0.03, -0.06, 0.02, -0.01];
        assert!(is_found(flicker, 100.0));
        assert!(!is_found([0.0, 0.0, 0.2, 0.001, 0.0, 0.0], 100.0));
        assert!(!is_found(flicker, 1e5));
        assert!(!is_found([1e-3, -1e-3, 2e-3, 0.0, -1e-3, 1e-3], 0.1));
    }
}
