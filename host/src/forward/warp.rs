//! Displaces the parts of an image by different fractions of a pixel, for effects that act on chief rays.
//!
//! `out(q) = J(q) in(q - d(q))` with J = 1 - div d: a source keeps its light where the displacement d varies. A
//! displacement that varies little over a PSF moves sources as their chief rays move. Interpolation is by the Lagrange
//! polynomial through 10 pixels along each axis, of all weights of that length the flattest at low frequencies:
//! centroids move by exactly d. A windowed sinc would move them by up to 3 % more or less, depending on the fraction of
//! a pixel.

use ndarray::Array2;
use std::sync::LazyLock;

/// Interpolation taps on each side.
const REACH: usize = 5;
/// Number of tabulated fractions of a pixel; weights between them are interpolated.
const STEPS: usize = 512;

/// Weights for a sample `i / STEPS` of a pixel past tap `REACH - 1`.
static WEIGHTS: LazyLock<Vec<[f32; 2 * REACH]>> = LazyLock::new(|| {
    (0..=STEPS)
        .map(|i| {
            let at = (REACH - 1) as f64 + i as f64 / STEPS as f64;
            std::array::from_fn(|t| {
                let others = (0..2 * REACH).filter(|u| *u != t);
                others.map(|u| (at - u as f64) / (t as f64 - u as f64)).product::<f64>() as f32
            })
        })
        .collect()
});

/// First tap and weights for position `x`.
fn taps(x: f64) -> (isize, [f32; 2 * REACH]) {
    let floor = x.floor();
    let fine = (x - floor) * STEPS as f64;
    let step = (fine as usize).min(STEPS - 1);
    let part = (fine - step as f64) as f32;
    let (a, b) = (&WEIGHTS[step], &WEIGHTS[step + 1]);
    (floor as isize - (REACH as isize - 1), std::array::from_fn(|t| a[t] + part * (b[t] - a[t])))
}

/// The image with its content displaced by `shift[(r, c)]` = [row, col] pixels; zero outside. A pixel without
/// displacement is copied.
pub(super) fn warp(image: &Array2<f32>, shift: &Array2<[f64; 2]>) -> Array2<f32> {
    let (rows, cols) = image.dim();
    let Some(pixels) = image.as_slice() else { return image.clone() };
    Array2::from_shape_fn((rows, cols), |(r, c)| {
        let d = shift[[r, c]];
        let near = |r: usize, c: usize| shift[[r.min(rows - 1), c.min(cols - 1)]];
        let spread = 1.0
            - 0.5 * (near(r + 1, c)[0] - near(r.saturating_sub(1), c)[0])
            - 0.5 * (near(r, c + 1)[1] - near(r, c.saturating_sub(1))[1]);
        if d == [0.0, 0.0] && spread == 1.0 {
            return image[[r, c]];
        }
        let ((y0, wy), (x0, wx)) = (taps(r as f64 - d[0]), taps(c as f64 - d[1]));
        let mut sum = 0.0;
        for (y, wy) in (y0..).zip(wy).filter(|(y, _)| (0..rows as isize).contains(y)) {
            let row = &pixels[y as usize * cols..(y as usize + 1) * cols];
            let along: f32 = if x0 >= 0 && x0 as usize + 2 * REACH <= cols {
                row[x0 as usize..x0 as usize + 2 * REACH].iter().zip(&wx).map(|(v, w)| v * w).sum()
            } else {
                let inside = (x0..).zip(&wx).filter(|(x, _)| (0..cols as isize).contains(x));
                inside.map(|(x, w)| row[x as usize] * w).sum()
            };
            sum += wy * along;
        }
        sum * spread as f32
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The fit of a shift depends on this: an error of a few per cent of a hundredth of a pixel is several standard
    /// errors.
    #[test]
    fn centroids_move_by_what_is_asked() {
        let centroid = |image: &Array2<f32>| {
            let sum: f64 = image.iter().map(|v| f64::from(*v)).sum();
            image.indexed_iter().map(|((r, _), v)| r as f64 * f64::from(*v)).sum::<f64>() / sum
        };
        for d in [0.01, 0.05, 0.25, 0.4, 0.5, 0.75, 1.3] {
            let image = gauss([15.2, 16.0]);
            let moved = warp(&image, &Array2::from_elem((31, 33), [d, 0.0]));
            assert!(
                (centroid(&moved) - centroid(&image) - d).abs() < 2e-5,
                "{d} {}",
                centroid(&moved) - centroid(&image)
            );
        }
    }

    fn gauss(centre: [f64; 2]) -> Array2<f32> {
        Array2::from_shape_fn((31, 33), |(r, c)| {
            let (y, x) = (r as f64 - centre[0], c as f64 - centre[1]);
            (-(y * y + x * x) / 4.5).exp() as f32
        })
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
