//! Read noise of each pixel: the pixels of real sensors differ, and a few are far worse than the others.
//!
//! The variance `v` of a pixel over `n` darks scatters about its true value by a chi-squared distribution of `f = n -
//! 1` degrees of freedom. If the variances scatter more than that, the true ones are assumed to follow a scaled inverse
//! chi-squared distribution of `d` degrees of freedom about `s^2`, which has a heavy tail. That of a pixel then has `d + f`
//! degrees of freedom about `(d s^2 + f v) / (d + f)`, and the mean `(d s^2 + f v) / (d + f - 2)` is the estimate: with
//! it squared residuals over their variances have the mean 1. Both `d` and `s^2` follow from the mean and the variance of `ln v` over the
//! pixels (Smyth, *Stat. Appl. Genet. Mol. Biol.* 3, 3, 2004). Pixels far above the others (telegraph noise, hot pixels)
//! are of another kind: they take no part in these moments, and keep their own variances as far as it is certain that
//! they are noisy.

use ndarray::Array2;
use puruspe::ln_gamma;

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
/// Number of times that the others are found and their moments taken, and that the share of noisy ones is estimated.
const ROUNDS: usize = 5;
/// There is a map if so large a share of the pixels is noisy, however equal the others are.
const LEAST_NOISY: f64 = 3e-4;
/// Largest variance of noisy pixels over the common one.
const RANGE: f64 = 1e4;
/// Spread of pixels that are equal, over that of counting: their common variance weighs a hundred times their own.
const NO_SPREAD: f64 = 0.01;

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
    let prior = trigamma_inverse(excess.max(NO_SPREAD * counting));
    let (d, f) = (2.0 * prior, freedom);
    let common = (mean + digamma(prior) - prior.ln()).exp();
    let beyond = logs.iter().filter(|e| **e > limit).count() as f64 / count;
    let noisy = Noisy::among(variances.iter().map(|v| v / common), (f, d), beyond);
    if mean.exp().sqrt() < LEAST_DN || !differ && noisy.share < LEAST_NOISY {
        return None;
    }
    // Mean and relative variance of a scaled inverse chi-squared distribution of so many degrees of freedom.
    let moments = |scale: f64, freedom: f64| (scale * freedom / (freedom - 2.0), 2.0 / (freedom - 4.0));
    let posterior = |v: f64| {
        let is_noisy = noisy.probability(v / common);
        let kinds = [(is_noisy, moments(v, f)), (1.0 - is_noisy, moments((d * common + f * v) / (d + f), d + f))];
        let mean: f64 = kinds.iter().map(|(p, (mean, _))| p * mean).sum();
        let square: f64 = kinds.iter().map(|(p, (mean, relative))| p * mean * mean * (1.0 + relative)).sum();
        (mean, square / (mean * mean) - 1.0)
    };
    let relative2 = variances.iter().map(|v| posterior(*v).1).sum::<f64>() / variances.len() as f64;
    Some(ReadingMap { variance_dn2: variances.mapv(|v| posterior(v).0 as f32), error: relative2.max(0.0).sqrt() })
}

/// Variance of each pixel without light, and its error.
pub(super) struct ReadingMap {
    /// Expected variance, [rows, cols], DN^2.
    pub variance_dn2: Array2<f32>,
    /// Rms relative error.
    pub error: f64,
}

/// Noisy pixels among the others: any variance from the common one to [`RANGE`] times it is as likely by its logarithm.
struct Noisy {
    /// Share of the pixels.
    share: f64,
    /// Degrees of freedom of a measured variance, and of the distribution of the others.
    freedom: (f64, f64),
    /// Logarithm of the constant factor of the density of the others.
    constant: f64,
}

impl Noisy {
    /// Estimates their share from variances relative to the common one, by expectation and maximisation (Dempster, Laird
    /// & Rubin, *J. R. Stat. Soc. B* 39, 1, 1977) from a first guess.
    fn among(relative: impl Iterator<Item = f64> + Clone, (f, d): (f64, f64), guess: f64) -> Self {
        let [a, b] = [f / 2.0, d / 2.0];
        let constant = ln_gamma(a + b) - ln_gamma(a) - ln_gamma(b) + a * (f / d).ln();
        let mut it = Self { share: guess.max(1e-6), freedom: (f, d), constant };
        for _ in 0..ROUNDS {
            let (sum, count) = relative.clone().fold((0.0, 0.0), |(s, c), x| (s + it.probability(x), c + 1.0));
            it.share = sum / f64::max(count, 1.0);
        }
        it
    }

    /// Probability that a pixel of a measured variance `x`, relative to the common one, is noisy.
    fn probability(&self, x: f64) -> f64 {
        if x <= 1.0 {
            return 0.0;
        }
        // Densities of ln x: of the others x has an F distribution.
        let (f, d) = self.freedom;
        let of_others = (self.constant + f / 2.0 * x.ln() - (f + d) / 2.0 * (f * x / d).ln_1p()).exp();
        let of_noisy = 1.0 / RANGE.ln();
        self.share * of_noisy / (self.share * of_noisy + (1.0 - self.share) * of_others)
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

/// The argument at which [`trigamma`], a decreasing function, has the value `y` > 0; by bisection.
fn trigamma_inverse(y: f64) -> f64 {
    let (mut low, mut high) = (1e-3f64.ln(), 1e6f64.ln());
    for _ in 0..60 {
        let middle = (low + high) / 2.0;
        if trigamma(middle.exp()) > y { low = middle } else { high = middle }
    }
    low.exp()
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;
    use ommatidia_session::rng;
    use rand::RngExt;
    use rand_distr::{Distribution, StandardNormal};

    #[test]
    fn the_special_functions_have_their_known_values() {
        assert!((digamma(1.0) + 0.577_215_664_901_532_9).abs() < 1e-10);
        assert!((digamma(0.5) + 1.963_510_026_021_423_5).abs() < 1e-10);
        assert!((trigamma(1.0) - std::f64::consts::PI.powi(2) / 6.0).abs() < 1e-9);
        assert!((trigamma(0.5) - std::f64::consts::PI.powi(2) / 2.0).abs() < 1e-9);
        for x in [0.02, 0.7, 3.0, 400.0] {
            assert!((trigamma_inverse(trigamma(x)) / x - 1.0).abs() < 1e-9);
        }
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
        // The bad pixels are recognised, and their variances are not those of the others: what counts is by how much a
        // pixel scatters more than the map says.
        let bad: Vec<f64> =
            sigmas.indexed_iter().filter(|(_, s)| **s > 3.5).map(|(at, s)| s * s / f64::from(found[at])).collect();
        let mean = bad.iter().sum::<f64>() / bad.len() as f64;
        assert!(bad.len() > 100 && (mean - 1.0).abs() < 0.15, "{mean}");
        // The stated error is that of the map, whose squared residuals have a mean of 1.
        let ratios: Vec<f64> = sigmas.indexed_iter().map(|(at, s)| s * s / f64::from(found[at])).collect();
        let mean = ratios.iter().sum::<f64>() / ratios.len() as f64;
        let rms = (ratios.iter().map(|r| (r - 1.0).powi(2)).sum::<f64>() / ratios.len() as f64).sqrt();
        assert!((mean - 1.0).abs() < 0.02 && (0.8..1.25).contains(&(rms / stated)), "{mean} {rms} {stated}");
        let seen = sigmas.indexed_iter().filter(|(_, s)| **s > 5.0).all(|(at, s)| f64::from(found[at]) > 0.1 * s * s);
        assert!(seen);
    }
}
