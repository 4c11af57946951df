//! The covariance channel: differences between frames of the same light.
//!
//! The expected frame cancels in the difference of two repeats, so the difference tests the *noise* model alone: the
//! variance by level of light, the correlation of neighbours, the variance common to rows or columns. Each such feature
//! has a known sampling error. The change of a feature by an effect is computed from noise drawn with and without the
//! effect.

use super::cell::Cell;
use super::derivative::{Expansion, Varied};
use super::features::{FEATURES, Features, TAILS, features, lines, tails, without_tails};
use super::kurtosis::kurtosis_variance;
use super::model::Model;
use super::same::{SMOOTH_PX, shows_the_same};
use super::state::{Column, Predicted, State, Term};
use crate::data::Shown;
use ndarray::{Array1, Array2};
use ommatidia_physics::effects::{Chain, Effect, Stage, blur_within};
use ommatidia_physics::linalg::{SymmetricEigen, symmetric_eigen};
use ommatidia_session::Role;
use ommatidia_session::rng::stream;
use rand::{Rng, RngExt};
use rand_distr::{Distribution, StandardNormal};
use rayon::prelude::*;

/// Standard error of a feature that is not measured: a million times that of a measured one, and no more, since both
/// share a covariance matrix whose inverse must hold the small one to many digits.
const UNKNOWN: f64 = 1e4;
/// Standardised features that are smaller are those of [`UNKNOWN`] errors.
const SHOWN: f64 = 1e-2;
/// Differences beyond so many standard deviations are no normal noise, where there are a few of them.
const FAR: f64 = 8.0;
const FEW: usize = 3;
/// Noise with a smaller standard deviation, DN, is known to the converter in few codes.
const COARSE_DN: f64 = 1.0;
/// Number of noise frames that are drawn for each level.
const DRAWN: usize = 2;

/// Pairs of repeats of the same light.
struct Level {
    pairs: Vec<(usize, usize)>,
    /// Successive frames of an unknown specimen, which may move a little: they show the noise common to rows and
    /// columns alone.
    unknown: bool,
}

impl Level {
    /// Features of a standardised difference, [sensor rows, sensor cols].
    fn features(&self, d: &Array2<f32>) -> Features {
        if self.unknown { of_lines(d) } else { features(d) }
    }

    /// Those of noise that was drawn twice for one frame: the mean of both, and the kurtosis of their difference, which
    /// is not that of one frame.
    fn features_of(&self, drawn: [Array2<f32>; DRAWN]) -> Features {
        let of = if self.unknown { of_lines } else { without_tails };
        let [first, second] = drawn.each_ref().map(of);
        let mut all: Features = std::array::from_fn(|f| 0.5 * (first[f] + second[f]));
        if !self.unknown {
            let [first, second] = drawn;
            all[TAILS] = tails(&((second - first) * std::f32::consts::FRAC_1_SQRT_2));
        }
        all
    }
}

/// Of a difference of an unknown specimen only the variances common to rows and to columns: the change of a specimen
/// from one frame to the next is smooth.
fn of_lines(d: &Array2<f32>) -> Features {
    let ([rows, cols], _) = lines(&(d - &blur_within(d, SMOOTH_PX)));
    [0.0, 0.0, 0.0, 0.0, 0.0, rows, cols]
}

/// The cells of the covariance channel: one of the training pairs, one of the held-out pairs. Their indices of frame
/// and block are one past the last.
pub(crate) fn cells(model: &Model<'_>, at: Expansion<'_>, columns: &[Column], replicates: usize) -> Vec<Cell> {
    let (state, now) = (at.state, at.predicted);
    let derivative: Vec<Option<Drawn>> = columns.par_iter().map(|c| drawn(model, at, c)).collect();
    [false, true]
        .into_iter()
        .filter_map(|held_out| {
            let levels = levels(model, held_out, now);
            if levels.is_empty() {
                return None;
            }
            let rows = columns.len() + replicates + 1;
            let parts: Vec<(Vec<Features>, Features, Features)> = levels
                .par_iter()
                .map(|level| {
                    let base = noise_features(model, &model.chain(&state.terms), level, now);
                    let change = |d: &Option<Drawn>| match d {
                        None => [0.0; FEATURES],
                        Some(d) if level.unknown && !d.of_the_grid => [0.0; FEATURES],
                        Some(d) => {
                            let with = noise_features(model, &d.chain, level, now);
                            std::array::from_fn(|f| (with[f] - base[f]) / d.step)
                        }
                    };
                    let (excess, expected) = excess(model, state, now, level, base);
                    (derivative.iter().map(change).collect(), excess, expected)
                })
                .collect();
            let expected: Vec<Features> = parts.iter().map(|p| p.2).collect();
            let sampling = Sampling::of(model, now, &levels, &expected);
            let mut x = Array2::<f32>::zeros((rows, levels.len() * FEATURES));
            let mut put = |row: usize, features: Vec<Features>| {
                x.row_mut(row)
                    .iter_mut()
                    .zip(sampling.standardised(&features).iter().flatten())
                    .for_each(|(x, v)| *x = *v as f32);
            };
            for (i, _) in derivative.iter().enumerate().filter(|(_, d)| d.is_some()) {
                put(i, parts.iter().map(|p| p.0[i]).collect());
            }
            put(rows - 1, parts.iter().map(|p| p.1).collect());
            let (frame, block, pixels) = (model.seen.frames.len(), model.seen.blocks.len(), x.ncols() as f64);
            Some(Cell { frame, block, held_out, pixels, gram: x.dot(&x.t()), log_variance: sampling.log_variance() })
        })
        .collect()
}

/// Significance, in standard deviations, of wings of the noise beyond those of normal noise and of the effects of a
/// state: of the sum of the excess kurtosis over the levels that show it, 0 where none does. Infinite where a few
/// differences are so large that no normal noise makes them: they show even where noise has few codes.
pub(crate) fn wings(model: &Model<'_>, state: &State, now: &[Predicted]) -> f64 {
    let pairs = levels(model, false, now).into_iter().filter(|level| !level.unknown).flat_map(|level| level.pairs);
    if pairs.into_iter().any(|pair| outliers(model, now, pair) >= FEW) {
        return f64::INFINITY;
    }
    let tails = residuals(model, state, now).into_iter().map(|f| f[TAILS]);
    // Levels that do not show it have errors so large that they stand at zero.
    let shown: Vec<f64> = tails.filter(|z| z.abs() > SHOWN).collect();
    shown.iter().sum::<f64>() / (shown.len().max(1) as f64).sqrt()
}

/// Measured minus expected features of each level in standard errors: independent standard normal variables if the
/// noise model is right. Held-out repeats are left out.
pub(crate) fn residuals(model: &Model<'_>, state: &State, now: &[Predicted]) -> Vec<Features> {
    let levels = levels(model, false, now);
    let one = |level: &Level| {
        let base = noise_features(model, &model.chain(&state.terms), level, now);
        excess(model, state, now, level, base)
    };
    let (raw, expected): (Vec<Features>, Vec<Features>) = levels.par_iter().map(one).unzip();
    Sampling::of(model, now, &levels, &expected).standardised(&raw)
}

/// Measured features minus those that the effects of a state cause, and the latter. `base`: features of noise drawn
/// under the state.
fn excess(model: &Model<'_>, state: &State, now: &[Predicted], level: &Level, base: Features) -> (Features, Features) {
    let measured = measured(now, model, level);
    let plain = match state.terms.iter().any(noisy) {
        // After the subtraction of a blur even white noise has non-zero features.
        _ if level.unknown => [0.0; FEATURES],
        true => noise_features(model, &in_weights(model, state), level, now),
        false => base,
    };
    let mut expected: Features = std::array::from_fn(|f| base[f] - plain[f]);
    expected[TAILS] += by_uncertain_variances(model, now, level);
    (std::array::from_fn(|f| measured[f] - expected[f]), expected)
}

/// Excess kurtosis of normal noise in units of variances that err pixel by pixel, as those of few darks do: three times
/// the mean square of their relative errors. 0 for an unknown specimen.
fn by_uncertain_variances(model: &Model<'_>, now: &[Predicted], level: &Level) -> f64 {
    let (Some((a, _)), Some(reading)) = (level.pairs.first(), model.forward.reading_dn2()) else { return 0.0 };
    if level.unknown {
        return 0.0;
    }
    let share2 = |(v, w): (&f32, &f32)| f64::from(v * w * w).powi(2);
    let shares = reading.iter().zip(&now[*a].inverse_sigma).map(share2);
    3.0 * model.maps.reading.powi(2) * shares.sum::<f64>() / reading.len().max(1) as f64
}

/// The effects whose noise the weights of the residuals hold: those that bend it with the light, and no others.
pub(crate) fn in_weights(model: &Model<'_>, state: &State) -> Chain {
    let bending: Vec<Term> = state.terms.iter().filter(|t| t.effect.bends_noise()).cloned().collect();
    model.chain(&bending)
}

/// Whether a term changes the noise.
pub(crate) fn noisy(term: &Term) -> bool {
    is_of_noise(term.effect)
}

/// Whether an effect changes the noise.
pub(crate) fn is_of_noise(effect: &dyn Effect) -> bool {
    matches!(effect.descriptor().stage, Stage::Charge | Stage::Electronics)
}

/// The chain with one value changed by a step of its inner unit.
struct Drawn {
    chain: Chain,
    step: f64,
    /// Whether the effect follows the pixel grid: others cannot be distinguished from an unknown specimen.
    of_the_grid: bool,
}

fn drawn(model: &Model<'_>, at: Expansion<'_>, column: &Column) -> Option<Drawn> {
    let Varied { mut terms, which, param } = at.varied(column)?;
    if !noisy(&terms[which]) {
        return None;
    }
    let p = terms[which].expanded(model.lenses())[param].1;
    let value = &mut terms[which].params[param];
    // Large enough to exceed the rounding of the drawn noise; both sides use the same random numbers.
    let (now, step) = (p.inner(*value), p.inner(2.0 * p.step));
    let step = if now + step > p.inner(p.max) { -step } else { step };
    *value = p.outer(now + step);
    Some(Drawn { chain: model.chain(&terms), step, of_the_grid: terms[which].effect.is_of_the_grid() })
}

/// Pairs of successive frames of one light. Darks and flats are repeats by their role; two frames of unknown specimens
/// only if they prove to be.
fn levels(model: &Model<'_>, held_out: bool, now: &[Predicted]) -> Vec<Level> {
    let frames = &model.seen.frames;
    let mut keyed: Vec<([f64; 3], Level)> = Vec::new();
    for (k, f) in frames.iter().enumerate() {
        let Some(p) = f.previous else { continue };
        let q = &frames[p];
        let same = f.info.illumination == q.info.illumination && f.info.exposure_ms == q.info.exposure_ms;
        let unknown = f.shown == Shown::Unknown && q.shown == Shown::Unknown;
        let repeats = unknown || matches!(f.role, Role::Dark | Role::Flat);
        if !repeats || !same || f.held_out != held_out || q.held_out != held_out {
            continue;
        }
        if unknown && !shows_the_same(&f.measured, &q.measured, &now[p].inverse_sigma, model.forward.noise()) {
            continue;
        }
        let key = [f.stack as f64, f.info.illumination, f.info.exposure_ms];
        match keyed.iter_mut().find(|(k, _)| *k == key) {
            // Pairs with a common frame are not independent.
            Some((_, level)) if level.pairs.iter().any(|(a, b)| *a == p || *b == p) => {}
            Some((_, level)) => level.pairs.push((p, k)),
            None => keyed.push((key, Level { pairs: vec![(p, k)], unknown })),
        }
    }
    keyed.into_iter().map(|(_, l)| l).collect()
}

/// Features of the measured pairs of a level.
fn measured(now: &[Predicted], model: &Model<'_>, level: &Level) -> Features {
    let one = |pair: &(usize, usize)| level.features(&standardised(model, now, *pair, level.unknown));
    let all: Vec<Features> = level.pairs.iter().map(one).collect();
    std::array::from_fn(|f| {
        let mut values: Vec<f64> = all.iter().map(|v| v[f]).collect();
        if level.unknown {
            // The median is robust against a specimen that jumps or a frame that was damaged in transfer.
            values.sort_by(f64::total_cmp);
            return values[values.len() / 2];
        }
        values.iter().sum::<f64>() / values.len() as f64
    })
}

/// A difference of two repeats.
pub(super) struct Repeats {
    /// In standard deviations of the noise that the model expects, [sensor rows, sensor cols].
    pub(super) difference: Array2<f32>,
    /// Whether it is of two frames of an unknown specimen, which may move a little.
    pub(super) unknown: bool,
}

/// The differences of all pairs of repeats that are not held out.
pub(super) fn repeats(model: &Model<'_>, now: &[Predicted]) -> Vec<Repeats> {
    let of = |level: Level| {
        let unknown = level.unknown;
        level
            .pairs
            .into_iter()
            .map(move |pair| Repeats { difference: standardised(model, now, pair, unknown), unknown })
    };
    levels(model, false, now).into_iter().flat_map(of).collect()
}

/// The difference of a pair of repeats in standard deviations of the noise. What the model expects of it is taken off,
/// but for an unknown specimen.
fn standardised(model: &Model<'_>, now: &[Predicted], (a, b): (usize, usize), unknown: bool) -> Array2<f32> {
    let frames = &model.seen.frames;
    let mut d = &frames[b].measured - &frames[a].measured;
    if !unknown {
        d -= &(&now[b].dn - &now[a].dn);
    }
    d.zip_mut_with(&now[a].inverse_sigma, |d, w| *d *= w * std::f32::consts::FRAC_1_SQRT_2);
    d
}

/// Absolute differences of a pair of repeats less what the model expects, DN.
fn differences_dn(model: &Model<'_>, now: &[Predicted], (a, b): (usize, usize)) -> Vec<f32> {
    let frames = &model.seen.frames;
    let mut d = &frames[b].measured - &frames[a].measured;
    d -= &(&now[b].dn - &now[a].dn);
    d.iter().map(|v| v.abs()).filter(|v| v.is_finite()).collect()
}

/// Standard deviation of the noise of a pair of repeats as half of the pixels show it, DN: a camera that smooths its
/// frames leaves less than the model expects.
fn scatter_dn(model: &Model<'_>, now: &[Predicted], pair: (usize, usize)) -> f64 {
    let mut far = differences_dn(model, now, pair);
    let middle = far.len() / 2;
    if far.is_empty() {
        return 0.0;
    }
    let (_, median, _) = far.select_nth_unstable_by(middle, f32::total_cmp);
    // Of normal numbers half lie within 0.674 standard deviations; a difference has twice the variance of one frame.
    f64::from(*median) / 0.674_490 / std::f64::consts::SQRT_2
}

/// Number of differences of a pair of repeats that are no normal noise.
fn outliers(model: &Model<'_>, now: &[Predicted], pair: (usize, usize)) -> usize {
    let sigma_dn = scatter_dn(model, now, pair).max(COARSE_DN / 2.0) * std::f64::consts::SQRT_2;
    differences_dn(model, now, pair).into_iter().filter(|d| f64::from(*d) > FAR * sigma_dn).count()
}

/// Errors of the features of all levels.
struct Sampling {
    /// V^-1/2, [levels, levels], with V the covariance of the variances of all levels: errors of the calibrated gain
    /// and read noise are common to all levels.
    whitening: Array2<f64>,
    /// Standard errors of the other features, level by level.
    sigma: Vec<[f64; FEATURES - 1]>,
}

impl Sampling {
    /// `expected`: the features that the effects of a state cause. Larger variances scatter more.
    fn of(model: &Model<'_>, now: &[Predicted], levels: &[Level], expected: &[Features]) -> Self {
        let noise = model.forward.noise();
        let (rows, cols) = (model.seen.sensor[0] as f64, model.seen.sensor[1] as f64);
        let read = (noise.gain_dn_per_e * noise.read_noise_e).powi(2);
        // Relative errors of a level's variance: by its sample size, by the gain, by the read noise.
        let more = |v: f64| (1.0 + v).max(0.5);
        // Over all pairs, and of the drawn noise of an effect, relative to that of one pair without it.
        let scatter =
            |level: &Level, v: f64| (more(v).powi(2) / level.pairs.len() as f64 + v * v / DRAWN as f64).sqrt();
        let errors: Vec<[f64; 3]> = levels
            .iter()
            .zip(expected)
            .map(|(level, expected)| {
                let mean = level.pairs.first().map_or(0.0, |(a, _)| f64::from(now[*a].light_e.mean().unwrap_or(0.0)));
                let shot = noise.gain_dn_per_e.powi(2) * mean;
                let total = shot + read + 1.0 / 12.0;
                if level.unknown {
                    return [UNKNOWN, 0.0, 0.0];
                }
                [
                    scatter(level, expected[0]) * (2.0 / (rows * cols)).sqrt(),
                    noise.gain_sigma / noise.gain_dn_per_e * shot / total,
                    2.0 * noise.read_noise_sigma / noise.read_noise_e.max(1e-9) * read / total,
                ]
            })
            .collect();
        let n = levels.len();
        let v = Array2::from_shape_fn((n, n), |(i, j)| {
            let (a, b) = (errors[i], errors[j]);
            a[1] * b[1] + a[2] * b[2] + if i == j { a[0] * b[0] } else { 0.0 }
        });
        let whitening = symmetric_eigen(&v).map_or_else(
            |_| Array2::from_diag(&v.diag().mapv(|v| 1.0 / v.max(1e-30).sqrt())),
            |SymmetricEigen { values, vectors }| {
                (&vectors * &values.mapv(|v| 1.0 / v.max(1e-30).sqrt())).dot(&vectors.t())
            },
        );
        // Of noise that the converter rounds to few codes, the kurtosis is that of the codes.
        let is_coarse = |level: &Level| {
            let fine = |w: &&f32| **w > 0.0 && f64::from(**w) * COARSE_DN < 1.0;
            level.pairs.first().is_some_and(|(a, _)| {
                let w = &now[*a].inverse_sigma;
                2 * w.iter().filter(fine).count() < w.len()
            }) || level.pairs.first().is_some_and(|pair| scatter_dn(model, now, *pair) < COARSE_DN / 2.0)
        };
        let tails = |level: &Level, v: f64| {
            let pairs = level.pairs.len() as f64;
            ((kurtosis_variance(v) / pairs + kurtosis_variance(v) - kurtosis_variance(0.0)) / (rows * cols)).sqrt()
        };
        let sigma = |(level, expected): (&Level, &Features)| {
            let white = if level.unknown { UNKNOWN } else { scatter(level, expected[0]) / (rows * cols).sqrt() };
            let lines = |n: f64, v: f64| (2.0 / n).sqrt() * scatter(level, v);
            let tails = if level.unknown || is_coarse(level) { UNKNOWN } else { tails(level, expected[4]) };
            [white, white, white, tails, lines(rows, expected[5]), lines(cols, expected[6])]
        };
        Self { whitening, sigma: levels.iter().zip(expected).map(sigma).collect() }
    }

    /// Sum of the logarithms of the features' variances.
    fn log_variance(&self) -> f64 {
        let lines = self.sigma.iter().flatten().map(|s| 2.0 * s.ln()).sum::<f64>();
        // V^-1/2 is stored, so ln det V is minus twice the sum of its logarithms.
        let values =
            symmetric_eigen(&self.whitening).map_or(0.0, |eigen| eigen.values.mapv(|v| v.max(1e-30).ln()).sum());
        lines - 2.0 * values
    }

    /// Features in standard errors.
    fn standardised(&self, raw: &[Features]) -> Vec<Features> {
        let variance = self.whitening.dot(&Array1::from_iter(raw.iter().map(|f| f[0])));
        let one = |((raw, sigma), v): ((&Features, &[f64; FEATURES - 1]), &f64)| {
            std::array::from_fn(|f| if f == 0 { *v } else { raw[f] / sigma[f - 1] })
        };
        raw.iter().zip(&self.sigma).zip(&variance).map(one).collect()
    }
}

/// Features of noise drawn for a level under a chain. The random numbers do not depend on the chain.
fn noise_features(model: &Model<'_>, chain: &Chain, level: &Level, now: &[Predicted]) -> Features {
    let Some((a, _)) = level.pairs.first() else { return [0.0; FEATURES] };
    let draw = |i: usize| {
        let mut rngs = ["noise features", "reading"].map(|what| stream(0x5eed, what, (DRAWN * *a + i) as u64));
        let mut d = noise_dn(model, chain, *a, &now[*a].light_e, &mut rngs);
        d.zip_mut_with(&now[*a].inverse_sigma, |d, w| *d *= w);
        d
    };
    level.features_of(std::array::from_fn(draw))
}

/// Noise of frame `k` at a given light, DN, [sensor rows, sensor cols], with the effects of a chain on counted
/// electrons. The second generator draws the noise that the chain itself adds.
pub(crate) fn noise_dn(
    model: &Model<'_>,
    chain: &Chain,
    k: usize,
    light_e: &Array2<f32>,
    [rng, reading]: &mut [impl Rng; 2],
) -> Array2<f32> {
    let noise = model.forward.noise_with(chain);
    let read = noise.read_noise_e as f32;
    let shot = (noise.gain_dn_per_e / model.forward.noise().gain_dn_per_e).sqrt() as f32;
    let cx = model.context(k, None);
    let quiet = {
        let mut charge = light_e.clone();
        chain.on_charge(&mut charge, &cx);
        model.forward.to_dn(charge, chain, &cx)
    };
    let mut charge = light_e.mapv(|e| {
        let z: f32 = StandardNormal.sample(rng);
        e + shot * e.max(0.0).sqrt() * z
    });
    chain.on_charge(&mut charge, &cx);
    charge.mapv_inplace(|q| {
        let z: f32 = StandardNormal.sample(rng);
        q + read * z
    });
    let mut dn = model.forward.to_dn(charge, chain, &cx);
    chain.on_reading(&mut dn, &cx, reading);
    dn -= &quiet;
    // The converter rounds what an effect has smoothed, too. An even error in place of rounding lets features change
    // smoothly with the strength of an effect.
    dn.mapv_inplace(|v| v + rng.random_range(-0.5f32..0.5));
    dn
}
