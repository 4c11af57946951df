//! Omnibus tests: does the residual depend on anything at all? They need no catalogue of effects.
//!
//! For each covariate the residual of the scenes is summed in bins; the error of a bin's sum is its scatter between
//! cells (one frame by one block). The sum of squares over the bins is compared with residuals that are drawn from the
//! model: noise and errors of the calibration, with the nuisance parameters projected out as in the data. The null
//! distribution is a scaled chi-squared with the mean and variance of the draws.

use super::bins::{Bins, Statistic};
use super::covariate::{Covariate, Dependence};
use super::stats::{chi2_tail, sigmas, two_sided};
use super::tables;
use crate::data::Shown;
use crate::fit::features::{FEATURES, Features};
use crate::fit::{Errors, Fitted, Model, Predicted, Specimens, map_errors, repeats};
use ndarray::Array2;
use ommatidia_physics::noise::MapErrors;
use ommatidia_session::rng::stream;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};
use rayon::prelude::*;

/// Family-wise probability below which omnibus tests are significant (Bonferroni over all covariates).
const OMNIBUS: f64 = 0.01;

/// Dependences with a smaller share of the noise variance do not count as structure, however significant: errors of a
/// calibration that its replicates do not show reach that size (light outside the windows is 5e-5 of all light).
const SIZE: f64 = 1e-3;

/// Number of draws for the null distribution.
const DRAWS: usize = 48;

/// Tests the residual of a fit against every covariate, on the training frames with known objects (of unknown specimens
/// if there are no others), and the noise on repeats. `errors` are those of [`crate::fit::Replicas::of`];
/// `seed` is that of the draws.
pub fn test(model: &Model<'_>, fitted: &Fitted, errors: &Errors, seed: u64) -> Vec<Dependence> {
    let mut all = on_scenes(model, fitted, errors, seed);
    all.extend(on_repeats(repeats::residuals(model, &fitted.state, &fitted.predicted)));
    all.extend(on_pixels(tables::shared(model, &fitted.predicted)));
    all
}

/// Whether any test is significant and its dependence large enough to matter.
pub fn structured(dependences: &[Dependence]) -> bool {
    let mut seen = significant(dependences).peekable();
    let any = seen.peek().is_some();
    seen.for_each(|d| {
        tracing::info!(
            "residual against {}: z {:.1}, {:.1} for {:.1}, {:?} +- {:?}",
            d.covariate.words(),
            d.z,
            d.chi2,
            d.expected,
            d.mean,
            d.band
        )
    });
    any
}

/// The same of the mean of the frames: structure in the noise of repeats is none of the optics.
pub(crate) fn structured_mean(dependences: &[Dependence]) -> bool {
    significant(dependences).any(|d| d.covariate != Covariate::Repeats)
}

/// Share of the structure in the noise of repeated frames that is left, of that before; 0 where what is left is not
/// significant.
pub(crate) fn noise_left(before: &[Dependence], after: &[Dependence]) -> f64 {
    let beyond = |d: &Dependence| (d.chi2 - d.expected).max(0.0);
    let of_repeats = |d: &&Dependence| d.covariate == Covariate::Repeats;
    let Some(left) = significant(after).find(of_repeats).map(beyond) else { return 0.0 };
    let first = before.iter().find(of_repeats).map_or(0.0, beyond);
    let share = left / first.max(left);
    tracing::info!("{share:.3} of the structure in the noise of repeated frames is left");
    share
}

/// The dependences that are significant and large enough to matter.
pub(crate) fn significant(dependences: &[Dependence]) -> impl Iterator<Item = &Dependence> {
    let matters = |d: &&Dependence| d.size.is_none_or(|size| size > SIZE);
    dependences.iter().filter(|d| d.p * (dependences.len() as f64) < OMNIBUS).filter(matters)
}

/// The pattern common to two halves of the flats and darks; the larger of response and offset counts. Halves that have
/// less in common than chance gives, as those of the calibration itself do, have no pattern.
fn on_pixels(shared: [Option<f64>; 2]) -> Option<Dependence> {
    let mean: Vec<f64> = shared.into_iter().flatten().collect();
    let largest = mean.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    if mean.is_empty() {
        return None;
    }
    let n = mean.len() as f64;
    let p = (n * two_sided(largest.max(0.0)) / 2.0).min(1.0);
    Some(Dependence {
        covariate: Covariate::FixedPattern,
        at: (0..mean.len()).map(|i| i as f64).collect(),
        band: vec![1.0; mean.len()],
        size: None,
        chi2: mean.iter().map(|v| v.max(0.0).powi(2)).sum(),
        mean,
        expected: 0.5 * n,
        p,
        z: sigmas(p),
    })
}

/// The covariance channel. Its features are sums over many pixels, so they are normal and need no draws.
fn on_repeats(levels: Vec<Features>) -> Option<Dependence> {
    let n = levels.len() as f64;
    if levels.is_empty() {
        return None;
    }
    let mut mean = vec![0.0; FEATURES];
    let mut chi2 = 0.0;
    for level in &levels {
        mean.iter_mut().zip(level).for_each(|(m, v)| *m += v / n);
        chi2 += level.iter().map(|v| v * v).sum::<f64>();
    }
    let dof = n * FEATURES as f64;
    let p = chi2_tail(chi2, dof);
    Some(Dependence {
        covariate: Covariate::Repeats,
        at: (0..mean.len()).map(|i| i as f64).collect(),
        band: vec![1.0 / n.sqrt(); mean.len()],
        size: None,
        mean,
        chi2,
        expected: dof,
        p,
        z: sigmas(p),
    })
}

fn on_scenes(model: &Model<'_>, fitted: &Fitted, errors: &Errors, seed: u64) -> Vec<Dependence> {
    let (frames, now) = (scenes(model), &fitted.predicted);
    if frames.is_empty() {
        return Vec::new();
    }
    // The specimen has sharp detail of its own: only what is fixed to the pixel grid can be tested.
    let unknown = model.seen.frames[frames[0]].shown == Shown::Unknown;
    let fixed = |c: &Covariate| matches!(c, Covariate::RowParity | Covariate::ColumnParity | Covariate::Checkerboard);
    let tested: Vec<Covariate> = Covariate::ALL.into_iter().filter(|c| !unknown || fixed(c)).collect();
    let bins: Vec<Bins> = tested.par_iter().filter_map(|c| Bins::of(*c, model, now, &frames)).collect();
    let residual: Vec<Vec<f32>> = frames.iter().map(|k| gather(model, &now[*k], &now[*k].residual_dn)).collect();
    let directions: Vec<Vec<Option<Vec<f32>>>> = errors
        .changes
        .iter()
        .map(|r| frames.iter().map(|k| r[*k].as_ref().map(|d| gather(model, &now[*k], d))).collect())
        .collect();
    let templates: Vec<[Vec<f32>; 2]> = frames
        .iter()
        .map(|k| {
            let light = now[*k].light_e.mapv(|e| e * model.forward.noise().gain_dn_per_e as f32);
            [gather(model, &now[*k], &light), gather(model, &now[*k], &Array2::ones(light.dim()))]
        })
        .collect();
    // Effects on counted charge correlate the noise of neighbours; then the noise is drawn through their chain.
    let chain = fitted.state.terms.iter().any(repeats::noisy).then(|| model.chain(&fitted.state.terms));
    let noise = |f: usize, rngs: &mut [ChaCha8Rng; 2]| -> Vec<f32> {
        let frame = &residual[f];
        let seen = |v: &f32| *v != 0.0;
        match &chain {
            // A pixel that is not used has residual 0.
            None => frame.iter().map(|v| if seen(v) { StandardNormal.sample(&mut rngs[0]) } else { 0.0 }).collect(),
            Some(chain) => {
                let here = &now[frames[f]];
                let dn = repeats::noise_dn(model, chain, frames[f], &here.light_e, rngs);
                gather(model, here, &dn).iter().zip(frame).map(|(d, v)| if seen(v) { *d } else { 0.0 }).collect()
            }
        }
    };
    let left = map_errors(model, &fitted.state);
    let drawn = |d: usize| draw(&noise, &directions, &templates, left, seed, d as u64);
    let statistics = |drawn: &Vec<Vec<f32>>| bins.iter().map(|b| b.statistic(model, &frames, drawn)).collect();
    let draws: Vec<Vec<Statistic>> = match &fitted.state.specimens {
        None => (0..DRAWS).into_par_iter().map(|d| statistics(&drawn(d))).collect(),
        Some(specimens) => {
            let mut drawn: Vec<Vec<Vec<f32>>> = (0..DRAWS).into_par_iter().map(drawn).collect();
            for (f, k) in frames.iter().enumerate() {
                beside(specimens, model, &now[*k], &mut drawn.iter_mut().map(|d| &mut d[f]).collect::<Vec<_>>());
            }
            drawn.par_iter().map(statistics).collect()
        }
    };
    let judged = |(i, b): (usize, &Bins)| {
        let null: Vec<&Statistic> = draws.iter().map(|d| &d[i]).collect();
        judge(b, b.statistic(model, &frames, &residual), &null)
    };
    bins.iter().enumerate().map(judged).collect()
}

/// Compares a statistic with draws of the model.
fn judge(bins: &Bins, mut s: Statistic, null: &[&Statistic]) -> Dependence {
    let n = null.len() as f64;
    let mut squares: Vec<f64> = null.iter().map(|d| d.chi2).collect();
    let rms = |j: usize| (null.iter().map(|d| d.mean[j].powi(2)).sum::<f64>() / n).sqrt();
    let mut band: Vec<f64> = (0..s.mean.len()).map(rms).collect();
    if bins.covariate.is_product() {
        // Products have a non-zero expectation under the model; it is subtracted.
        let middle: Vec<f64> = (0..s.mean.len()).map(|j| null.iter().map(|d| d.mean[j]).sum::<f64>() / n).collect();
        band = (0..s.mean.len()).map(|j| (rms(j).powi(2) - middle[j].powi(2)).max(0.0).sqrt()).collect();
        let square = |d: &Statistic| -> f64 {
            (0..middle.len()).map(|j| ((d.mean[j] - middle[j]) / band[j].max(1e-30)).powi(2)).sum()
        };
        squares = null.iter().map(|d| square(d)).collect();
        // The mean of the draws has an error itself.
        s.chi2 = square(&s) / (1.0 + 1.0 / n);
        s.mean.iter_mut().zip(&middle).for_each(|(m, middle)| *m -= middle);
    }
    let size = (!bins.covariate.is_product()).then(|| {
        let excess = s.mean.iter().zip(&band).map(|(m, b)| m * m - b * b);
        (excess.sum::<f64>() / s.mean.len().max(1) as f64).max(0.0)
    });
    let expected = squares.iter().sum::<f64>() / n;
    let variance = squares.iter().map(|v| (v - expected).powi(2)).sum::<f64>() / (n - 1.0);
    // A scaled chi-squared of the same mean and variance.
    let p = chi2_tail(s.chi2 * 2.0 * expected / variance, 2.0 * expected * expected / variance);
    Dependence {
        covariate: bins.covariate,
        at: bins.at.clone(),
        mean: s.mean,
        band,
        size,
        chi2: s.chi2,
        expected,
        p,
        z: sigmas(p),
    }
}

/// The frames that are tested.
fn scenes(model: &Model<'_>) -> Vec<usize> {
    let frames = &model.seen.frames;
    let open = |k: &usize| !frames[*k].held_out;
    let known: Vec<usize> = (0..frames.len())
        .filter(open)
        .filter(|k| matches!(frames[*k].shown, Shown::Object(_) | Shown::Bead(..)))
        .collect();
    if !known.is_empty() {
        return known;
    }
    let of = |shown: Shown| (0..frames.len()).filter(move |k| frames[*k].shown == shown).collect::<Vec<_>>();
    let estimated = of(Shown::Estimated);
    if estimated.is_empty() { of(Shown::Unknown) } else { estimated }
}

/// Values at the used pixels, in units of the noise; zero in held-out blocks.
fn gather(model: &Model<'_>, here: &Predicted, image: &Array2<f32>) -> Vec<f32> {
    let (Some(image), Some(weight)) = (image.as_slice(), here.inverse_sigma.as_slice()) else { return Vec::new() };
    let seen = model.seen;
    let mut out: Vec<f32> = seen.pixels.iter().map(|p| image[*p as usize] * weight[*p as usize]).collect();
    for (span, _) in seen.blocks.iter().zip(&seen.held_out_blocks).filter(|(_, h)| **h) {
        out[span.clone()].fill(0.0);
    }
    out
}

/// Takes out of drawn residuals of a frame, at the used pixels and in units of the noise, what a change of its specimen
/// makes.
fn beside(specimens: &Specimens, model: &Model<'_>, here: &Predicted, drawn: &mut [&mut Vec<f32>]) {
    let pixels = &model.seen.pixels;
    let image = |values: &Vec<f32>| {
        let mut image = Array2::<f32>::zeros(here.dn.dim());
        if let (Some(image), Some(weight)) = (image.as_slice_mut(), here.inverse_sigma.as_slice()) {
            for (p, v) in pixels.iter().zip(values).map(|(p, v)| (*p as usize, v)).filter(|(p, _)| weight[*p] > 0.0) {
                image[p] = v / weight[p];
            }
        }
        image
    };
    let mut images: Vec<Array2<f32>> = drawn.iter().map(|d| image(d)).collect();
    specimens.remove(&mut images.iter_mut().collect::<Vec<_>>());
    drawn.iter_mut().zip(&images).for_each(|(d, image)| **d = gather(model, here, image));
}

/// Draws residuals of all frames from the model: noise, errors of the calibration and errors of the sensor maps, which
/// are the same in all frames; the light of the frames and the black level are projected out.
fn draw(
    noise: &impl Fn(usize, &mut [ChaCha8Rng; 2]) -> Vec<f32>,
    directions: &[Vec<Option<Vec<f32>>>],
    templates: &[[Vec<f32>; 2]],
    maps: MapErrors,
    seed: u64,
    index: u64,
) -> Vec<Vec<f32>> {
    let mut rngs = ["omnibus", "omnibus reading"].map(|what| stream(seed, what, index));
    let mut normal = || -> f32 { StandardNormal.sample(&mut rngs[0]) };
    let xi: Vec<f32> = directions.iter().map(|_| normal()).collect();
    let pixels = templates.first().map_or(0, |t| t[0].len());
    let mut pattern = |rms: f64| -> Vec<f32> {
        if rms > 0.0 { (0..pixels).map(|_| rms as f32 * normal()).collect() } else { vec![0.0; pixels] }
    };
    let patterns = [pattern(maps.response), pattern(maps.offset_dn)];
    let mut drawn: Vec<Vec<f32>> = (0..templates.len())
        .map(|f| {
            let mut r = noise(f, &mut rngs);
            for (pattern, template) in patterns.iter().zip(&templates[f]) {
                r.iter_mut().zip(pattern.iter().zip(template)).for_each(|(r, (p, t))| *r += p * t);
            }
            for (xi, direction) in xi.iter().zip(directions) {
                if let Some(d) = &direction[f] {
                    r.iter_mut().zip(d).for_each(|(r, d)| *r += xi * d);
                }
            }
            r
        })
        .collect();
    project(&mut drawn, templates);
    drawn
}

/// Projects out the light common to all frames and the black level.
fn project(frames: &mut [Vec<f32>], templates: &[[Vec<f32>; 2]]) {
    let dot = |a: &[f32], b: &[f32]| a.iter().zip(b).map(|(x, y)| f64::from(x * y)).sum::<f64>();
    let (mut g, mut s) = ([0.0; 3], [0.0; 2]);
    for (r, [a, b]) in frames.iter().zip(templates) {
        g.iter_mut().zip([dot(a, a), dot(a, b), dot(b, b)]).for_each(|(g, v)| *g += v);
        s.iter_mut().zip([dot(a, r), dot(b, r)]).for_each(|(s, v)| *s += v);
    }
    let determinant = g[0] * g[2] - g[1] * g[1];
    if determinant <= 1e-9 * g[0] * g[2] {
        return;
    }
    let (u, v) = ((g[2] * s[0] - g[1] * s[1]) / determinant, (g[0] * s[1] - g[1] * s[0]) / determinant);
    for (r, [a, b]) in frames.iter_mut().zip(templates) {
        for ((r, a), b) in r.iter_mut().zip(a).zip(b) {
            *r -= u as f32 * a + v as f32 * b;
        }
    }
}
