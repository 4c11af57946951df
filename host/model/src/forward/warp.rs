//! Displaces the parts of an image by different fractions of a pixel, for effects that act on chief rays.
//!
//! `out(q) = J(q) in(q - d(q))` with J = det(I - grad d), where d(q) is the displacement of what ends on q: a source
//! keeps its light where the displacement varies. A displacement that varies little over a PSF moves sources as their
//! chief rays move.
//!
//! It is done along one axis after the other (Catmull and Smith, SIGGRAPH, 279, 1980): `between(y, c) = in(y, c - dx)`,
//! `out(r, c) = J between(r - dy, c)`. The first needs dx at the row r whose light comes from row y: r - dy(r, c) = y.

use super::shift_map::{SPACING_PX, TAPS, weights};
use ndarray::Array2;
use ommatidia_physics::interpolation::{BESIDE, Lines, shifted};
use pulp::{Arch, Simd, WithSimd};

/// The image with its content displaced by `shift[(r, c)]` = [row, col] pixels; zero outside.
pub(super) fn warp(image: &Array2<f32>, shift: &Array2<[f64; 2]>) -> Array2<f32> {
    let same = shift.first().filter(|first| shift.iter().all(|d| d == *first));
    if let Some(d) = same {
        return shifted(image, *d);
    }
    let (image, shift) = (image.as_standard_layout(), shift.as_standard_layout());
    match (image.as_slice(), shift.as_slice()) {
        (Some(pixels), Some(shift)) => {
            let out = Arch::new().dispatch(Warp { pixels, shift, shape: image.dim() });
            Array2::from_shape_vec(image.dim(), out).unwrap_or_else(|_| image.to_owned())
        }
        _ => image.to_owned(),
    }
}

/// The work, in code for this processor's vectors.
struct Warp<'a> {
    pixels: &'a [f32],
    shift: &'a [[f64; 2]],
    shape: (usize, usize),
}

impl WithSimd for Warp<'_> {
    type Output = Vec<f32>;

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) -> Vec<f32> {
        let (rows, cols) = self.shape;
        let (lines, weights) = (Lines::get(), weights());
        let [wide, high] = [cols, rows].map(|n| n + 2 * BESIDE);
        let mut image = vec![0.0f32; rows * wide];
        image.chunks_mut(wide).zip(self.pixels.chunks(cols)).for_each(|(to, from)| {
            to[BESIDE..][..cols].copy_from_slice(from);
        });
        // A column after the other, so that the second pass reads each as a line.
        let mut between = vec![0.0f32; cols * high];
        let [mut dy, mut dx] = [(); 2].map(|()| vec![0.0f64; rows]);
        let mut nodes = vec![0.0f64; rows.saturating_sub(1) / SPACING_PX + TAPS];
        for c in 0..cols {
            for (d, (dy, dx)) in self.shift[c..].iter().step_by(cols).zip(dy.iter_mut().zip(&mut dx)) {
                [*dy, *dx] = *d;
            }
            // It is as smooth as the displacement, which was interpolated in the same way.
            for (i, node) in nodes.iter_mut().enumerate() {
                *node = at(&dx, target(&dy, (i as f64 - 1.0) * SPACING_PX as f64));
            }
            let to = &mut between[c * high + BESIDE..][..rows];
            for (y, (to, line)) in to.iter_mut().zip(image.chunks(wide)).enumerate() {
                let near = &nodes[y / SPACING_PX..][..TAPS];
                let d: f64 = weights[y % SPACING_PX].iter().zip(near).map(|(w, v)| w * v).sum();
                *to = lines.value(line, c as f64 - d);
            }
        }
        let mut out = vec![0.0f32; rows * cols];
        for (r, to) in out.chunks_mut(cols).enumerate() {
            let row = |r: usize| &self.shift[r.min(rows - 1) * cols..][..cols];
            let (above, here, below) = (row(r.saturating_sub(1)), row(r), row(r + 1));
            for c in 0..cols {
                // Half the difference between neighbours on either side; at an edge, half of that to the one neighbour.
                let (left, right) = (here[c.saturating_sub(1)], here[(c + 1).min(cols - 1)]);
                let by_row = [0, 1].map(|a| 0.5 * (below[c][a] - above[c][a]));
                let by_col = [0, 1].map(|a| 0.5 * (right[a] - left[a]));
                let spread = (1.0 - by_row[0]) * (1.0 - by_col[1]) - by_row[1] * by_col[0];
                to[c] = spread as f32 * lines.value(&between[c * high..][..high], r as f64 - here[c][0]);
            }
        }
        out
    }
}

/// Where a displacement is continued beyond the image, px: the reach of the interpolation.
const BEYOND_PX: f64 = 8.0;
/// Light from two rows would lie on each other at zero.
const LEAST_SLOPE: f64 = 0.1;

/// Value, slope and curvature of a smooth function at the row nearest to `x` that has neighbours, by its values at
/// whole rows, and the way from there to `x`.
#[inline(always)]
fn near(values: &[f64], x: f64) -> ([f64; 3], f64) {
    let Some(last) = values.len().checked_sub(2).filter(|last| *last > 0) else {
        return ([values.first().copied().unwrap_or(0.0), 0.0, 0.0], 0.0);
    };
    let row = ((x + 0.5) as usize).clamp(1, last);
    let [before, here, after] = [row - 1, row, row + 1].map(|i| values[i]);
    ([here, 0.5 * (after - before), after - 2.0 * here + before], (x - row as f64).clamp(-BEYOND_PX, BEYOND_PX))
}

/// The value at `x`, right to the third order.
#[inline(always)]
fn at(values: &[f64], x: f64) -> f64 {
    let ([value, slope, curvature], way) = near(values, x);
    value + way * (slope + 0.5 * way * curvature)
}

/// The row x whose light comes from row `y` under displacements `d` of whole rows: x - d(x) = y, by one step from the
/// row that the displacement of `y` leads to, with the slope there (Newton).
#[inline(always)]
fn target(d: &[f64], y: f64) -> f64 {
    let x = y + at(d, y);
    let ([value, slope, curvature], way) = near(d, x);
    let here = value + way * (slope + 0.5 * way * curvature);
    x - (x - here - y) / (1.0 - slope - way * curvature).max(LEAST_SLOPE)
}

#[cfg(test)]
mod tests {
    use super::*;
    use ommatidia_physics::interpolation::weights;

    /// The fit of a shift depends on this. The light that is aliased costs more: see
    /// [`ommatidia_physics::interpolation`].
    #[test]
    fn centroids_move_by_what_is_asked() {
        let centroid = |image: &Array2<f32>| {
            let sum: f64 = image.iter().map(|v| f64::from(*v)).sum();
            image.indexed_iter().map(|((r, _), v)| r as f64 * f64::from(*v)).sum::<f64>() / sum
        };
        for d in [0.01, 0.05, 0.25, 0.4, 0.5, 0.75, 1.3] {
            let image = gauss([15.2, 16.0]);
            let moved = warp(&image, &Array2::from_elem((31, 33), [d, 0.0]));
            let error = centroid(&moved) - centroid(&image) - d;
            assert!(error.abs() < 1e-3 * d, "{d}: {error}");
        }
    }

    fn gauss(centre: [f64; 2]) -> Array2<f32> {
        Array2::from_shape_fn((31, 33), |(r, c)| {
            let (y, x) = (r as f64 - centre[0], c as f64 - centre[1]);
            (-(y * y + x * x) / 4.5).exp() as f32
        })
    }

    #[test]
    fn a_shift_is_the_warp_by_the_same_displacement() {
        let image = Array2::from_shape_fn((23, 31), |(r, c)| ((r * 7 + c * 3) % 11) as f32);
        for d in [[0.3, -0.45], [-1.7, 0.2], [12.5, -30.9], [40.0, 0.5], [0.0, 2.0]] {
            let mut field = Array2::from_elem((23, 31), d);
            let fast = warp(&image, &field);
            // One displaced pixel in a corner is enough to take the other way.
            field[[22, 30]] = [d[0] + 1e-12, d[1]];
            let slow = warp(&image, &field);
            let inside = fast.iter().zip(&slow).take(22 * 31);
            assert!(inside.clone().all(|(a, b)| (a - b).abs() < 1e-4), "{d:?}");
        }
    }

    /// The sum over both axes at once, as the formula says it.
    fn directly(image: &Array2<f32>, shift: &Array2<[f64; 2]>) -> Array2<f32> {
        let (rows, cols) = image.dim();
        Array2::from_shape_fn((rows, cols), |(r, c)| {
            let at = |r: usize, c: usize, a: usize| shift[[r.min(rows - 1), c.min(cols - 1)]][a];
            let by_row = [0, 1].map(|a| 0.5 * (at(r + 1, c, a) - at(r.saturating_sub(1), c, a)));
            let by_col = [0, 1].map(|a| 0.5 * (at(r, c + 1, a) - at(r, c.saturating_sub(1), a)));
            let ((y0, wy), (x0, wx)) = (weights(r as f64 - at(r, c, 0)), weights(c as f64 - at(r, c, 1)));
            let pixel = |y: isize, x: isize| image.get((usize::try_from(y).ok()?, usize::try_from(x).ok()?)).copied();
            let of_row = |y: isize| (x0..).zip(wx).map(|(x, w)| w * f64::from(pixel(y, x).unwrap_or(0.0))).sum::<f64>();
            let sum: f64 = (y0..).zip(wy).map(|(y, w)| w * of_row(y)).sum();
            (sum * ((1.0 - by_row[0]) * (1.0 - by_col[1]) - by_row[1] * by_col[0])) as f32
        })
    }

    /// A turn, a stretch, and a distortion of 3 px at the corner, of points with the width of a focus.
    #[test]
    fn one_axis_after_the_other_is_the_sum_over_both() {
        let shape = (61, 70);
        let centres = [[12.3, 9.8], [30.0, 35.5], [47.7, 60.1], [8.0, 55.2], [2.2, 33.0]];
        let image = Array2::from_shape_fn(shape, |(r, c)| {
            let of = |[y, x]: &[f64; 2]| (-((r as f64 - y).powi(2) + (c as f64 - x).powi(2)) / 3.0).exp();
            centres.iter().map(of).sum::<f64>() as f32
        });
        let laws: [fn(f64, f64) -> [f64; 2]; 4] = [
            |y, x| [0.03 * x, -0.03 * y],
            |y, x| [0.05 * y + 0.4, 0.05 * x],
            |y, x| [3.4e-5 * y * (y * y + x * x), 3.4e-5 * x * (y * y + x * x)],
            |y, x| [1.5 + 0.02 * x, 0.3 - 1e-3 * y * x],
        ];
        for (i, law) in laws.into_iter().enumerate() {
            let shift = Array2::from_shape_fn(shape, |(r, c)| law(r as f64 - 30.0, c as f64 - 34.5));
            let (fast, slow) = (warp(&image, &shift), directly(&image, &shift));
            let worst = fast.iter().zip(&slow).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
            assert!(worst < 5e-4, "law {i}: {worst}");
        }
        for far in [f64::NAN, f64::INFINITY, 1e300] {
            let mut shift = Array2::from_elem(shape, [0.0; 2]);
            shift[[30, 30]] = [far, -far];
            warp(&image, &shift);
        }
    }

    #[test]
    fn a_shift_moves_and_a_stretch_keeps_the_light() {
        for d in [[0.3, -0.45], [0.004, 0.0], [2.6, 1.2]] {
            let moved = warp(&gauss([15.0, 16.0]), &Array2::from_elem((31, 33), d));
            let want = gauss([15.0 + d[0], 16.0 + d[1]]);
            assert!(moved.iter().zip(&want).all(|(a, b)| (a - b).abs() < 2e-3), "{d:?}");
        }
        let stretch = Array2::from_shape_fn((31, 33), |(r, c)| [0.05 * (r as f64 - 15.0), 0.05 * (c as f64 - 16.0)]);
        let image = gauss([15.0, 16.0]);
        let wide = warp(&image, &stretch);
        assert!((wide.sum() / image.sum() - 1.0).abs() < 0.01);
        assert_eq!(warp(&image, &Array2::from_elem((31, 33), [0.0, 0.0])), image);
    }
}
