//! Where truths lie beside the specimens that frames show.
//!
//! A point of the truth at x = (row, col) from the centre of its grid is the point x + d(x) of the specimen, with the
//! shift, turn and scale d(x) of [`crate::fit::truth`]. With t the truth and o the specimen, d minimises the sum of
//! `(o(x + d(x)) - g t(x) - b)^2` over the pixels, by Gauss-Newton steps (Lucas & Kanade, Proc. IJCAI 1981, 674); gain
//! g and level b are free in each frame. Both images are blurred before, so that their resolution does not matter.

use crate::fit::pseudo_inverse;
use crate::fit::record::median;
use crate::fit::truth::{PARTS, Registered};
use ndarray::{Array1, Array2};
use ommatidia_physics::effects::{blur_within, displacement_px};
use std::f64::consts::PI;

/// Images are blurred so far, pixels.
const SMOOTH_PX: f64 = 2.0;
/// Pixels at the edge of a truth that do not count: interpolated truths lose light there.
const EDGE: usize = 4;
/// Maximum number of steps.
const STEPS: usize = 20;
/// A step below this ends the search, pixels.
const SETTLED_PX: f64 = 1e-3;
/// A step moves a corner by no more than this, pixels.
const LONGEST_PX: f64 = 1.0;

/// How truths lie beside their specimens.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Placement {
    /// Shift along rows and columns, and the displacement of a corner by the turn and by the scale, object pixels.
    pub(crate) parts: Registered,
    /// Median over the frames of `1 - r^2`, with r the correlation of truth and specimen, for truths as they are
    /// recorded.
    pub(crate) apart: f64,
    /// The same after the truths were moved.
    pub(crate) left: f64,
    /// Median over the frames of the share of it that is left after the truths were moved.
    pub(crate) share: f64,
    /// Number of independent pixels: the blur leaves one of 4 pi sigma^2.
    pub(crate) pixels: usize,
}

/// A truth and its specimen, blurred.
struct Pair {
    truth: Array2<f32>,
    specimen: Array2<f32>,
}

/// Places some truths together beside their specimens, each pair [truth, specimen] of [object rows, object cols].
/// None: there are none.
pub(crate) fn placement(pairs: &[[&Array2<f32>; 2]]) -> Option<Placement> {
    let pairs: Vec<Pair> = pairs
        .iter()
        .map(|pair| {
            let [truth, specimen] = pair.map(|image| blur_within(image, SMOOTH_PX));
            Pair { truth, specimen }
        })
        .collect();
    let apart = left(&pairs, [0.0; PARTS]);
    let usual = median(apart.clone())?;
    let all: usize = pairs.iter().map(|p| p.truth.len()).sum();
    let pixels = (all as f64 / (4.0 * PI * SMOOTH_PX * SMOOTH_PX)) as usize;
    let coarse = displacement_px(pairs.iter().map(|p| [p.specimen.clone(), p.truth.clone()]));
    let placed = |start: [isize; 2]| {
        let parts = converge(&pairs, [start[0] as f64, start[1] as f64, 0.0, 0.0]);
        let left = left(&pairs, parts);
        let shares = left.iter().zip(&apart).map(|(left, apart)| left / apart.max(f64::MIN_POSITIVE)).collect();
        Some(Placement { parts, apart: usual, left: median(left)?, share: median(shares)?, pixels })
    };
    let starts = [Some([0, 0]), coarse].into_iter().flatten();
    starts.filter_map(placed).min_by(|a, b| a.share.total_cmp(&b.share))
}

/// The parts at which steps from a start settle.
fn converge(pairs: &[Pair], mut parts: Registered) -> Registered {
    for _ in 0..STEPS {
        let step = step(pairs, parts);
        let size = step.iter().map(|v| v * v).sum::<f64>().sqrt();
        let scale = LONGEST_PX / size.max(LONGEST_PX);
        parts.iter_mut().zip(step).for_each(|(p, d)| *p += scale * d);
        if size < SETTLED_PX {
            break;
        }
    }
    parts
}

/// For each pixel of a truth that counts its value, that of the specimen at its place, and the derivatives of that
/// along the parts.
fn samples(pair: &Pair, parts: Registered, mut take: impl FnMut(f64, f64, Registered)) {
    let (rows, cols) = pair.truth.dim();
    let centre = [rows, cols].map(|n| (n as f64 - 1.0) / 2.0);
    let corner = centre[0].hypot(centre[1]).max(1.0);
    for r in EDGE..rows.saturating_sub(EDGE) {
        for c in EDGE..cols.saturating_sub(EDGE) {
            let [y, x] = [r as f64 - centre[0], c as f64 - centre[1]].map(|v| v / corner);
            let at =
                [r as f64 + parts[0] + parts[2] * x + parts[3] * y, c as f64 + parts[1] - parts[2] * y + parts[3] * x];
            let Some((value, [dr, dc])) = bilinear(&pair.specimen, at) else { continue };
            take(f64::from(pair.truth[[r, c]]), value, [dr, dc, dr * x - dc * y, dr * y + dc * x]);
        }
    }
}

/// The value of an image between its pixels, and its slopes. None: outside.
fn bilinear(image: &Array2<f32>, [row, col]: [f64; 2]) -> Option<(f64, [f64; 2])> {
    let (rows, cols) = image.dim();
    if row < 0.0 || col < 0.0 || row >= rows as f64 - 1.0 || col >= cols as f64 - 1.0 {
        return None;
    }
    let (r, c) = (row as usize, col as usize);
    let (u, v) = (row - r as f64, col - c as f64);
    let at = |i: usize, j: usize| f64::from(image[[r + i, c + j]]);
    let (top, bottom) = (at(0, 0) * (1.0 - v) + at(0, 1) * v, at(1, 0) * (1.0 - v) + at(1, 1) * v);
    let along = (at(0, 1) - at(0, 0)) * (1.0 - u) + (at(1, 1) - at(1, 0)) * u;
    Some((top * (1.0 - u) + bottom * u, [bottom - top, along]))
}

/// The next step of all parts.
fn step(pairs: &[Pair], parts: Registered) -> Registered {
    let (mut normal, mut right) = (Array2::<f64>::zeros((PARTS, PARTS)), Array1::<f64>::zeros(PARTS));
    for pair in pairs {
        // Sums of products of 1, truth, specimen and derivatives. The first two are taken out of the others.
        let mut sums = Array2::<f64>::zeros((PARTS + 3, PARTS + 3));
        samples(pair, parts, |truth, value, slopes| {
            let row = [&[1.0, truth, value][..], &slopes].concat();
            for (i, a) in row.iter().enumerate() {
                row.iter().enumerate().for_each(|(j, b)| sums[[i, j]] += a * b);
            }
        });
        for taken in 0..2 {
            let pivot = sums[[taken, taken]];
            if pivot <= 0.0 {
                continue;
            }
            let own = sums.row(taken).to_owned();
            for i in taken + 1..PARTS + 3 {
                let share = own[i] / pivot;
                sums.row_mut(i).scaled_add(-share, &own);
            }
        }
        let light = sums[[2, 2]];
        if light > 0.0 {
            normal.scaled_add(1.0 / light, &sums.slice(ndarray::s![3.., 3..]));
            right.scaled_add(-1.0 / light, &sums.slice(ndarray::s![3.., 2]));
        }
    }
    let step = pseudo_inverse(&normal).dot(&right);
    std::array::from_fn(|i| step[i])
}

/// `1 - r^2` of each frame; 1 of dark ones.
fn left(pairs: &[Pair], parts: Registered) -> Vec<f64> {
    let of = |pair: &Pair| {
        let mut sums = [0.0f64; 6];
        samples(pair, parts, |t, o, _| {
            sums.iter_mut().zip([1.0, t, o, t * t, t * o, o * o]).for_each(|(s, v)| *s += v);
        });
        let [n, t, o, tt, to, oo] = sums;
        let [tt, to, oo] = [tt - t * t / n, to - t * o / n, oo - o * o / n];
        if n > 0.0 && tt > 0.0 && oo > 0.0 { 1.0 - to * to / (tt * oo) } else { 1.0 }
    };
    pairs.iter().map(of).collect()
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;

    /// Blobs of light on 64 x 72 pixels, each of its own brightness, displaced as `parts` say, on a level of light.
    fn picture(k: usize, parts: Registered, level: f32) -> Array2<f32> {
        let (centre, corner) = ([31.5, 35.5], 31.5f64.hypot(35.5));
        let at = |i: usize| {
            let [y, x] = [(i * 29 + k * 17) % 56, (i * 37 + k * 11) % 62].map(|v| v as f64 + 4.0);
            let [u, v] = [(y - centre[0]) / corner, (x - centre[1]) / corner];
            [y + parts[0] + parts[2] * v + parts[3] * u, x + parts[1] - parts[2] * u + parts[3] * v]
        };
        let light = |r: usize, c: usize, i: usize| {
            let [y, x] = at(i);
            (1.0 + i as f64 % 3.0) * (-((r as f64 - y).powi(2) + (c as f64 - x).powi(2)) / 4.0).exp()
        };
        Array2::from_shape_fn((64, 72), |(r, c)| level + (0..12).map(|i| light(r, c, i)).sum::<f64>() as f32)
    }

    #[test]
    fn truths_are_placed_beside_specimens_of_another_light() {
        for parts in [[0.0; 4], [0.3, -0.2, 0.4, -1.3], [5.0, -3.0, -1.5, 1.0]] {
            let truths: Vec<Array2<f32>> = (0..3).map(|k| picture(k, [0.0; 4], 0.0)).collect();
            let specimens: Vec<Array2<f32>> = (0..3).map(|k| picture(k, parts, 0.2) * (3.0 + k as f32)).collect();
            let pairs: Vec<[&Array2<f32>; 2]> = truths.iter().zip(&specimens).map(|(t, o)| [t, o]).collect();
            let found = placement(&pairs).unwrap();
            let off = found.parts.iter().zip(parts).map(|(f, p)| (f - p).abs()).fold(0.0, f64::max);
            assert!(off < 0.03, "{:?} for {parts:?}", found.parts);
            if parts != [0.0; 4] {
                assert!(found.share < 0.05 && found.left < found.apart, "{found:?}");
            }
        }
        assert_eq!(placement(&[]), None);
        let dark = Array2::zeros((64, 72));
        assert!(placement(&[[&dark, &dark]]).is_none_or(|p| p.share >= 1.0));
    }
}
