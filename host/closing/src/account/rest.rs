//! Where the rest of a residual lies, if no effect explains it: in a frame or two, or in the noise of the scenes.

use super::result::Verdict;
use crate::data::Shown;
use crate::fit::{Fitted, Model};

/// A rest lies in few frames if these are at most this share of the scenes,
const FEW: f64 = 1.0 / 6.0;
/// hold this share of what exceeds the median of the scenes,
const MOST: f64 = 0.7;
/// and each exceeds it by so many standard deviations of a chi-squared of noise.
const SURE: f64 = 10.0;
/// Bright pixels: the noise of their light is at least so many times that of a dark pixel; in dark ones it is at most
/// the second.
const BRIGHT: [f64; 2] = [2.0, 0.3];
/// Noise is another one if that of the light differs by this much,
const OTHER: f64 = 0.1;
/// and if of that at most this share is common to neighbouring pixels, and dark pixels follow to that accuracy.
const COMMON: f64 = 0.25;
/// Number of pixels of each kind that such a statement needs.
const ENOUGH: f64 = 1000.0;

/// Notes on where the rest lies. None where nothing is left and the noise is as expected, or no object is known.
pub(crate) fn rest_notes(model: &Model<'_>, now: &Fitted, verdict: Verdict) -> Vec<String> {
    let seen = model.seen;
    let known = |k: &usize| matches!(seen.frames[*k].shown, Shown::Object(_));
    let scenes: Vec<(usize, Rest)> =
        (0..seen.frames.len()).filter(known).map(|k| (seen.frames[k].info.frame, Rest::of(model, now, k))).collect();
    let all: Vec<Rest> = scenes.iter().map(|(_, rest)| *rest).collect();
    let in_frames: Vec<(usize, [f64; 2])> = scenes.iter().map(|(frame, rest)| (*frame, rest.all)).collect();
    let few = || few_frames(&in_frames).filter(|_| verdict != Verdict::Adequate);
    few().or_else(|| other_noise(all)).into_iter().collect()
}

/// Sums over the pixels of a frame.
#[derive(Clone, Copy, Default)]
struct Rest {
    /// chi-squared with the best light of this frame, and number of pixels: a frame that is far off moves the light of
    /// its stack, and so the residual of all others.
    all: [f64; 2],
    /// chi-squared and number of dark pixels, as predicted.
    dark: [f64; 2],
    /// Of bright pixels: squared residual, expected variance, and the part of it that a dark pixel has, DN^2; number.
    bright: [f64; 4],
    /// Products of the normalised residuals of a bright pixel and of the next in its row, and their number.
    next: [f64; 2],
}

impl Rest {
    fn of(model: &Model<'_>, now: &Fitted, k: usize) -> Self {
        let (seen, here) = (model.seen, &now.predicted[k]);
        let noise = model.forward.noise();
        let of_dark = noise.variance_dn2(noise.black_level_dn);
        let cols = seen.sensor[1];
        let normal = |p: usize| {
            let at = [p / cols, p % cols];
            let [r, w] =
                [here.residual_dn.get(at), here.inverse_sigma.get(at)].map(|v| v.map_or(0.0, |v| f64::from(*v)));
            (w > 0.0).then_some((r * w, w.powi(-2)))
        };
        let light = |p: usize| {
            let at = [p / cols, p % cols];
            let [y, r] = [seen.frames[k].measured.get(at), here.residual_dn.get(at)].map(|v| v.map_or(0.0, |v| *v));
            f64::from(y - r) - noise.black_level_dn
        };
        let (mut along, mut square) = (0.0, 0.0);
        let bright = |variance: f64| variance - of_dark > BRIGHT[0] * of_dark;
        let mut it = Self::default();
        let add = |to: &mut [f64], values: &[f64]| to.iter_mut().zip(values).for_each(|(sum, v)| *sum += v);
        for p in seen.pixels.iter().map(|p| *p as usize) {
            let Some((r, variance)) = normal(p) else { continue };
            add(&mut it.all, &[r * r, 1.0]);
            let lit = light(p) / variance.sqrt();
            along += r * lit;
            square += lit * lit;
            if bright(variance) {
                add(&mut it.bright, &[r * r * variance, variance, of_dark, 1.0]);
                let next = Some(p + 1).filter(|next| next % cols > 0).and_then(normal);
                if let Some((other, _)) = next.filter(|(_, v)| bright(*v)) {
                    add(&mut it.next, &[r * other, 1.0]);
                }
            } else if variance - of_dark < BRIGHT[1] * of_dark {
                add(&mut it.dark, &[r * r, 1.0]);
            }
        }
        it.all[0] -= along * along / square.max(f64::MIN_POSITIVE);
        it
    }
}

/// Scenes, by their index in the stack, with chi-squared and number of pixels: says which few of them hold the rest.
fn few_frames(scenes: &[(usize, [f64; 2])]) -> Option<String> {
    let per_pixel = |of: &[f64; 2]| of[0] / of[1].max(1.0);
    let mut sorted: Vec<f64> = scenes.iter().map(|(_, of)| per_pixel(of)).collect();
    sorted.sort_by(f64::total_cmp);
    let median = *sorted.get(sorted.len() / 2)?;
    let above = |of: &[f64; 2]| of[0] - median.max(1.0) * of[1];
    let sum: f64 = scenes.iter().map(|(_, of)| above(of).max(0.0)).sum();
    let sure = |of: &[f64; 2]| above(of) > SURE * (2.0 * of[1]).sqrt();
    // As few as hold most of it: what moves the black level of all frames makes others differ, too.
    let mut most: Vec<&(usize, [f64; 2])> = scenes.iter().filter(|(_, of)| sure(of)).collect();
    most.sort_by(|a, b| above(&b.1).total_cmp(&above(&a.1)));
    let mut held = 0.0;
    let mut out: Vec<&(usize, [f64; 2])> = Vec::new();
    for scene in most {
        if held >= MOST * sum {
            break;
        }
        held += above(&scene.1);
        out.push(scene);
    }
    if out.is_empty() || out.len() as f64 > FEW * scenes.len() as f64 || held < MOST * sum {
        return None;
    }
    out.sort_by_key(|(frame, _)| *frame);
    let list: Vec<String> =
        out.iter().map(|(frame, of)| format!("{frame} (chi-squared per pixel {:.3})", per_pixel(of))).collect();
    let (frames, their) = if out.len() == 1 { ("scene frame", "It does") } else { ("scene frames", "They do") };
    Some(format!(
        "most of what is left is in {frames} {}; the median of the scenes is {median:.3}. {their} not show what the \
         others show: look at the frame and at its truth (motion, a double exposure, a mistaken record, or optics that \
         change with time). Only if its data are bad, write `damaged` in column `data` of its row in the table of the \
         stack, and close the loop again",
        list.join(", ")
    ))
}

/// Says that the residual of the scenes is noise of another strength than the calibration's, as of another gain.
fn other_noise(scenes: impl IntoIterator<Item = Rest>) -> Option<String> {
    let plus = |a: &mut [f64], b: &[f64]| a.iter_mut().zip(b).for_each(|(a, b)| *a += b);
    let mut sum = Rest::default();
    for rest in scenes {
        plus(&mut sum.dark, &rest.dark);
        plus(&mut sum.bright, &rest.bright);
        plus(&mut sum.next, &rest.next);
    }
    if sum.dark[1].min(sum.bright[3]).min(sum.next[1]) < ENOUGH {
        return None;
    }
    let dark = sum.dark[0] / sum.dark[1];
    let factor = (sum.bright[0] - dark * sum.bright[2]) / (sum.bright[1] - sum.bright[2]).max(f64::MIN_POSITIVE);
    let [off, common] = [(factor - 1.0).abs(), (sum.next[0] / sum.next[1]).abs()];
    // A gain amplifies the read noise by its square, unless that arises behind it.
    let [least, most] = [factor.powi(2).min(1.0), factor.powi(2).max(1.0)];
    let of_read = least - COMMON * off..most + COMMON * off;
    let is_noise = off > OTHER && common < COMMON * off && of_read.contains(&dark);
    is_noise.then(|| {
        format!(
            "the residual of the scenes looks like noise of another strength: neighbouring pixels have nothing in \
             common, and the noise of their light is {factor:.2} times what the gain of the calibration gives \
             ({dark:.2} times in dark pixels). If the camera's gain was {factor:.2} times that of the calibration \
             while the scenes were recorded, calibrate with flats and darks at their gain"
        )
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn few_frames_that_hold_the_rest_are_listed() {
        let frame = |k: usize, chi2: f64| (k, [chi2 * 25600.0, 25600.0]);
        let mut scenes: Vec<(usize, [f64; 2])> = (0..12).map(|k| frame(k, 1.02 + 0.001 * k as f64)).collect();
        assert_eq!(few_frames(&scenes), None);
        scenes[5] = frame(5, 1.3);
        let text = few_frames(&scenes).unwrap_or_default();
        assert!(text.contains("scene frame 5 (chi-squared per pixel 1.300)") && text.contains("1.02"), "{text}");
        // A frame that is far off disturbs the fit of others.
        let mut disturbed = scenes.clone();
        disturbed[5] = frame(5, 300.0);
        (7..12).for_each(|k| disturbed[k] = frame(k, 4.0));
        let text = few_frames(&disturbed).unwrap_or_default();
        assert!(text.contains("scene frame 5 (chi-squared per pixel 300.000);"), "{text}");
        // More than a sixth of the scenes is no exception.
        (0..3).for_each(|k| scenes[k] = frame(k, 1.3));
        assert_eq!(few_frames(&scenes), None);
        assert_eq!(few_frames(&[]), None);
    }

    #[test]
    fn noise_of_another_gain_is_no_structure() {
        // 5000 bright pixels of variance 40 DN^2, of which dark ones have 4; the light's noise is 1.5 times as strong.
        let rest = |common: f64, dark: f64| Rest {
            all: [0.0; 2],
            dark: [dark * 2000.0, 2000.0],
            bright: [5000.0 * (1.5 * 36.0 + dark * 4.0), 5000.0 * 40.0, 5000.0 * 4.0, 5000.0],
            next: [common * 4000.0, 4000.0],
        };
        let text = other_noise([rest(0.01, 1.0)]).unwrap_or_default();
        assert!(text.contains("1.50 times what the gain") && text.contains("1.00 times in dark"), "{text}");
        assert!(other_noise([rest(0.01, 2.25)]).is_some_and(|text| text.contains("2.25 times in dark")));
        let quiet = Rest { bright: [5000.0 * (0.8 * 36.0 + 0.64 * 4.0), 2e5, 2e4, 5000.0], ..rest(0.01, 0.64) };
        assert!(other_noise([quiet]).is_some_and(|text| text.contains("0.80 times what the gain")));
        assert!(other_noise([rest(0.3, 1.0)]).is_none() && other_noise([rest(0.01, 3.0)]).is_none());
    }
}
