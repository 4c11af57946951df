//! Waves along rows or columns, shared by the periodic effects.

use std::f64::consts::TAU;

/// Number of frequencies tried within `1 / n`, so that a wave between two of them loses little power.
const FINE: usize = 4;
/// Number of peaks to keep.
const KEEP: usize = 3;

/// `amplitude cos(2 pi i / period) + quadrature sin(2 pi i / period)` for i = 0 .. n-1.
pub(super) fn wave(n: usize, amplitude: f64, quadrature: f64, period: f64) -> Vec<f32> {
    let value = |i: usize| {
        let (sin, cos) = (TAU * i as f64 / period).sin_cos();
        (amplitude * cos + quadrature * sin) as f32
    };
    (0..n).map(value).collect()
}

/// Fourier sums of a signal of n values, at the frequencies `j / (4 n)`.
pub(super) struct Spectrum {
    turns: Vec<(f64, f64)>,
    n: usize,
}

impl Spectrum {
    /// Prepares sums for signals of `n` values.
    pub(super) fn new(n: usize) -> Self {
        let len = FINE * n;
        Self { turns: (0..len).map(|i| (TAU * i as f64 / len as f64).sin_cos()).collect(), n }
    }

    /// Indices of the frequencies above those of a constant or a slope, up to half a cycle per value.
    pub(super) fn indices(&self) -> std::ops::RangeInclusive<usize> {
        FINE / 2..=FINE * self.n / 2
    }

    /// Frequency at an index, cycles per value.
    pub(super) fn frequency(&self, j: usize) -> f64 {
        j as f64 / (FINE * self.n) as f64
    }

    /// Real and imaginary part of the sum at an index.
    pub(super) fn at(&self, signal: &[f64], j: usize) -> [f64; 2] {
        let mut sum = [0.0; 2];
        for (i, v) in signal.iter().enumerate() {
            let (sin, cos) = self.turns[i * j % self.turns.len()];
            sum[0] += v * cos;
            sum[1] -= v * sin;
        }
        sum
    }

    /// Whether two indices are so close that a single wave can make a peak at both.
    pub(super) fn same(i: usize, j: usize) -> bool {
        i.abs_diff(j) < FINE + FINE / 2
    }
}

/// Periods of the strongest waves in a signal, strongest first, in numbers of values. The signal is given as weighted
/// sums and the weights of these sums.
pub fn periods(sums: &[f64], weights: &[f64]) -> Vec<f64> {
    let total: f64 = weights.iter().sum();
    if sums.len() < 4 || total <= 0.0 {
        return Vec::new();
    }
    // The mean is subtracted, because a constant leaks into the lowest frequencies.
    let mean = sums.iter().sum::<f64>() / total;
    let signal: Vec<f64> = sums.iter().zip(weights).map(|(s, w)| s - mean * w).collect();
    let spectrum = Spectrum::new(signal.len());
    let at = |j: usize| {
        let [re, im] = spectrum.at(&signal, j);
        re * re + im * im
    };
    let mut power: Vec<(f64, usize)> = spectrum.indices().map(|j| (at(j), j)).collect();
    power.sort_by(|a, b| b.0.total_cmp(&a.0));
    let mut kept: Vec<usize> = Vec::new();
    for (p, j) in power {
        if p > 0.0 && kept.len() < KEEP && kept.iter().all(|k| !Spectrum::same(*k, j)) {
            kept.push(j);
        }
    }
    // The maximum of the parabola through a peak and its neighbours.
    let step = spectrum.frequency(1);
    let refined = |j: usize| {
        let (before, here, after) = (at(j.saturating_sub(1)), at(j), at(j + 1));
        let bend = before - 2.0 * here + after;
        let off = if bend < 0.0 { (0.5 * (before - after) / bend).clamp(-0.5, 0.5) } else { 0.0 };
        1.0 / (spectrum.frequency(j) + off * step).min(0.5)
    };
    kept.into_iter().map(refined).collect()
}
