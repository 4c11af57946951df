//! Read noise of each pixel: the pixels of real sensors differ, and a few are far worse than the others.
//!
//! The variance `v` of a pixel over `n` darks scatters about its true value by a chi-squared distribution of `f = n -
//! 1` degrees of freedom. How the true values are distributed is found from all pixels together: of all distributions
//! it is the one under which the measured variances are most likely (the nonparametric maximum of likelihood: Kiefer &
//! Wolfowitz, *Ann. Math. Stat.* 27, 887, 1956), on a grid of logarithms, by expectation and maximisation (Laird, *J.
//! Am. Stat. Assoc.* 73, 805, 1978). No shape is assumed, since sensors have different ones: equal pixels, a broad
//! band, a tail of telegraph noise. The estimate of a pixel is its mean under that distribution given `v`. With it,
//! squared residuals over their variances have the mean 1, among quiet pixels and among noisy ones.

use ndarray::Array2;

/// Smallest number of degrees of freedom that distinguishes pixels.
const LEAST_FREEDOM: f64 = 7.0;
/// Smallest common standard deviation, DN. Below it, rounding dominates the variances.
const LEAST_DN: f64 = 0.5;
/// The spread between pixels must exceed this many standard errors ...
const SIGNIFICANT: f64 = 5.0;
/// ... and this share of the spread due to counting statistics.
const LEAST_SPREAD: f64 = 0.03;

/// Pixels whose log variance is so many standard deviations above the mean take no part in the moments of the others.
const FAR: f64 = 4.0;
/// Number of times that the others are found and their moments taken.
const ROUNDS: usize = 5;
/// There is a map if so large a share of the pixels is far above the others, however equal those are.
const LEAST_NOISY: f64 = 3e-4;
/// Spacing of the grid of log variances, in standard deviations of a measured one.
const SPACING: f64 = 0.25;
/// Largest number of points of the grid.
const POINTS: f64 = 500.0;
/// Number of steps of expectation and maximisation: more make the distribution spikier, and its means no different.
const STEPS: usize = 300;

/// Variance of each pixel without light, and its error.
pub(super) struct ReadingMap {
    /// Expected variance, [rows, cols], DN^2.
    pub variance_dn2: Array2<f32>,
    /// Rms relative error.
    pub error: f64,
}

/// Estimates the variance of each pixel without light, [rows, cols], DN^2, from temporal variances of the same shape
/// with `freedom` degrees of freedom; `None` if the pixels do not differ significantly.
pub(super) fn by_pixel(variances: &Array2<f64>, freedom: f64) -> Option<ReadingMap> {
    if freedom < LEAST_FREEDOM {
        return None;
    }
    let half = freedom / 2.0;
    let logs: Vec<f64> = variances.iter().filter(|v| **v > 0.0).map(|v| v.ln() - digamma(half) + half.ln()).collect();
    let count = logs.len() as f64;
    if count < 0.9 * variances.len() as f64 {
        return None;
    }
    let counting = trigamma(half);
    // Moments of the pixels that are of one kind: those far above the others are a kind of their own.
    let (mut limit, mut mean, mut spread) = (f64::INFINITY, 0.0, 0.0);
    for _ in 0..ROUNDS {
        let inside = || logs.iter().filter(|e| **e <= limit);
        let count = inside().count() as f64;
        mean = inside().sum::<f64>() / count;
        spread = inside().map(|e| (e - mean).powi(2)).sum::<f64>() / (count - 1.0);
        limit = mean + FAR * spread.sqrt();
    }
    let excess = spread - counting;
    let differ = excess >= (SIGNIFICANT * (2.0 / count).sqrt()).max(LEAST_SPREAD) * counting;
    let far = logs.iter().filter(|e| **e > limit).count() as f64 / count;
    if mean.exp().sqrt() < LEAST_DN || !differ && far < LEAST_NOISY {
        return None;
    }
    let truth = Distribution::of(variances, freedom);
    let relative2 = variances.iter().map(|v| truth.given(*v).relative2).sum::<f64>() / variances.len() as f64;
    Some(ReadingMap { variance_dn2: variances.mapv(|v| truth.given(v).mean as f32), error: relative2.max(0.0).sqrt() })
}

/// The distribution of true variances over the pixels, on a grid of their logarithms.
struct Distribution {
    /// Logarithm of the first variance of the grid.
    first: f64,
    /// Spacing of the logarithms.
    spacing: f64,
    /// For each measured variance of the grid, what the true one is.
    given: Vec<Given>,
}

/// What a measured variance says about the true one.
#[derive(Clone, Copy)]
struct Given {
    /// Expected value, DN^2.
    mean: f64,
    /// Variance over the square of the expected value.
    relative2: f64,
}

impl Distribution {
    /// The most likely distribution of the true variances of pixels whose measured ones are given.
    fn of(variances: &Array2<f64>, freedom: f64) -> Self {
        let positive = || variances.iter().filter(|v| **v > 0.0).map(|v| v.ln());
        let (low, high) = positive().fold((f64::MAX, f64::MIN), |(low, high), v| (low.min(v), high.max(v)));
        let spacing = (SPACING * (2.0 / freedom).sqrt()).max((high - low) / POINTS);
        let points = ((high - low) / spacing).ceil() as usize + 1;
        let mut it = Self { first: low, spacing, given: Vec::new() };
        let mut counts = vec![0.0; points];
        variances.iter().for_each(|v| counts[it.place(*v, points).round() as usize] += 1.0);
        // Density of a measured log variance at a true one, which depends on their difference alone; but for a factor.
        let density = |d: f64| (freedom / 2.0 * (d - d.exp() + 1.0)).exp();
        let kernel: Vec<f64> =
            (0..2 * points - 1).map(|i| density((i as f64 - (points - 1) as f64) * spacing)).collect();
        let row =
            |measured: usize| (0..points).map(|truth| kernel[measured + points - 1 - truth]).collect::<Vec<f64>>();
        let rows: Vec<Vec<f64>> = (0..points).map(row).collect();
        let mut prior = vec![1.0 / points as f64; points];
        let product = |row: &[f64], prior: &[f64]| row.iter().zip(prior).map(|(k, p)| k * p).sum::<f64>();
        for _ in 0..STEPS {
            let mut next = vec![0.0; points];
            for (row, count) in rows.iter().zip(&counts).filter(|(_, count)| **count > 0.0) {
                let weight = count / (product(row, &prior) * variances.len() as f64);
                next.iter_mut().zip(row).zip(&prior).for_each(|((n, k), p)| *n += weight * k * p);
            }
            prior = next;
        }
        let truth: Vec<f64> = (0..points).map(|i| (low + i as f64 * spacing).exp()).collect();
        let given = |row: &Vec<f64>| {
            let moment = |power: i32| row.iter().zip(&prior).zip(&truth).map(|((k, p), v)| k * p * v.powi(power)).sum();
            let [one, mean, square]: [f64; 3] = [moment(0), moment(1), moment(2)];
            Given { mean: mean / one, relative2: square * one / (mean * mean) - 1.0 }
        };
        it.given = rows.iter().map(given).collect();
        it
    }

    /// Place of a measured variance in a grid of so many points.
    fn place(&self, variance: f64, points: usize) -> f64 {
        ((variance.ln() - self.first) / self.spacing).clamp(0.0, (points - 1) as f64)
    }

    /// What a measured variance says about the true one.
    fn given(&self, variance: f64) -> Given {
        let place = self.place(variance, self.given.len());
        let (below, share) = (place as usize, place.fract());
        let (a, b) = (self.given[below], self.given[(below + 1).min(self.given.len() - 1)]);
        let between = |a: f64, b: f64| a + share * (b - a);
        Given { mean: between(a.mean, b.mean), relative2: between(a.relative2, b.relative2) }
    }
}

/// Logarithmic derivative of the gamma function, x > 0 (Abramowitz & Stegun, 6.3.5 and 6.3.18).
fn digamma(mut x: f64) -> f64 {
    let mut sum = 0.0;
    while x < 12.0 {
        sum -= 1.0 / x;
        x += 1.0;
    }
    let y = 1.0 / (x * x);
    sum + x.ln() - 0.5 / x - y * (1.0 / 12.0 - y * (1.0 / 120.0 - y / 252.0))
}

/// Derivative of [`digamma`], x > 0 (Abramowitz & Stegun, 6.4.6 and 6.4.12).
fn trigamma(mut x: f64) -> f64 {
    let mut sum = 0.0;
    while x < 12.0 {
        sum += 1.0 / (x * x);
        x += 1.0;
    }
    let y = 1.0 / (x * x);
    sum + 1.0 / x + 0.5 * y + y / x * (1.0 / 6.0 - y * (1.0 / 30.0 - y / 42.0))
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;
    use ommatidia_session::rng;
    use rand::RngExt;
    use rand_distr::{Distribution as _, StandardNormal};

    #[test]
    fn the_special_functions_have_their_known_values() {
        assert!((digamma(1.0) + 0.577_215_664_901_532_9).abs() < 1e-10);
        assert!((digamma(0.5) + 1.963_510_026_021_423_5).abs() < 1e-10);
        assert!((trigamma(1.0) - std::f64::consts::PI.powi(2) / 6.0).abs() < 1e-9);
        assert!((trigamma(0.5) - std::f64::consts::PI.powi(2) / 2.0).abs() < 1e-9);
    }

    /// Variances over 17 draws of pixels of the given standard deviations, DN.
    fn measured(sigmas: &Array2<f64>) -> Array2<f64> {
        let mut rng = rng::stream(4, "reading", 0);
        sigmas.mapv(|s| {
            let draws: Vec<f64> = (0..17)
                .map(|_| {
                    let z: f64 = StandardNormal.sample(&mut rng);
                    s * z
                })
                .collect();
            let mean = draws.iter().sum::<f64>() / 17.0;
            draws.iter().map(|d| (d - mean).powi(2)).sum::<f64>() / 16.0
        })
    }

    #[test]
    fn equal_pixels_have_no_map() {
        assert!(by_pixel(&measured(&Array2::from_elem((100, 100), 1.3)), 16.0).is_none());
    }

    #[test]
    fn the_estimate_beats_both_the_common_variance_and_each_pixels_own() {
        let mut rng = rng::stream(5, "reading", 1);
        // Most pixels have about 1 DN, one in fifty several times that.
        let sigmas = Array2::from_shape_simple_fn((100, 100), || {
            let z: f64 = StandardNormal.sample(&mut rng);
            (0.2 * z).exp() * if rng.random_range(0.0..1.0) < 0.02 { rng.random_range(3.0..15.0) } else { 1.0 }
        });
        let own = measured(&sigmas);
        let ReadingMap { variance_dn2: found, error: stated } = by_pixel(&own, 16.0).unwrap();
        // Error of ln variance, which is the relative error of a weight.
        let error = |get: &dyn Fn((usize, usize)) -> f64| {
            let sum: f64 = sigmas.indexed_iter().map(|(at, s)| (get(at) / (s * s)).ln().powi(2)).sum();
            (sum / sigmas.len() as f64).sqrt()
        };
        let mean = own.mean().unwrap();
        let (by_map, by_mean, by_own) = (error(&|at| f64::from(found[at])), error(&|_| mean), error(&|at| own[at]));
        assert!(by_map < 0.9 * by_own && by_map < 0.5 * by_mean, "{by_map} {by_own} {by_mean}");
        // What counts is by how much a pixel scatters more than the map says: not at all, among the quiet pixels by the
        // map as among the noisy ones.
        let mut pixels: Vec<(f64, f64)> =
            sigmas.indexed_iter().map(|(at, s)| (f64::from(found[at]), s * s / f64::from(found[at]))).collect();
        pixels.sort_by(|a, b| a.0.total_cmp(&b.0));
        let mean = |part: &[(f64, f64)]| part.iter().map(|p| p.1).sum::<f64>() / part.len() as f64;
        pixels.chunks(1000).enumerate().for_each(|(i, part)| {
            assert!((mean(part) - 1.0).abs() < 0.05, "tenth {i}: {}", mean(part));
        });
        // And the bad ones are among those.
        let noisy = mean(&pixels[9850..]);
        assert!((noisy - 1.0).abs() < 0.1, "{noisy}");
        // The stated error is that of the map.
        let rms = (pixels.iter().map(|p| (p.1 - 1.0).powi(2)).sum::<f64>() / pixels.len() as f64).sqrt();
        assert!((0.9..1.1).contains(&(rms / stated)), "{rms} {stated}");
        let seen = sigmas.indexed_iter().filter(|(_, s)| **s > 5.0).all(|(at, s)| f64::from(found[at]) > 0.1 * s * s);
        assert!(seen);
    }
}
