//! How well a state predicts held-out data.

use crate::data::{Observations, Shown};
use crate::fit::repeats::{in_weights, noise_dn, noisy};
use crate::fit::{Errors, Fitted, Model, map_errors};
use ndarray::{Array2, s};
use ommatidia_model::psf::LowRankPsf;
use ommatidia_physics::effects::Chain;
use ommatidia_session::Role;
use ommatidia_session::rng::stream;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::ops::Range;

/// What figures are computed from: what is known without the pixels that are judged.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum JudgedOn {
    /// Scenes of known objects, and bead frames.
    #[default]
    Known,
    /// Frames of unknown specimens, each estimated from a part of its frame: spatial blocks that were left out, which
    /// other lenses show as well. The figures show whether the views agree with each other.
    SelfConsistency,
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
            () if has(|shown| *shown == Shown::Estimated) => Self::SelfConsistency,
            () if has(|shown| *shown == Shown::Even) => Self::Even,
            () => Self::Nothing,
        }
    }

    /// Whether frames that show this count.
    fn counts(self, shown: &Shown) -> bool {
        match self {
            Self::Known => matches!(shown, Shown::Object(_) | Shown::Bead(_)),
            Self::SelfConsistency => *shown == Shown::Estimated,
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
    /// chi-squared per pixel, with the variance of the noise model. For estimated specimens, over its expectation under
    /// noise alone, which the error of the estimate raises.
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
    frames_of(seen, JudgedOn::of(seen))
}

fn frames_of(seen: &Observations, on: JudgedOn) -> impl Iterator<Item = usize> + '_ {
    (0..seen.frames.len()).filter(move |k| on.counts(&seen.frames[*k].shown))
}

/// Scenes, of known and unknown objects, and beads.
pub(crate) fn pictured_frames(seen: &Observations) -> impl Iterator<Item = usize> + '_ {
    (0..seen.frames.len()).filter(|k| matches!(seen.frames[*k].role, Role::Scene | Role::Bead))
}

/// Held-out data: frames of `on`, each with the ranges of [`Observations::pixels`] that count; the held-out frames
/// whole, or, if no frame is held out, the held-out blocks of all of them.
fn held_out_pixels(seen: &Observations, on: JudgedOn) -> impl Iterator<Item = (usize, usize, Range<usize>)> + '_ {
    let whole = frames_of(seen, on).any(|k| seen.frames[k].held_out);
    let frames = frames_of(seen, on).filter(move |k| !whole || seen.frames[*k].held_out);
    frames.flat_map(move |k| {
        let blocks = seen.blocks.iter().enumerate().filter(move |(b, _)| whole || seen.held_out_blocks[*b]);
        blocks.map(move |(b, span)| (k, b, span.clone()))
    })
}

/// Relative rise of a figure on held-out data that is rounding.
const ROUNDING: f64 = 1e-4;

/// Whether a figure on held-out data is worse after than before.
pub(crate) fn rises(before: f64, after: f64) -> bool {
    after > before * (1.0 + ROUNDING)
}

/// The relative error may rise by the first share of the relative fall of chi-squared, and by the second at most:
/// chi-squared weights pixels by their noise, the relative error does not, so that a better fit of dim pixels may move
/// the bright ones within their noise.
const TRADED: [f64; 2] = [0.1, 1e-3];

/// Whether held-out data are predicted worse after than before: chi-squared per pixel or the relative error rises by
/// more than rounding, the latter by more than [`TRADED`]. That noise may have made the rise is no excuse: an effect
/// that leaves held-out data as they were, or worse, has no claim to the instrument. A chi-squared below 1 is no better
/// than 1, since pixels share their noise; where the relative error falls, no better than its inverse, since a curve
/// that flattens the light flattens the noise, and mends both.
/// Figures are `[chi2_ndf, nrmse]`.
pub(crate) fn worse(before: [f64; 2], after: [f64; 2]) -> bool {
    let traded = (TRADED[0] * (1.0 - after[0] / before[0])).clamp(0.0, TRADED[1]);
    // Only what predicts the light better may bring the noise nearer to what it should be.
    let most = if rises(after[1], before[1]) { before[0].max(1.0 / before[0]) } else { before[0].max(1.0) };
    rises(most, after[0]) || rises(before[1] * (1.0 + traded), after[1])
}

/// [`worse`] of figures.
pub(crate) fn is_worse(before: Figures, after: Figures) -> bool {
    worse([before.chi2_ndf, before.nrmse], [after.chi2_ndf, after.nrmse])
}

/// Number of noise frames that are drawn for each held-out frame.
const DRAWN: u64 = 4;

/// Excess of chi-squared over the noise of a state with its effects on the noise, per held-out pixel. The weights of
/// [`figures`] leave these effects out, so that no fit gains by a larger variance. With its standard deviation by that
/// noise: noise that pixels share scatters more than that of single pixels.
pub(crate) fn excess(model: &Model<'_>, fitted: &Fitted, on: JudgedOn) -> [f64; 2] {
    let seen = model.seen;
    let chain = fitted.state.terms.iter().any(noisy).then(|| model.chain(&fitted.state.terms));
    let weighted = in_weights(model, &fitted.state);
    let mut spans: BTreeMap<usize, Vec<(usize, Range<usize>)>> = BTreeMap::new();
    held_out_pixels(seen, on).for_each(|(k, block, span)| spans.entry(k).or_default().push((block, span)));
    let one = |(k, spans): (&usize, &Vec<(usize, Range<usize>)>)| {
        let here = &fitted.predicted[*k];
        let draw = |chain: &Chain, i: u64| {
            let mut rngs = ["excess", "reading"].map(|what| stream(0x5eed, what, DRAWN * *k as u64 + i));
            noise_dn(model, chain, *k, &here.light_e, &mut rngs)
        };
        let squares = |d: &Array2<f32>| {
            let pixels = spans.iter().flat_map(|(_, span)| &seen.pixels[span.clone()]);
            let at = |p: &u32| (*p as usize / seen.sensor[1], *p as usize % seen.sensor[1]);
            pixels.map(|p| f64::from(d[at(p)] * here.inverse_sigma[at(p)]).powi(2)).sum::<f64>()
        };
        let (noise, scatter) = chain.as_ref().map_or((1.0, 0.0), |chain| {
            let mut drawn: Vec<Array2<f32>> =
                [chain, &weighted].iter().flat_map(|c| (0..DRAWN).map(|i| draw(c, i))).collect();
            model.visible(&fitted.state, drawn.iter_mut().map(|d| (*k, d)));
            let drawn: Vec<f64> = drawn.iter().map(squares).collect();
            let (with, plain) = drawn.split_at(DRAWN as usize);
            let mean = with.iter().sum::<f64>() / DRAWN as f64;
            let variance = with.iter().map(|s| (s - mean).powi(2)).sum::<f64>() / (DRAWN - 1) as f64;
            let noise = with.iter().sum::<f64>() / plain.iter().sum::<f64>().max(1e-30);
            (noise, variance / noise.powi(2).max(1e-30))
        });
        let (mut chi2, mut n) = (0.0, 0.0);
        for (p, share) in spans.iter().flat_map(|(block, span)| {
            let share = fitted.state.share(*k, *block);
            seen.pixels[span.clone()].iter().map(move |p| (p, share))
        }) {
            let at = (*p as usize / seen.sensor[1], *p as usize % seen.sensor[1]);
            let w = f64::from(here.inverse_sigma[at]);
            chi2 += (f64::from(here.residual_dn[at]) * w).powi(2) / noise;
            n += if w > 0.0 { share } else { 0.0 };
        }
        [chi2, n, scatter]
    };
    let sum = |a: [f64; 3], b: [f64; 3]| std::array::from_fn(|i| a[i] + b[i]);
    let [chi2, n, scatter] = spans.par_iter().map(one).reduce(|| [0.0; 3], sum);
    let n = n.max(1.0);
    [chi2 / n - 1.0, scatter.max(2.0 * n).sqrt() / n]
}

/// Number of held-out pixels of the frames of `on`, and the excess of chi-squared there that errors of the calibration
/// make: those of the PSFs (`errors`, of [`crate::fit::Replicas::of`]) and of the sensor maps.
pub(crate) fn excess_by_calibration(model: &Model<'_>, fitted: &Fitted, errors: &Errors, on: JudgedOn) -> (usize, f64) {
    let seen = model.seen;
    let maps = map_errors(model, &fitted.state);
    let black = model.forward.noise().black_level_dn;
    let (mut pixels, mut excess) = (0, 0.0);
    for (k, _, span) in held_out_pixels(seen, on) {
        let changes: Vec<&Array2<f32>> = errors.changes.iter().filter_map(|r| r[k].as_ref()).collect();
        for p in &seen.pixels[span] {
            let at = (*p as usize / seen.sensor[1], *p as usize % seen.sensor[1]);
            let w = f64::from(fitted.predicted[k].inverse_sigma[at]);
            let of_response = maps.response * (f64::from(fitted.predicted[k].dn[at]) - black);
            pixels += usize::from(w > 0.0);
            excess += changes.iter().map(|d| (f64::from(d[at]) * w).powi(2)).sum::<f64>();
            excess += (of_response.powi(2) + maps.offset_dn.powi(2)) * w * w;
        }
    }
    (pixels, excess)
}

/// How far the foci of held-out known objects stand alone: the squared light that they would have one by one, over the
/// squared light of their frames. 1: beads; near 0: an even body. 0 without beads and known objects.
///
/// Light and energy of a focus in an object are means over the field, so that the result may exceed 1 a little.
pub(crate) fn standing_alone(model: &Model<'_>, fitted: &Fitted, psf: &LowRankPsf) -> f64 {
    let (lenses, terms, ..) = psf.basis.dim();
    let (mut light, mut energy) = (0.0, 0.0);
    for (l, k) in (0..lenses).flat_map(|l| (0..terms).map(move |k| (l, k))) {
        let sum = f64::from(psf.basis.slice(s![l, k, .., ..]).sum());
        let coefficients = psf.coefficients.slice(s![l, k, .., .., ..]);
        let nodes = coefficients.len().max(1) as f64;
        light += sum * coefficients.iter().map(|c| f64::from(*c)).sum::<f64>() / nodes;
        energy += coefficients.iter().map(|c| f64::from(*c).powi(2)).sum::<f64>() / nodes;
    }
    let seen = model.seen;
    let black = model.forward.noise().black_level_dn;
    let mut frames: BTreeMap<usize, [f64; 2]> = BTreeMap::new();
    for (k, _, span) in held_out_pixels(seen, JudgedOn::of(seen)) {
        let sums = frames.entry(k).or_default();
        for p in &seen.pixels[span] {
            let at = (*p as usize / seen.sensor[1], *p as usize % seen.sensor[1]);
            let mu = f64::from(seen.frames[k].measured[at] - fitted.predicted[k].residual_dn[at]) - black;
            sums[0] += mu;
            sums[1] += mu * mu;
        }
    }
    let (mut alone, mut all) = (0.0, 0.0);
    for (k, [sum, squares]) in frames {
        if let Shown::Bead(_) = seen.frames[k].shown {
            (alone, all) = (alone + squares, all + squares);
        }
        let Shown::Object(truth) = seen.frames[k].shown else { continue };
        let total: f64 = seen.truths[truth].iter().map(|v| f64::from(*v)).sum();
        let squared: f64 = seen.truths[truth].iter().map(|v| f64::from(*v).powi(2)).sum();
        alone += energy * squared * (sum / (light * total).max(1e-30)).powi(2);
        all += squares;
    }
    if all > 0.0 { alone / all } else { 0.0 }
}

/// Figures on held-out data: the held-out frames of [`JudgedOn`], or, if no frame is held out, the held-out blocks of
/// all of them.
pub fn figures(model: &Model<'_>, fitted: &Fitted) -> Figures {
    weighed(model, fitted, fitted)
}

/// Figures before and after, with the same noise: that of the later fit where its effects bend the noise, as a curve of
/// the camera does. A chi-squared with the noise of a linear camera would fall by noise that a curve has flattened.
pub(crate) fn compared(model: &Model<'_>, before: &Fitted, after: &Fitted) -> [Figures; 2] {
    [weighed(model, before, noise_of(before, after)), figures(model, after)]
}

fn noise_of<'f>(before: &'f Fitted, after: &'f Fitted) -> &'f Fitted {
    if after.state.terms.iter().any(|t| t.effect.bends_noise()) { after } else { before }
}

/// A rise of a figure on held-out data is no chance above so many standard errors.
const SURE: f64 = 2.0;

/// Whether held-out data are predicted worse after than before by more than chance: the sum of weighted or of plain
/// squares rises by more than its scatter between blocks of frames, with some margin.
pub(crate) fn surely_worse(model: &Model<'_>, before: &Fitted, after: &Fitted) -> bool {
    let weights = noise_of(before, after);
    let (mut rise, mut squared) = ([0.0; 2], [0.0; 2]);
    for (k, _, span) in held_out_pixels(model.seen, JudgedOn::of(model.seen)) {
        let mut block = [0.0f64; 2];
        for p in &model.seen.pixels[span] {
            let at = (*p as usize / model.seen.sensor[1], *p as usize % model.seen.sensor[1]);
            let of = |fit: &Fitted, noise: &Fitted| {
                let [r, w] = [fit.predicted[k].residual_dn[at], noise.predicted[k].inverse_sigma[at]].map(f64::from);
                [r * r * w * w, if w > 0.0 { r * r } else { 0.0 }]
            };
            let [was, is] = [of(before, weights), of(after, after)];
            block.iter_mut().zip(is.iter().zip(was)).for_each(|(sum, (is, was))| *sum += is - was);
        }
        for i in 0..2 {
            rise[i] += block[i];
            squared[i] += block[i] * block[i];
        }
    }
    (0..2).any(|i| rise[i] > SURE * squared[i].sqrt())
}

/// Figures of a fit, with the noise of another.
fn weighed(model: &Model<'_>, fitted: &Fitted, noise: &Fitted) -> Figures {
    let seen = model.seen;
    if judged(seen).next().is_none() {
        return Figures::NONE;
    }
    let black = model.forward.noise().black_level_dn;
    let (mut chi2, mut n, mut error, mut light) = (0.0, 0.0, 0.0, 0.0);
    let mut s = [0.0f64; 6];
    for (k, block, span) in held_out_pixels(seen, JudgedOn::of(seen)) {
        let share = fitted.state.share(k, block);
        let (here, measured) = (&fitted.predicted[k], &seen.frames[k].measured);
        for p in &seen.pixels[span] {
            let at = (*p as usize / seen.sensor[1], *p as usize % seen.sensor[1]);
            let (r, w) = (f64::from(here.residual_dn[at]), f64::from(noise.predicted[k].inverse_sigma[at]));
            if w <= 0.0 {
                continue;
            }
            chi2 += r * r * w * w;
            n += share;
            let y = f64::from(measured[at]) - black;
            let mu = y - r;
            error += r * r;
            light += y * y;
            for (sum, v) in s.iter_mut().zip([1.0, y, mu, y * y, mu * mu, y * mu]) {
                *sum += v;
            }
        }
    }
    let m = s[0].max(1.0);
    let (vy, vm, c) = (s[3] - s[1] * s[1] / m, s[4] - s[2] * s[2] / m, s[5] - s[1] * s[2] / m);
    let pcc = if vy > 0.0 && vm > 0.0 { c / (vy * vm).sqrt() } else { 0.0 };
    Figures { chi2_ndf: chi2 / f64::max(n, 1.0), nrmse: (error / f64::max(light, 1e-30)).sqrt(), pcc }
}

#[cfg(test)]
mod tests {
    use super::worse;

    #[test]
    fn worse_is_a_rise_that_nothing_outweighs() {
        assert!(worse([1.05, 0.03], [1.0502, 0.02]) && worse([1.05, 0.03], [1.05, 0.03001]));
        assert!(!worse([1.05, 0.03], [1.05, 0.03]) && !worse([1.05, 0.03], [1.05005, 0.030002]));
        // The relative error rises by 1 part in 3000, chi-squared falls by 1 % or by 1 part in 1000.
        assert!(!worse([1.05, 0.03], [1.0395, 0.03001]) && worse([1.05, 0.03], [1.049, 0.03001]));
        assert!(worse([2.0, 0.03], [1.0, 0.03004]));
        // Shared noise: less than 1 is not what noise alone gives.
        assert!(!worse([0.73, 0.03], [0.78, 0.03]) && worse([0.99, 0.03], [1.01, 0.03]));
        // Sessions without figures.
        assert!(!worse([f64::NAN; 2], [f64::NAN; 2]) && !worse([0.0; 2], [0.0; 2]));
    }
}
