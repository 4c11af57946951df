//! Whether the offsets of rows follow a wave: row noise is independent from row to row, interference is not.

use super::model::Model;
use super::repeats::{Repeats, repeats};
use super::state::Predicted;
use ndarray::{ArrayView1, Axis};
use ommatidia_physics::effects::blur_within;
use std::f64::consts::TAU;

/// A wave holds at least this share of the variance of the rows' offsets, in three neighbouring frequencies.
const SHARE: f64 = 0.3;
/// It stands out of the other frequencies by so many standard deviations.
const SURE: f64 = 5.0;
/// Fewest rows in which one is looked for.
const ROWS: usize = 32;
/// Standard deviation of the Gaussian blur that takes the change of an unknown specimen out of a difference, pixels.
const SMOOTH_PX: f64 = 2.0;

/// Rows after which a wave repeats that the offsets of the rows follow, in the differences of repeated frames; its
/// phase may differ from frame to frame. None: the offsets are independent, as those of row noise are, or too few.
pub(crate) fn rhythm(model: &Model<'_>, now: &[Predicted]) -> Option<f64> {
    let series: Vec<Vec<f64>> = repeats(model, now).into_iter().map(row_offsets).collect();
    let rows = series.first().map_or(0, Vec::len);
    if rows < ROWS {
        return None;
    }
    wave(&series)
}

/// Mean of each row of a difference, without the mean of all.
fn row_offsets(Repeats { mut difference, unknown }: Repeats) -> Vec<f64> {
    if unknown {
        difference = &difference - &blur_within(&difference, SMOOTH_PX);
    }
    let mean = f64::from(difference.mean().unwrap_or(0.0));
    let of_row = |row: ArrayView1<'_, f32>| f64::from(row.mean().unwrap_or(0.0)) - mean;
    difference.axis_iter(Axis(0)).map(of_row).collect()
}

/// The period of a wave in series of one length whose phases may differ. The mean periodogram of independent numbers is
/// flat: each of its values is a chi-squared of two degrees of freedom for each series (Schuster, Terr. Magn. 3, 13,
/// 1898), here taken as normal by its cube root (Wilson & Hilferty, PNAS 17, 684, 1931).
fn wave(series: &[Vec<f64>]) -> Option<f64> {
    let n = series.first()?.len();
    let power = |f: usize| -> f64 {
        let one = |s: &Vec<f64>| {
            let turn = TAU * f as f64 / n as f64;
            let sum = |part: fn(f64) -> f64| s.iter().enumerate().map(|(r, v)| v * part(turn * r as f64)).sum::<f64>();
            sum(f64::cos).powi(2) + sum(f64::sin).powi(2)
        };
        series.iter().map(one).sum()
    };
    // Neither the mean nor the highest frequency, which has one degree of freedom.
    let powers: Vec<f64> = (1..n.div_ceil(2)).map(power).collect();
    let all: f64 = powers.iter().sum();
    let (at, most) = powers.iter().enumerate().max_by(|a, b| a.1.total_cmp(b.1))?;
    let near: f64 = powers[at.saturating_sub(1)..(at + 2).min(powers.len())].iter().sum();
    // The others, without the wave itself.
    let usual = (all - near).max(1e-9 * all) / powers.len() as f64;
    let spread = 1.0 / (9.0 * series.len() as f64);
    let z = ((most / usual).cbrt() - (1.0 - spread)) / spread.sqrt();
    (all > 0.0 && near >= SHARE * all && z > SURE).then(|| n as f64 / (at + 1) as f64)
}

#[cfg(test)]
mod tests {
    use super::*;
    use ndarray::Array2;
    use rand_distr::{Distribution, StandardNormal};

    /// Offsets of 160 rows in five differences: independent ones, and a wave of so many rows with a phase of its own.
    fn series(wave: f64, period: f64) -> Vec<Vec<f64>> {
        let one = |k: u64| {
            let mut rng = ommatidia_session::rng::stream(k, "rows", 0);
            let phase = k as f64 * 1.7;
            let offset = |r: usize| {
                let noise: f64 = StandardNormal.sample(&mut rng);
                noise + wave * (TAU * r as f64 / period + phase).sin()
            };
            (0..160).map(offset).collect()
        };
        (0..5).map(one).collect()
    }

    #[test]
    fn a_wave_is_found_and_independent_offsets_have_none() {
        assert_eq!(wave(&series(0.0, 1.0)), None);
        for period in [3.7, 11.3, 40.0] {
            let found = wave(&series(1.5, period)).unwrap_or(0.0);
            assert!((found / period - 1.0).abs() < 0.15, "{period}: {found}");
        }
        // A faint one leaves the rest independent.
        assert_eq!(wave(&series(0.3, 11.3)), None);
    }

    #[test]
    fn offsets_are_those_of_the_rows() {
        let difference = Array2::from_shape_fn((4, 3), |(r, c)| r as f32 * 2.0 + c as f32);
        assert_eq!(row_offsets(Repeats { difference, unknown: false }), [-3.0, -1.0, 1.0, 3.0]);
    }
}
