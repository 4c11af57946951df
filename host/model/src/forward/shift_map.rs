//! The displacement of chief rays over the image of a lens: followed at every few pixels, interpolated between them.
//!
//! Laws of effects are polynomials of at most the third degree in the place of a ray, and the interpolation is the
//! cubic one of Lagrange, which is exact for these. Where rays are followed backwards, from where they end, an error of
//! the fourth order is left: 1e-5 px for a distortion of 5 px at the corner.

use ndarray::{Array2, Axis};
use ommatidia_physics::effects::RayShift;
use std::borrow::Cow;

/// Distance between the rays that are followed, px.
pub(super) const SPACING_PX: usize = 4;
/// Followed rays that an interpolated one depends on, along each axis.
pub(super) const TAPS: usize = 4;

/// Displacement (row, col, along the axis) and growth, the parts of a [`RayShift`].
type Parts = [f64; 4];

/// The shifts of the rays that end on the pixels of an image.
pub(super) enum Shifts {
    /// All are the same.
    Even(RayShift),
    /// One for each pixel.
    Map(Array2<RayShift>),
}

impl Shifts {
    /// With a displacement more, px.
    pub(super) fn displaced(self, [dy, dx]: [f64; 2]) -> Self {
        let more = |s: RayShift| RayShift { px: [s.px[0] + dy, s.px[1] + dx], ..s };
        match self {
            Self::Even(shift) => Self::Even(more(shift)),
            Self::Map(mut map) => {
                if [dy, dx] != [0.0, 0.0] {
                    map.mapv_inplace(more);
                }
                Self::Map(map)
            }
        }
    }

    /// Whether any of them is so.
    pub(super) fn any(&self, is: impl Fn(&RayShift) -> bool) -> bool {
        match self {
            Self::Even(shift) => is(shift),
            Self::Map(map) => map.iter().any(is),
        }
    }

    /// [`Self::over`] an image of `shape`, to be changed.
    pub(super) fn into_map(self, shape: (usize, usize)) -> Array2<RayShift> {
        match self {
            Self::Even(shift) => Array2::from_elem(shape, shift),
            Self::Map(map) => map,
        }
    }

    /// One for each pixel of an image of `shape`.
    pub(super) fn over(&self, shape: (usize, usize)) -> Cow<'_, Array2<RayShift>> {
        match self {
            Self::Even(shift) => Cow::Owned(Array2::from_elem(shape, *shift)),
            Self::Map(map) => Cow::Borrowed(map),
        }
    }
}

/// The shifts of the rays that end on the pixels of an image of `shape`, by those of the rays that end on the places
/// [row, col] that `at` is called with, px from the first pixel; these reach a little beyond the image.
pub(super) fn shift_map(shape: (usize, usize), at: impl Fn([f64; 2]) -> RayShift) -> Shifts {
    let (rows, cols) = shape;
    // One before the first pixel and two after the last one that starts an interval.
    let count = |n: usize| n.saturating_sub(1) / SPACING_PX + TAPS;
    let place = |node: usize| (node as f64 - 1.0) * SPACING_PX as f64;
    let followed = Array2::from_shape_fn((count(rows), count(cols)), |(i, j)| parts(at([place(i), place(j)])));
    // Differences from one of them: a shift that is the same everywhere stays the same in each bit.
    let first = followed[[0, 0]];
    if followed.iter().all(|v| *v == first) {
        return Shifts::Even(shift(first));
    }
    let differences = followed.mapv(|v| zip(v, first, |v, f| v - f));
    let weights = weights();
    let along_cols = interpolated(&differences, Axis(1), cols, &weights);
    Shifts::Map(interpolated(&along_cols, Axis(0), rows, &weights).mapv(|v| shift(zip(v, first, |v, f| v + f))))
}

/// The values at the first `n` pixels of an axis, by those at its nodes.
fn interpolated(nodes: &Array2<Parts>, axis: Axis, n: usize, weights: &[[f64; TAPS]; SPACING_PX]) -> Array2<Parts> {
    let mut shape = nodes.raw_dim();
    shape[axis.index()] = n;
    let mut out = Array2::from_elem(shape, [0.0; 4]);
    for (i, mut line) in out.axis_iter_mut(axis).enumerate() {
        for (tap, weight) in weights[i % SPACING_PX].iter().enumerate() {
            let node = nodes.index_axis(axis, i / SPACING_PX + tap);
            line.zip_mut_with(&node, |sum, v| *sum = zip(*sum, *v, |sum, v| sum + weight * v));
        }
    }
    out
}

/// For each pixel of an interval between two nodes, the weights of the node before it and the three that follow.
pub(super) fn weights() -> [[f64; TAPS]; SPACING_PX] {
    std::array::from_fn(|i| lagrange(i as f64 / SPACING_PX as f64))
}

/// Weights of the values at -1, 0, 1 and 2 for that at `x`.
fn lagrange(x: f64) -> [f64; TAPS] {
    let (a, b, c, d) = (x + 1.0, x, x - 1.0, x - 2.0);
    [-b * c * d / 6.0, a * c * d / 2.0, -a * b * d / 2.0, a * b * c / 6.0]
}

fn parts(s: RayShift) -> Parts {
    [s.px[0], s.px[1], s.z_um, s.growth]
}

fn shift([row, col, z_um, growth]: Parts) -> RayShift {
    RayShift { px: [row, col], z_um, growth }
}

fn zip(a: Parts, b: Parts, f: impl Fn(f64, f64) -> f64) -> Parts {
    std::array::from_fn(|k| f(a[k], b[k]))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn cubic_laws_are_exact_and_even_shifts_keep_their_bits() {
        let cubic = |[y, x]: [f64; 2]| RayShift {
            px: [1e-5 * y * (y * y + x * x) - 0.3, 0.02 * x - 1e-4 * y * x * x],
            z_um: 0.1 * y - 3e-6 * x * x * x,
            growth: 1e-3 * x,
        };
        for shape in [(1, 1), (8, 9), (17, 40), (110, 107)] {
            let shifts = shift_map(shape, cubic);
            let map = shifts.over(shape);
            assert_eq!(map.dim(), shape);
            for ((r, c), found) in map.indexed_iter() {
                let want = parts(cubic([r as f64, c as f64]));
                let error = zip(parts(*found), want, |f, w| (f - w).abs());
                assert!(error.iter().all(|e| *e < 1e-12), "{shape:?} [{r}, {c}]: {error:?}");
            }
        }
        let even = RayShift { px: [0.1, -0.7], z_um: 1.0 / 3.0, growth: 0.0 };
        assert!(matches!(shift_map((31, 20), |_| even), Shifts::Even(s) if s == even));
    }

    /// A strong distortion followed backwards, as the forward model does it: q = x + d(x), solved for x.
    #[test]
    fn inverse_laws_are_right_to_a_hundred_thousandth_of_a_pixel() {
        let law = |[y, x]: [f64; 2]| {
            let (y, x) = (y - 55.0, x - 55.0);
            // 5 px in the corner.
            let k = 5.0 / (2.0f64.sqrt() * 55.0 * 2.0 * 55.0 * 55.0);
            [k * y * (y * y + x * x), k * x * (y * y + x * x)]
        };
        let inverse = |at: [f64; 2]| {
            let mut px = law(at);
            for _ in 0..2 {
                px = law([at[0] - px[0], at[1] - px[1]]);
            }
            RayShift::by_px(px)
        };
        let shifts = shift_map((110, 110), inverse);
        let map = shifts.over((110, 110));
        let error = |((r, c), s): ((usize, usize), &RayShift)| {
            let want = inverse([r as f64, c as f64]).px;
            (s.px[0] - want[0]).hypot(s.px[1] - want[1])
        };
        let worst = map.indexed_iter().map(error).fold(0.0, f64::max);
        assert!(worst < 1e-5, "{worst}");
    }
}
