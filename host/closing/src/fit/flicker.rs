//! Scenes whose brightness differs from one to the next: a lamp that flickers, or light that was not written down.
//!
//! Differences of a tenth and more are seen in the records alone ([`super::units::units`]). Smaller ones are judged
//! by what they explain: no effect of an instrument changes the light of whole frames at random and nothing else.

use super::record::{Seen, correlation, slope};
use super::scene_light::{ALIKE, Light, beside_median, logs, scatter};
use super::units::{SCENES, is_explained, scaled};
use crate::data::{Fault, Observations, Shown};

/// Relative differences that count, root mean square: the PSFs of a calibration err by less in the light of a frame.
const RMS: f64 = 0.005;
/// Share of the excess of chi-squared of the scenes that they must explain.
const SHARE: f64 = 0.5;
/// Significance of each, standard deviations, root mean square.
const SIGNIFICANT: f64 = 5.0;
/// Number of scenes from which it is said that they seem to flicker.
const FEW: usize = 4;

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

/// Scales the objects of scenes by the light of each, where that explains most of what their prediction leaves and
/// follows nothing that an effect could follow. `frames` are the scenes that were looked at, all of them.
pub(crate) fn flicker(seen: &mut Observations, frames: &[Seen], light: &[Light]) -> Vec<Fault> {
    if frames.len() != light.len() || light.len() < SCENES || !explains(light) {
        return Vec::new();
    }
    let logs = logs(light);
    if is_explained(seen, frames, &logs) {
        return Vec::new();
    }
    let factors: Vec<f64> = logs.iter().map(|log| log.exp()).collect();
    scaled(seen, frames, &factors, |i| (logs[i] * (1.0 + light[i].by) / light[i].sigma).abs())
}

/// Whether the scenes with known objects are so many that a note may say so, and too few for more.
pub(crate) fn are_few(seen: &Observations) -> bool {
    let scenes = seen.frames.iter().filter(|f| matches!(f.shown, Shown::Object(_))).count();
    (FEW..SCENES).contains(&scenes)
}

/// What to say of scenes that seem to flicker, and are too few to show that nothing else follows their light. None:
/// they do not, or they are enough.
pub(crate) fn few_note(light: &[Light]) -> Option<String> {
    if !(FEW..SCENES).contains(&light.len()) || !explains(light) {
        return None;
    }
    let logs = logs(light);
    let end = |of: fn(f64, f64) -> f64| logs.iter().copied().reduce(of).map_or(1.0, f64::exp);
    Some(format!(
        "the {} scenes differ in brightness, {:.3} to {:.3} times that of their objects relative to one another, and \
         that explains most of what their prediction leaves: the lamp flickers, or light or exposures were not written \
         down. From {SCENES} scenes on it is shown whether anything else follows their light, and corrected where \
         nothing does",
        light.len(),
        end(f64::min),
        end(f64::max)
    ))
}

/// Whether differences of light are large, certain, and most of the excess. A scene that stands alone is no flicker.
fn explains(light: &[Light]) -> bool {
    let n = light.len() as f64;
    let sum = |of: fn(&Light) -> f64| light.iter().map(of).sum::<f64>();
    let (squares, fall) = (sum(|l| l.by * l.by), sum(Light::fall));
    let alone = light.iter().any(|l| l.by * l.by > 0.5 * squares);
    let is_large = (squares / n).sqrt() > RMS && fall > SIGNIFICANT.powi(2) * n;
    let is_light = light.iter().all(|l| l.by > -1.0);
    is_light && is_large && !alone && fall > SHARE * sum(|l| l.excess)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn scenes_that_flicker_are_found_and_one_that_stands_alone_or_a_blur_is_not() {
        let is_found = |factors: [f64; 6], other: f64| {
            let light = factors.map(|by| Light { by, sigma: 1e-3, excess: by * by * 1e6 + other, parts: Vec::new() });
            explains(&light)
        };
        let flicker = [0.05, -0.04, 0.03, -0.06, 0.02, -0.01];
        assert!(is_found(flicker, 100.0));
        assert!(!is_found([0.0, 0.0, 0.2, 0.001, 0.0, 0.0], 100.0));
        assert!(!is_found(flicker, 1e5));
        assert!(!is_found([1e-3, -1e-3, 2e-3, 0.0, -1e-3, 1e-3], 0.1));
    }

    #[test]
    fn few_scenes_that_seem_to_flicker_have_a_note() {
        let light = |factors: &[f64]| -> Vec<Light> {
            let of = |by: &f64| Light { by: *by, sigma: 1e-3, excess: by * by * 1e6 + 100.0, parts: Vec::new() };
            factors.iter().map(of).collect()
        };
        let note = few_note(&light(&[0.05, -0.04, 0.03, -0.04])).unwrap_or_default();
        assert!(note.starts_with("the 4 scenes differ in brightness, 0.932 to 1.019"), "{note}");
        assert_eq!(few_note(&light(&[0.05, -0.04, 0.03])), None);
        assert_eq!(few_note(&light(&[0.05, -0.04, 0.03, -0.06, 0.02, -0.01])), None);
        assert_eq!(few_note(&light(&[0.0, 0.0, 0.2, 0.001])), None);
    }
}
