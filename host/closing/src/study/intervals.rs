//! Intervals of shares that respect shared calibrations.

use super::record::Outcome;
use ommatidia_session::rng;
use rand::RngExt;
use serde::Serialize;
use std::collections::BTreeMap;

/// Resamplings of the instruments.
const DRAWS: usize = 2000;

/// `k` of `n`, with a 95 % interval: the hull of that of Wilson (J. Am. Stat. Assoc. 22, 209, 1927), which takes
/// sessions
/// as independent, and of a bootstrap over instruments (Davison and Hinkley, Bootstrap Methods and their Application,
/// 1997, section 3.8), which lets the sessions of one calibration fail together but has no width where all agree.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Share {
    /// How many.
    pub k: usize,
    /// Of how many.
    pub n: usize,
    /// Lower end.
    pub low: f64,
    /// Upper end.
    pub high: f64,
}

impl Share {
    /// Counts the outcomes for which `holds` is true; the sessions of an instrument are one cluster.
    pub fn of<'a>(outcomes: impl IntoIterator<Item = &'a Outcome>, holds: impl Fn(&Outcome) -> bool) -> Self {
        let mut clusters: BTreeMap<u64, [usize; 2]> = BTreeMap::new();
        for o in outcomes {
            let [k, n] = clusters.entry(o.case.instrument).or_default();
            *k += usize::from(holds(o));
            *n += 1;
        }
        Self::clustered(&clusters.into_values().collect::<Vec<_>>())
    }

    /// Of clusters, each `[k, n]`.
    pub fn clustered(clusters: &[[usize; 2]]) -> Self {
        let sum = |i: usize| clusters.iter().map(|c| c[i]).sum();
        let alone = Self::new(sum(0), sum(1));
        if clusters.len() < 2 || alone.n == 0 {
            return alone;
        }
        let mut rng = rng::stream(clusters.len() as u64, "study/bootstrap", alone.n as u64);
        let mut shares: Vec<f64> = (0..DRAWS)
            .map(|_| {
                let (mut k, mut n) = (0, 0);
                for _ in 0..clusters.len() {
                    let c = clusters[rng.random_range(0..clusters.len())];
                    (k, n) = (k + c[0], n + c[1]);
                }
                k as f64 / n.max(1) as f64
            })
            .collect();
        shares.sort_by(f64::total_cmp);
        let at = |q: f64| shares[((q * DRAWS as f64) as usize).min(DRAWS - 1)];
        Self { low: alone.low.min(at(0.025)), high: alone.high.max(at(0.975)), ..alone }
    }

    /// `k` of `n` that are independent.
    pub fn new(k: usize, n: usize) -> Self {
        let (low, high) = wilson(k as f64, n as f64);
        Self { k, n, low, high }
    }

    /// k / n.
    pub fn share(&self) -> f64 {
        self.k as f64 / self.n.max(1) as f64
    }
}

fn wilson(k: f64, n: f64) -> (f64, f64) {
    if n == 0.0 {
        return (0.0, 1.0);
    }
    let (z, p) = (1.96f64, k / n);
    let middle = p + z * z / (2.0 * n);
    let half = z * (p * (1.0 - p) / n + z * z / (4.0 * n * n)).sqrt();
    let scale = 1.0 + z * z / n;
    (((middle - half) / scale).max(0.0), ((middle + half) / scale).min(1.0))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn intervals_are_those_of_wilson_where_sessions_are_independent() {
        // Brown, Cai and DasGupta, Stat. Sci. 16, 101 (2001): 0 of 50 and 10 of 50.
        let (none, some) = (Share::new(0, 50), Share::new(10, 50));
        assert!(none.low == 0.0 && (none.high - 0.0713).abs() < 1e-3);
        assert!((some.low - 0.1124).abs() < 1e-3 && (some.high - 0.3304).abs() < 1e-3);
    }

    #[test]
    fn instruments_that_fail_as_a_whole_widen_the_interval() {
        // 10 instruments of 10 sessions: 2 in which all fail, or 2 failures in each.
        let together: Vec<[usize; 2]> = (0..10).map(|i| [if i < 2 { 10 } else { 0 }, 10]).collect();
        let (apart, together) = (Share::clustered(&[[2, 10]; 10]), Share::clustered(&together));
        assert_eq!((apart.k, together.k), (20, 20));
        assert_eq!(apart, Share::new(20, 100));
        // The binomial of 10 instruments: 0 of 10 to 5 of 10 about.
        assert!(together.low <= 0.001 && together.high >= 0.4, "{together:?}");
    }
}
