//! Read noise of each pixel: the pixels of real sensors differ, and a few are far worse than the others.
//!
//! The variance `v` of a pixel over `n` darks scatters about its true value by a chi-squared distribution of `f = n -
//! 1` degrees of freedom. If the variances scatter more than that, the true ones are assumed to follow a scaled inverse
//! chi-squared distribution of `d` degrees of freedom about `s^2`, which has a heavy tail. The estimate for each pixel
//! is then `(d s^2 + f v) / (d + f)`. Both `d` and `s^2` follow from the mean and the variance of `ln v` over the
//! pixels (Smyth, *Stat. Appl. Genet. Mol. Biol.* 3, 3, 2004).

use ndarray::Array2;

/// Smallest number of degrees of freedom that distinguishes pixels.
const LEAST_FREEDOM: f64 = 7.0;
/// Smallest common standard deviation, DN. Below it, rounding dominates the variances.
const LEAST_DN: f64 = 0.5;
/// The spread between pixels must exceed this many standard errors ...
const SIGNIFICANT: f64 = 5.0;
/// ... and this share of the spread due to counting statistics.
const LEAST_SPREAD: f64 = 0.03;

/// Estimates the variance of each pixel without light, [rows, cols], DN^2, from temporal variances of the same shape
/// with `freedom` degrees of freedom; `None` if the pixels do not differ significantly.
pub(super) fn by_pixel(variances: &Array2<f64>, freedom: f64) -> Option<Array2<f32>> {
    if freedom < LEAST_FREEDOM {
        return None;
    }
    let half = freedom / 2.0;
    let logs: Vec<f64> = variances.iter().filter(|v| **v > 0.0).map(|v| v.ln() - digamma(half) + half.ln()).collect();
    let count = logs.len() as f64;
    if count < 0.9 * variances.len() as f64 {
        return None;
    }
    let mean = logs.iter().sum::<f64>() / count;
    let spread = logs.iter().map(|e| (e - mean).powi(2)).sum::<f64>() / (count - 1.0);
    let counting = trigamma(half);
    let excess = spread - counting;
    if mean.exp().sqrt() < LEAST_DN || excess < (SIGNIFICANT * (2.0 / count).sqrt()).max(LEAST_SPREAD) * counting {
        return None;
    }
    let prior = trigamma_inverse(excess);
    let common = (mean + digamma(prior) - prior.ln()).exp();
    let (d, f) = (2.0 * prior, freedom);
    Some(variances.mapv(|v| ((d * common + f * v) / (d + f)) as f32))
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
        let found = by_pixel(&own, 16.0).unwrap();
        // Error of ln variance, which is the relative error of a weight.
        let error = |get: &dyn Fn((usize, usize)) -> f64| {
            let sum: f64 = sigmas.indexed_iter().map(|(at, s)| (get(at) / (s * s)).ln().powi(2)).sum();
            (sum / sigmas.len() as f64).sqrt()
        };
        let mean = own.mean().unwrap();
        let (by_map, by_mean, by_own) = (error(&|at| f64::from(found[at])), error(&|_| mean), error(&|at| own[at]));
        assert!(by_map < 0.9 * by_own && by_map < 0.5 * by_mean, "{by_map} {by_own} {by_mean}");
        // The bad pixels are recognised.
        let seen = sigmas.indexed_iter().filter(|(_, s)| **s > 5.0).all(|(at, s)| f64::from(found[at]) > 0.1 * s * s);
        assert!(seen);
    }
}
