//! Single pixels that stand out from their neighbours.

use super::{Half, Shape, mean, outliers, scatter};
use crate::evidence::stats::{at_least, sigmas, two_sided};
use ndarray::{Array2, Zip};

/// Threshold of hot pixels in each half, standard deviations.
const STANDS_OUT: f64 = 4.5;
/// Pixels up to this far away are the neighbourhood that a pixel is compared with.
const NEAR_PX: isize = 2;
/// Hot pixels are single if at most this share of them have another one at a side.
const TOUCHING: f64 = 0.5;
/// Fewer hot pixels than this say nothing of how they lie.
const FEWEST: f64 = 8.0;

/// Outliers that are brighter than their neighbourhood.
pub(super) fn hot(a: &Half, b: &Half) -> Array2<bool> {
    let [a, b] = [a, b].map(beside_neighbours);
    Zip::from(&outliers(&a, &b)).and(&a.value).map_collect(|out, v| *out && *v > 0.0)
}

/// The values less those of the neighbourhood: the median over pairs of pixels that lie opposite to each other, so that
/// neither a slope nor another hot pixel counts. The glow of an amplifier is smooth, and none of its pixels is hot.
fn beside_neighbours(h: &Half) -> Half {
    let (rows, cols) = h.value.dim();
    let at = |r: usize, c: usize, dr: isize, dc: isize| {
        let (r, c) = (r.checked_add_signed(dr)?, c.checked_add_signed(dc)?);
        h.value.get((r, c)).filter(|_| h.weight[(r, c)] > 0.0)
    };
    // One of each pair: the other lies at the opposite offset.
    let offsets = (0..=NEAR_PX).flat_map(|dr| (-NEAR_PX..=NEAR_PX).map(move |dc| (dr, dc)));
    let offsets: Vec<(isize, isize)> = offsets.filter(|(dr, dc)| *dr > 0 || *dc > 0).collect();
    let value = Array2::from_shape_fn((rows, cols), |(r, c)| {
        let pair = |(dr, dc): &(isize, isize)| Some(0.5 * (at(r, c, *dr, *dc)? + at(r, c, -dr, -dc)?));
        let mut pairs: Vec<f32> = offsets.iter().filter_map(pair).collect();
        if pairs.is_empty() {
            // At a corner a slope and a hot pixel look the same.
            return 0.0;
        }
        let middle = pairs.len() / 2;
        h.value[(r, c)] - *pairs.select_nth_unstable_by(middle, f32::total_cmp).1
    });
    Half { value, weight: h.weight.clone(), scatter: h.scatter.clone(), frames: h.frames }
}

/// Whether most pixels of a table stand alone. Those of a bright area touch each other.
fn are_single(table: &Array2<f32>) -> bool {
    let is_hot = |r: usize, c: usize, dr: isize, dc: isize| {
        let at = (r.checked_add_signed(dr), c.checked_add_signed(dc));
        matches!(at, (Some(r), Some(c)) if table.get((r, c)).is_some_and(|v| *v != 0.0))
    };
    let sides = [(-1, 0), (1, 0), (0, -1), (0, 1)];
    let around = |r: usize, c: usize| sides.iter().any(|(dr, dc)| is_hot(r, c, *dr, *dc));
    let (mut number, mut touching) = (0.0, 0.0);
    for ((r, c), _) in table.indexed_iter().filter(|(_, v)| **v != 0.0) {
        number += 1.0;
        touching += if around(r, c) { 1.0 } else { 0.0 };
    }
    number < FEWEST || touching <= TOUCHING * number
}

/// Single pixels above their neighbourhood by the threshold, in both halves. None: they are not single. Their size is
/// the scale of an exponential distribution: their mean above the threshold. Of the share `jumping` of the pixels that
/// jump between two levels, some are by chance in the upper one in every frame: only more hot pixels than that prove
/// any.
pub(super) fn sparse(a: &Half, b: &Half, jumping: f64) -> Option<Shape> {
    let [a, b] = [a, b].map(beside_neighbours);
    let both = mean(&a, &b);
    let mut table = Array2::zeros(both.value.dim());
    let (mut z, mut sum, mut number) = (0.0f64, 0.0, 0.0f64);
    // Standard error of a typical pixel: the sensitivity if no pixel is hot.
    let weight = f64::from(both.weight.mean().unwrap_or(0.0));
    let one = if weight > 0.0 { 1.0 / weight.sqrt() } else { 0.0 };
    // The threshold includes the scatter of a pattern of all pixels, which makes none of them hot.
    let scatter = scatter(&both.value);
    Zip::indexed(&both.value).for_each(|at, v| {
        // Pixels that jump between two levels have a mean above the others by chance; they scatter as well.
        let stands_out = |h: &Half| h.value[at] / (h.scatter[at] / h.weight[at].max(1e-30) + scatter).sqrt();
        let least = f64::from(stands_out(&a).min(stands_out(&b)));
        if least > STANDS_OUT {
            table[at] = *v;
            sum += f64::from(*v);
            number += 1.0;
            z = z.max(least * std::f64::consts::SQRT_2);
        }
    });
    if !are_single(&table) {
        return None;
    }
    // One trial for each pixel.
    let chances = both.value.len() as f64;
    let z = if z > 0.0 { sigmas((two_sided(z) * chances).min(1.0)) } else { 0.0 };
    let by_chance = jumping * chances * 0.5f64.powf(both.frames);
    let z = if number > 0.0 && by_chance > 0.0 { z.min(sigmas(at_least(number, by_chance))) } else { z };
    let passed = STANDS_OUT * std::f64::consts::SQRT_2 * one;
    let size = if number > 0.0 { (sum / number - passed).max(one) } else { 0.0 };
    let error = one.hypot(size / number.max(1.0).sqrt());
    Some(Shape { table, size, error, doubt: 0.0, table_error: 0.0, z })
}
