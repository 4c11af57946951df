//! Scenes that differ in brightness from one to the next.

use super::result::Verdict;
use crate::data::Shown;
use crate::fit::{Fitted, Model};

/// Number of scenes that this takes.
const SCENES: usize = 4;
/// Root mean square of the differences that is worth a word.
const RMS: f64 = 0.005;
/// Share of the excess that they must explain.
const HALF: f64 = 0.5;

/// Says that a factor on the light of each scene explains most of the excess `before` the search, where all scenes
/// differ: one that stands alone is a wrong exposure. Curves over time follow the training frames afterwards.
pub(crate) fn brightness_note(model: &Model<'_>, before: &Fitted, verdict: Verdict) -> Option<String> {
    if verdict == Verdict::Adequate {
        return None;
    }
    let frames = model.seen.frames.iter().zip(&before.predicted);
    let black_dn = (model.forward.noise().black_level_dn + before.state.black_dn) as f32;
    let scenes: Vec<[f64; 3]> = frames
        .filter(|(f, _)| matches!(f.shown, Shown::Object(_)))
        .map(|(_, here)| {
            let pixels = here.dn.iter().zip(&here.residual_dn).zip(&here.inverse_sigma);
            let [mut along, mut light, mut excess] = [0.0f64; 3];
            for ((dn, residual), w) in pixels.filter(|(_, w)| **w > 0.0) {
                let [own, left] = [(dn - black_dn) * w, residual * w].map(f64::from);
                along += own * left;
                light += own * own;
                excess += left * left - 1.0;
            }
            [along / light.max(f64::MIN_POSITIVE), light, excess]
        })
        .collect();
    let of = differences(&scenes)?;
    Some(format!(
        "the scenes differ in brightness from what the session says, each by a factor of its own: by {:.1} % to {:+.1} \
         % (rms {:.1} %), which explains {:.0} % of the excess. A lamp that flickers does that, and so do exposures or \
         light levels that were not written down: give each frame its `exposure_ms` or `illumination` in the table of \
         the stack",
        100.0 * of.least,
        100.0 * of.most,
        100.0 * of.rms,
        100.0 * of.explained
    ))
}

/// Relative differences of the light of scenes.
#[derive(Debug, PartialEq)]
struct Differences {
    least: f64,
    most: f64,
    rms: f64,
    /// Share of the excess of chi-squared that they explain.
    explained: f64,
}

/// Differences of scenes from (their relative light, its weight, their excess of chi-squared). None: they are small, or
/// explain little.
fn differences(scenes: &[[f64; 3]]) -> Option<Differences> {
    let excess: f64 = scenes.iter().map(|s| s[2]).sum();
    if scenes.len() < SCENES || excess <= 0.0 {
        return None;
    }
    let n = scenes.len() as f64;
    let rms = (scenes.iter().map(|s| s[0] * s[0]).sum::<f64>() / n).sqrt();
    let fall = |s: &[f64; 3]| s[0] * s[0] * s[1];
    let all: f64 = scenes.iter().map(fall).sum();
    // One scene alone is no matter of all.
    let most_of_one = scenes.iter().map(fall).fold(0.0, f64::max);
    let explained = all / excess;
    let is_seen = rms > RMS && explained > HALF && most_of_one < HALF * all;
    let [least, most] = [f64::min, f64::max].map(|of| scenes.iter().map(|s| s[0]).fold(scenes[0][0], of));
    is_seen.then_some(Differences { least, most, rms, explained: explained.min(1.0) })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn scenes_that_flicker_differ_and_one_that_stands_alone_or_a_blur_does_not() {
        let scenes = |factors: [f64; 5], other: f64| factors.map(|f| [f, 1e6, f * f * 1e6 + other]);
        let flicker = differences(&scenes([0.05, -0.04, 0.03, -0.06, 0.02], 100.0)).map(|d| [d.least, d.most]);
        assert_eq!(flicker, Some([-0.06, 0.05]));
        assert_eq!(differences(&scenes([0.0, 0.0, 0.2, 0.001, 0.0], 100.0)), None);
        assert_eq!(differences(&scenes([0.05, -0.04, 0.03, -0.06, 0.02], 1e5)), None);
        assert_eq!(differences(&scenes([1e-3, -1e-3, 2e-3, 0.0, -1e-3], 0.1)), None);
        assert_eq!(differences(&scenes([0.05, -0.04, 0.03, -0.06, 0.02], -1e5)), None);
    }
}
