//! The covariance channel: what frames of the same light differ by.
//!
//! The difference of two repeats holds no mean model at all, so it tells whether the *noise* is as the model says: its variance by
//! level of light, the correlation of neighbours, what whole rows or columns share. Each such feature is known to its sampling error;
//! what an effect does to it is found by drawing the same noise with and without the effect.

use super::design::Cell;
use super::model::{Column, Model, Predicted, State, Term};
use crate::effects::{Chain, Stage};
use crate::rng::stream;
use crate::session::Role;
use ndarray::{Array2, s};
use rand_distr::{Distribution, StandardNormal};
use rayon::prelude::*;

/// Features of one level of light: variance; correlation along the row, along the column, diagonally; variance that rows and that
/// columns share.
const FEATURES: usize = 6;
/// Pairs of repeats that the effect of a column is drawn on, a level: the random numbers cancel, one tells.
const DRAWN: usize = 1;

/// Pairs of repeats of the same light.
struct Level {
    pairs: Vec<(usize, usize)>,
}

/// The cells of the covariance channel: of the pairs that may be fitted, and of those held out. Their frame and block are
/// one past the last.
pub(super) fn cells(
    model: &Model<'_>,
    state: &State,
    trials: &[Term],
    columns: &[Column],
    replicates: usize,
    now: &[Predicted],
) -> Vec<Cell> {
    let frames = &model.seen.frames;
    let derivative: Vec<Option<Drawn>> = columns.par_iter().map(|c| drawn(model, state, trials, c)).collect();
    [false, true]
        .into_iter()
        .filter_map(|held_out| {
            let levels = levels(model, held_out);
            let rows = columns.len() + replicates + 1;
            let n = levels.len() * FEATURES;
            if n == 0 {
                return None;
            }
            let mut x = Array2::<f32>::zeros((rows, n));
            let parts: Vec<(usize, Vec<[f64; FEATURES]>, [f64; FEATURES])> = levels
                .par_iter()
                .enumerate()
                .map(|(i, level)| {
                    let (sum, pixels) = measured(now, model, level);
                    let sigma = sampling(model, now, level, pixels);
                    let base = noise_features(model, &model.chain(&state.terms), level, now);
                    let plain = match state.terms.iter().any(noisy) {
                        true => noise_features(model, &Chain::default(), level, now),
                        false => base,
                    };
                    let change = derivative
                        .iter()
                        .map(|d| match d {
                            None => [0.0; FEATURES],
                            Some(d) => {
                                let with = noise_features(model, &d.chain, level, now);
                                std::array::from_fn(|f| (with[f] - base[f]) / d.step / sigma[f])
                            }
                        })
                        .collect();
                    (i, change, std::array::from_fn(|f| (sum[f] - base[f] + plain[f]) / sigma[f]))
                })
                .collect();
            for (i, change, residual) in &parts {
                for f in 0..FEATURES {
                    for (row, c) in change.iter().enumerate() {
                        x[[row, i * FEATURES + f]] = c[f] as f32;
                    }
                    x[[rows - 1, i * FEATURES + f]] = residual[f] as f32;
                }
            }
            let gram = x.dot(&x.t());
            Some(Cell { frame: frames.len(), block: model.seen.blocks.len(), held_out, pixels: n, gram })
        })
        .collect()
}

/// Whether an effect can change the noise at all.
fn noisy(term: &Term) -> bool {
    matches!(term.effect.descriptor().stage, Stage::Charge | Stage::Electronics)
}

/// A column's chain at a step.
struct Drawn {
    chain: Chain,
    step: f64,
}

fn drawn(model: &Model<'_>, state: &State, trials: &[Term], column: &Column) -> Option<Drawn> {
    let (mut terms, which, param) = match column {
        Column::Scale(_) | Column::Black => return None,
        Column::Trial { term, param } => {
            let terms: Vec<Term> = state.terms.iter().chain([&trials[*term]]).cloned().collect();
            (terms, state.terms.len(), *param)
        }
        Column::Own { term, param } => (state.terms.clone(), *term, *param),
    };
    if !noisy(&terms[which]) {
        return None;
    }
    let p = terms[which].expanded(model.lenses())[param].1;
    let value = &mut terms[which].params[param];
    // Far enough to stand out of the drawn noise, whose random numbers are the same on both sides.
    let step = if *value + 2.0 * p.step > p.max { -2.0 * p.step } else { 2.0 * p.step };
    *value += step;
    Some(Drawn { chain: model.chain(&terms), step })
}

fn levels(model: &Model<'_>, held_out: bool) -> Vec<Level> {
    let frames = &model.seen.frames;
    let mut keyed: Vec<([f64; 3], Level)> = Vec::new();
    for (k, f) in frames.iter().enumerate() {
        let Some(p) = f.previous else { continue };
        let q = &frames[p];
        let same = f.info.illumination == q.info.illumination && f.info.exposure_ms == q.info.exposure_ms;
        if !matches!(f.role, Role::Dark | Role::Flat) || !same || f.held_out != held_out || q.held_out != held_out {
            continue;
        }
        let key = [f.stack as f64, f.info.illumination, f.info.exposure_ms];
        match keyed.iter_mut().find(|(k, _)| *k == key) {
            // Pairs that share a frame are not independent.
            Some((_, level)) if level.pairs.iter().any(|(a, b)| *a == p || *b == p) => {}
            Some((_, level)) => level.pairs.push((p, k)),
            None => keyed.push((key, Level { pairs: vec![(p, k)] })),
        }
    }
    keyed.into_iter().map(|(_, l)| l).collect()
}

/// Features of the measured pairs, what they are without excess taken off, and the pixels they are of.
fn measured(now: &[Predicted], model: &Model<'_>, level: &Level) -> ([f64; FEATURES], f64) {
    let frames = &model.seen.frames;
    let (mut sum, mut pixels) = ([0.0; FEATURES], 0.0);
    for (a, b) in &level.pairs {
        let expected = &now[*b].dn - &now[*a].dn;
        let mut d = &frames[*b].measured - &frames[*a].measured - expected;
        d.zip_mut_with(&now[*a].inverse_sigma, |d, w| *d *= w * std::f32::consts::FRAC_1_SQRT_2);
        let f = features(d);
        sum.iter_mut().zip(f).for_each(|(s, f)| *s += f);
        pixels += now[*a].dn.len() as f64;
    }
    (sum.map(|s| s / level.pairs.len() as f64), pixels)
}

/// Features of a standardised difference; all are zero on average for white noise of variance one.
fn features(mut d: Array2<f32>) -> [f64; FEATURES] {
    // A lamp that flickers moves all pixels together: that is no noise of the sensor.
    let mean = d.mean().unwrap_or(0.0);
    d.mapv_inplace(|v| v - mean);
    let (rows, cols) = d.dim();
    let n = (rows * cols).max(1) as f64;
    let together = |dr: usize, dc: usize| -> f64 {
        if rows <= dr || cols <= dc {
            return 0.0;
        }
        let (a, b) = (d.slice(s![..rows - dr, ..cols - dc]), d.slice(s![dr.., dc..]));
        a.iter().zip(&b).map(|(x, y)| f64::from(x * y)).sum::<f64>() / n
    };
    let shared = |axis: usize| -> f64 {
        let lines = d.axis_iter(ndarray::Axis(axis));
        let squares: f64 = lines
            .map(|line| {
                let sum: f64 = line.iter().map(|v| f64::from(*v)).sum();
                sum * sum / line.len().max(1) as f64 - 1.0
            })
            .sum();
        squares / d.len_of(ndarray::Axis(axis)).max(1) as f64
    };
    [together(0, 0) - 1.0, together(0, 1), together(1, 0), together(1, 1), shared(0), shared(1)]
}

/// Standard errors of the features, with how well the calibration knows the variance.
fn sampling(model: &Model<'_>, now: &[Predicted], level: &Level, pixels: f64) -> [f64; FEATURES] {
    let (noise, pairs) = (model.forward.noise(), level.pairs.len() as f64);
    let (rows, cols) = (model.seen.sensor[0] as f64, model.seen.sensor[1] as f64);
    let light = level
        .pairs
        .first()
        .map_or(0.0, |(a, _)| f64::from(now[*a].light_e.mean().unwrap_or(0.0)) * noise.gain_dn_per_e);
    let read = (noise.gain_dn_per_e * noise.read_noise_e).powi(2);
    let total = noise.gain_dn_per_e * light + read + 1.0 / 12.0;
    let by_gain = noise.gain_sigma / noise.gain_dn_per_e * noise.gain_dn_per_e * light / total;
    let by_reading = 2.0 * noise.read_noise_sigma / noise.read_noise_e.max(1e-9) * read / total;
    let variance = (2.0 / pixels + by_gain.powi(2) + by_reading.powi(2)).sqrt();
    let white = (1.0 / pixels).sqrt();
    [variance, white, white, white, (2.0 / (rows * pairs)).sqrt(), (2.0 / (cols * pairs)).sqrt()]
}

/// Features of noise drawn on a level under a chain, with the same random numbers whatever the chain.
fn noise_features(model: &Model<'_>, chain: &Chain, level: &Level, now: &[Predicted]) -> [f64; FEATURES] {
    let noise = model.forward.noise_with(chain);
    let read = noise.read_noise_e as f32;
    let shot = (noise.gain_dn_per_e / model.forward.noise().gain_dn_per_e).sqrt() as f32;
    let mut sum = [0.0; FEATURES];
    let drawn = level.pairs.len().min(DRAWN);
    for (a, _) in level.pairs.iter().take(drawn) {
        let cx = model.context(*a, None);
        let light = &now[*a].light_e;
        let quiet = {
            let mut charge = light.clone();
            chain.on_charge(&mut charge, &cx);
            model.forward.to_dn(charge, chain, &cx)
        };
        let mut rng = stream(0x5eed, "noise features", *a as u64);
        let mut charge = light.mapv(|e| {
            let z: f32 = StandardNormal.sample(&mut rng);
            e + shot * e.max(0.0).sqrt() * z
        });
        chain.on_charge(&mut charge, &cx);
        charge.mapv_inplace(|q| {
            let z: f32 = StandardNormal.sample(&mut rng);
            q + read * z
        });
        let mut dn = model.forward.to_dn(charge, chain, &cx);
        chain.on_reading(&mut dn, &cx, &mut stream(0x5eed, "reading", *a as u64));
        let mut d = dn - quiet;
        d.zip_mut_with(&now[*a].inverse_sigma, |d, w| *d *= w);
        sum.iter_mut().zip(features(d)).for_each(|(s, f)| *s += f);
    }
    sum.map(|s| s / drawn.max(1) as f64)
}
