//! Excess kurtosis of noise: zero if it is normal, positive if a few pixels scatter more than the others.

use ndarray::Array2;

/// Values beyond so many standard deviations count as this many: one broken pixel is no evidence. Of normal numbers
/// less than one in a million lies beyond.
const LIMIT: f64 = 5.0;
/// Median of the square of a normal number of variance 1.
const MEDIAN_SQUARE: f64 = 0.454_936;
/// Variance of the excess kurtosis of n normal numbers is this over n (Fisher, Proc. London Math. Soc. 30, 199, 1930).
const OF_NORMAL: f64 = 24.0;

/// Mean of the fourth power over the squared variance, less 3, of values with mean zero. The variance is that of the
/// values inside the limit, so that the few outside do not hide themselves.
pub(super) fn excess_kurtosis(values: &Array2<f32>) -> f64 {
    let mut squares: Vec<f64> = values.iter().map(|v| f64::from(*v).powi(2)).collect();
    let middle = squares.len() / 2;
    if squares.is_empty() {
        return 0.0;
    }
    let (_, median, _) = squares.select_nth_unstable_by(middle, f64::total_cmp);
    let far = LIMIT * LIMIT * *median / MEDIAN_SQUARE;
    let (inside, number) = squares.iter().filter(|s| **s <= far).fold((0.0, 0.0), |(s, n), v| (s + v, n + 1.0));
    let variance: f64 = inside / f64::max(number, 1.0);
    if variance <= 0.0 {
        return 0.0;
    }
    let fourth = |s: &f64| (s / variance).min(LIMIT * LIMIT).powi(2);
    squares.iter().map(fourth).sum::<f64>() / squares.len() as f64 - 3.0
}

/// Variance of the excess kurtosis of n values, times n, where the kurtosis that is expected of them is that of a few
/// pixels, each of which is far outside or not.
pub(super) fn kurtosis_variance(expected: f64) -> f64 {
    OF_NORMAL + expected.max(0.0) * LIMIT.powi(4)
}

#[cfg(test)]
mod tests {
    use super::*;
    use ommatidia_session::rng::stream;
    use rand_distr::{Distribution, StandardNormal};

    /// Of normal numbers of a variance, with some values that jump by `jump` up, down, or not at all.
    fn kurtosis(sigma: f32, pixels: usize, jump: f32, seed: u64) -> f64 {
        let mut rng = stream(seed, "kurtosis", 0);
        let mut values = Array2::from_shape_simple_fn((100, 100), || {
            let z: f32 = StandardNormal.sample(&mut rng);
            sigma * z
        });
        for (i, v) in values.iter_mut().take(pixels).enumerate() {
            *v += [jump, -jump, 0.0, 0.0][i % 4];
        }
        excess_kurtosis(&values)
    }

    #[test]
    fn normal_noise_has_none_and_scatters_as_stated() {
        let sigma = (kurtosis_variance(0.0) / 1e4).sqrt();
        for scale in [1.0, 30.0] {
            let z: Vec<f64> = (0..60).map(|seed| kurtosis(scale, 0, 0.0, seed) / sigma).collect();
            let (mean, rms) = (z.iter().sum::<f64>() / 60.0, (z.iter().map(|z| z * z).sum::<f64>() / 60.0).sqrt());
            assert!(mean.abs() < 0.45 && (0.75..1.25).contains(&rms), "{mean} {rms}");
        }
        assert_eq!(excess_kurtosis(&Array2::zeros((0, 3))), 0.0);
        assert_eq!(excess_kurtosis(&Array2::zeros((4, 3))), 0.0);
    }

    #[test]
    fn few_pixels_count_by_their_number_and_one_alone_hardly() {
        // 20 of 10^4 values lie far outside: each counts as 5^4.
        for jump in [8.0, 1000.0] {
            let found: f64 = (0..20).map(|seed| kurtosis(1.0, 40, jump, 100 + seed)).sum::<f64>() / 20.0;
            assert!((found - 20.0 * 625e-4).abs() < 0.1, "{found}");
        }
        let one = kurtosis(1.0, 1, 1e4, 7) - kurtosis(1.0, 0, 0.0, 7);
        assert!(one < 1.5 * (kurtosis_variance(0.0) / 1e4).sqrt(), "{one}");
    }
}
