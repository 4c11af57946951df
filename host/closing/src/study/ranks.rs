//! Rank histograms: whether truths lie where the quoted errors say.
//!
//! If value and error describe a normal distribution of the truth, its cumulative probability at the truth is uniform
//! from 0 to 1 (simulation-based calibration: Talts et al., arXiv 1804.06788, 2018). Errors that are too small fill the
//! ends of the histogram, a bias one side of it.

use puruspe::{erfc, gammq};
use serde::Serialize;

/// Most bins of a histogram.
const BINS: usize = 10;
/// Least expected count in a bin.
const EXPECTED: usize = 5;

/// A histogram of ranks and its test.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Ranks {
    /// Counts from rank 0 to rank 1, in even bins.
    pub counts: Vec<usize>,
    /// Probability of a chi-squared at least as large if ranks are uniform; `None`: too few ranks.
    pub p: Option<f64>,
}

impl Ranks {
    /// The histogram of pulls, (value - truth) / sigma.
    pub fn of(pulls: &[f64]) -> Self {
        let bins = (pulls.len() / EXPECTED).min(BINS);
        if bins < 2 {
            return Self { counts: Vec::new(), p: None };
        }
        let mut counts = vec![0; bins];
        for pull in pulls {
            // Cumulative normal probability at the truth.
            let rank = 0.5 * erfc(pull / std::f64::consts::SQRT_2);
            counts[((rank * bins as f64) as usize).min(bins - 1)] += 1;
        }
        let expected = pulls.len() as f64 / bins as f64;
        let chi2: f64 = counts.iter().map(|n| (*n as f64 - expected).powi(2) / expected).sum();
        Self { counts, p: Some(gammq((bins as f64 - 1.0) / 2.0, chi2 / 2.0)) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use ommatidia_session::rng;
    use rand_distr::{Distribution, StandardNormal};

    #[test]
    fn ranks_of_normal_pulls_are_flat_and_those_of_small_errors_are_not() {
        let mut rng = rng::stream(3, "ranks", 0);
        let pulls: Vec<f64> = (0..400).map(|_| StandardNormal.sample(&mut rng)).collect();
        let p = |scale: f64, bias: f64| Ranks::of(&pulls.iter().map(|v| scale * v + bias).collect::<Vec<_>>()).p;
        assert!(p(1.0, 0.0).is_some_and(|p| p > 0.01));
        assert!(p(1.5, 0.0).is_some_and(|p| p < 1e-4) && p(1.0, 0.5).is_some_and(|p| p < 1e-4));
        assert!(p(0.6, 0.0).is_some_and(|p| p < 1e-4));
        let ranks = Ranks::of(&pulls);
        assert_eq!((ranks.counts.len(), ranks.counts.iter().sum::<usize>()), (10, 400));
        assert_eq!(Ranks::of(&pulls[..9]).p, None);
    }
}
