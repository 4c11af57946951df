//! Displaces the parts of an image by different fractions of a pixel, for effects that act on chief rays.
//!
//! `out(q) = J(q) in(q - d(q))` with J = det(I - grad d), where d(q) is the displacement of what ends on q: a source
//! keeps its light where the displacement varies. A displacement that varies little over a PSF moves sources as their
//! chief rays move.

use ndarray::Array2;
use ommatidia_physics::interpolation::{TAPS, shifted, tabulated};

/// The image with its content displaced by `shift[(r, c)]` = [row, col] pixels; zero outside. A pixel without
/// displacement is copied.
pub(super) fn warp(image: &Array2<f32>, shift: &Array2<[f64; 2]>) -> Array2<f32> {
    let (rows, cols) = image.dim();
    let Some(pixels) = image.as_slice() else { return image.clone() };
    let same = shift.first().filter(|first| shift.iter().all(|d| d == *first));
    if let Some(d) = same {
        return shifted(image, *d);
    }
    Array2::from_shape_fn((rows, cols), |(r, c)| {
        let d = shift[[r, c]];
        let near = |r: usize, c: usize| shift[[r.min(rows - 1), c.min(cols - 1)]];
        // Half the difference between neighbours on either side; at an edge, half of that to the one neighbour.
        let (by_row, by_col) =
            ([near(r + 1, c), near(r.saturating_sub(1), c)], [near(r, c + 1), near(r, c.saturating_sub(1))]);
        let slope = |[high, low]: [[f64; 2]; 2], a: usize| 0.5 * (high[a] - low[a]);
        let spread = (1.0 - slope(by_row, 0)) * (1.0 - slope(by_col, 1)) - slope(by_row, 1) * slope(by_col, 0);
        if d == [0.0, 0.0] && spread == 1.0 {
            return image[[r, c]];
        }
        let ((y0, wy), (x0, wx)) = (tabulated(r as f64 - d[0]), tabulated(c as f64 - d[1]));
        // Sums along the columns first: the taps along a row are independent of each other, and fill vectors.
        let mut sums = [0.0f32; TAPS];
        for (y, wy) in (y0..).zip(wy).filter(|(y, _)| (0..rows as isize).contains(y)) {
            let row = &pixels[y as usize * cols..(y as usize + 1) * cols];
            let whole = usize::try_from(x0).ok().and_then(|x0| row.get(x0..)?.first_chunk::<{ TAPS }>());
            match whole {
                Some(part) => sums.iter_mut().zip(part).for_each(|(s, v)| *s += wy * v),
                None => {
                    let inside = (x0..).zip(&mut sums).filter(|(x, _)| (0..cols as isize).contains(x));
                    inside.for_each(|(x, s)| *s += wy * row[x as usize]);
                }
            }
        }
        let sum: f32 = sums.iter().zip(&wx).map(|(s, w)| s * w).sum();
        sum * spread as f32
    })
}

#[cfg(test)]
mod tests {
    use super::*;

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
