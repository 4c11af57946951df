//! Histograms of scores, and intervals from them.
//!
//! A score is `s = (truth - reconstruction) / scale` of one pixel. Its sign is kept, because reconstructions err to one
//! side: a dark pixel can only be too bright. Bins are equal in `ln |s|` from [`LEAST`] to [`MOST`], for both signs.

/// Scores below this count as equally small: the bin next to zero, on each side.
const LEAST: f64 = 1e-2;
/// Scores above this are in the last bin.
const MOST: f64 = 1e2;
/// Bins a side.
const SIDE: usize = 40;
/// Number of bins of a histogram.
pub(super) const BINS: usize = 2 * SIDE;

/// Upper edge of bin `k` of one side, in scores.
fn edge(k: usize) -> f64 {
    LEAST * (MOST / LEAST).powf(k as f64 / (SIDE - 1) as f64)
}

/// Lower and upper edge of bin `k` of one side; the first begins at 0.
fn edges(k: usize) -> [f64; 2] {
    [if k == 0 { 0.0 } else { edge(k - 1) }, edge(k)]
}

/// Bin of a score: those below zero first, with the largest in front.
pub(super) fn bin(score: f64) -> usize {
    let size = score.abs();
    let k = if size <= LEAST {
        0
    } else {
        let at = (size / LEAST).ln() / (MOST / LEAST).ln() * (SIDE - 1) as f64;
        (at.ceil() as usize).min(SIDE - 1)
    };
    if score > 0.0 { SIDE + k } else { SIDE - 1 - k }
}

/// The score below which the share `share` of one side lies; `side` are its bins from zero outwards.
fn quantile(side: &[f64], share: f64) -> f64 {
    let wanted = share * side.iter().sum::<f64>();
    let mut below = 0.0;
    for (k, n) in side.iter().enumerate() {
        if below + n >= wanted && *n > 0.0 {
            let [low, high] = edges(k);
            return low + (high - low) * ((wanted - below) / n).clamp(0.0, 1.0);
        }
        below += n;
    }
    side.iter().rposition(|n| *n > 0.0).map_or(0.0, edge)
}

/// The share of one side that lies below `score`.
fn share_below(side: &[f64], score: f64) -> f64 {
    let total: f64 = side.iter().sum();
    let inside = side.iter().enumerate().map(|(k, n)| {
        let [low, high] = edges(k);
        n * ((score - low) / (high - low)).clamp(0.0, 1.0)
    });
    if total > 0.0 { inside.sum::<f64>() / total } else { 1.0 }
}

/// Limits of an interval, scores: `low` <= 0 <= `high`.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Limits {
    /// Lower limit.
    pub low: f64,
    /// Upper limit.
    pub high: f64,
}

/// The two sides of a histogram, each from zero outwards.
fn sides(histogram: &[f64]) -> [Vec<f64>; 2] {
    [histogram[..SIDE].iter().rev().copied().collect(), histogram[SIDE..].to_vec()]
}

impl Limits {
    /// Limits that leave out the share `miss` of a histogram: half of it on each side. Where one side holds less than
    /// half of `miss`, all of it is left out there and the other side gives the rest, so that the interval always holds
    /// the reconstruction itself.
    pub fn of(histogram: &[f64], miss: f64) -> Self {
        let [minus, plus] = sides(histogram);
        let [below, above] = [&minus, &plus].map(|side| side.iter().sum::<f64>());
        let total = below + above;
        if total <= 0.0 {
            return Self::default();
        }
        let [below, above] = [below / total, above / total];
        let high = (miss / 2.0).min(above).max(miss - below).min(miss);
        let low = miss - high;
        let limit = |side: &[f64], share: f64, out: f64| {
            if share <= 0.0 { 0.0 } else { quantile(side, (1.0 - out / share).clamp(0.0, 1.0)) }
        };
        Self { low: -limit(&minus, below, low), high: limit(&plus, above, high) }
    }

    /// Share of a histogram inside the limits.
    pub fn holds(&self, histogram: &[f64]) -> f64 {
        let [minus, plus] = sides(histogram);
        let [below, above] = [&minus, &plus].map(|side| side.iter().sum::<f64>());
        if below + above <= 0.0 {
            return 1.0;
        }
        (below * share_below(&minus, -self.low) + above * share_below(&plus, self.high)) / (below + above)
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use ommatidia_session::rng;
    use rand_distr::{Distribution, StandardNormal};

    fn histogram(scores: impl Iterator<Item = f64>) -> Vec<f64> {
        let mut counts = vec![0.0; BINS];
        scores.for_each(|s| counts[bin(s)] += 1.0);
        counts
    }

    #[test]
    fn bins_ascend_and_hold_their_scores() {
        let scores = [-500.0, -3.0, -0.02, -0.001, 0.001, 0.02, 3.0, 500.0].map(bin);
        assert!(scores.windows(2).all(|w| w[0] < w[1]), "{scores:?}");
        assert_eq!((scores[0], scores[7], bin(0.0)), (0, BINS - 1, SIDE - 1));
        for score in [0.3, 1.0, 7.7, 42.0] {
            let [low, high] = edges(bin(score) - SIDE);
            assert!(low < score && score <= high);
        }
    }

    #[test]
    fn gaussian_errors_get_the_gaussian_interval() {
        let draws = |name| {
            let mut rng = rng::stream(1, name, 0);
            (0..40_000).map(move |_| -> f64 { StandardNormal.sample(&mut rng) })
        };
        let limits = Limits::of(&histogram(draws("learn")), 0.1);
        // 1.645 standard deviations; a bin is 26 % wide, and inside it the interpolation is linear.
        assert!((limits.high - 1.645).abs() < 0.05 && (limits.low + 1.645).abs() < 0.05, "{limits:?}");
        let inside = draws("judge").filter(|s| limits.low <= *s && *s <= limits.high).count() as f64 / 40_000.0;
        // Both samples scatter: sqrt(2) * sqrt(0.9 * 0.1 / 40,000) = 0.2 %.
        assert!((inside - 0.9).abs() < 0.008, "{inside}");
        // The histogram takes scores as even inside a bin.
        assert!((limits.holds(&histogram(draws("judge"))) - inside).abs() < 0.012);
    }

    #[test]
    fn one_sided_errors_spend_the_whole_miss_on_their_side() {
        let scores = || (1..=1000).map(|i| -(i as f64) / 100.0);
        let limits = Limits::of(&histogram(scores()), 0.1);
        assert_eq!(limits.high, 0.0);
        assert!((limits.low + 9.0).abs() < 0.25, "{limits:?}");
        let other = Limits::of(&histogram(scores().map(|s| -s)), 0.1);
        assert_eq!((other.low, other.high), (-0.0, -limits.low));
        assert_eq!(Limits::of(&[0.0; BINS], 0.1), Limits::default());
    }
}
