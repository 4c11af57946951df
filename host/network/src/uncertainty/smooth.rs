//! Means and scatter in square windows, by sums over rectangles.

use ndarray::{Array2, ArrayView2};

/// Sums over all rectangles that begin at the first pixel, [rows + 1, cols + 1], f64.
fn sums(image: ArrayView2<'_, f32>, value: impl Fn(f64) -> f64) -> Array2<f64> {
    let (rows, cols) = image.dim();
    let mut sums = Array2::zeros((rows + 1, cols + 1));
    for r in 0..rows {
        let mut row = 0.0;
        for c in 0..cols {
            row += value(f64::from(image[[r, c]]));
            sums[[r + 1, c + 1]] = sums[[r, c + 1]] + row;
        }
    }
    sums
}

/// Mean of `sums` in the window of `half` pixels to each side of a pixel, clipped at the border of the image.
fn window(sums: &Array2<f64>, [r, c]: [usize; 2], half: usize) -> f64 {
    let (rows, cols) = (sums.nrows() - 1, sums.ncols() - 1);
    let ([r0, r1], [c0, c1]) =
        ([r.saturating_sub(half), (r + half + 1).min(rows)], [c.saturating_sub(half), (c + half + 1).min(cols)]);
    let sum = sums[[r1, c1]] - sums[[r0, c1]] - sums[[r1, c0]] + sums[[r0, c0]];
    sum / ((r1 - r0) * (c1 - c0)) as f64
}

/// Mean in a window of `2 half + 1` pixels a side around each pixel, [rows, cols]; at the border over the pixels that
/// exist.
pub(super) fn mean(image: ArrayView2<'_, f32>, half: usize) -> Array2<f32> {
    let sums = sums(image, |v| v);
    Array2::from_shape_fn(image.dim(), |(r, c)| window(&sums, [r, c], half) as f32)
}

/// Standard deviation in the same window, [rows, cols].
pub(super) fn scatter(image: ArrayView2<'_, f32>, half: usize) -> Array2<f32> {
    let (first, second) = (sums(image, |v| v), sums(image, |v| v * v));
    Array2::from_shape_fn(image.dim(), |(r, c)| {
        let mean = window(&first, [r, c], half);
        (window(&second, [r, c], half) - mean * mean).max(0.0).sqrt() as f32
    })
}

/// Mean length of the difference to the next pixel along both axes.
pub(super) fn roughness(image: ArrayView2<'_, f32>) -> f64 {
    let (rows, cols) = image.dim();
    let mut sum = 0.0;
    for r in 1..rows {
        for c in 1..cols {
            let (here, up, left) = (image[[r, c]], image[[r - 1, c]], image[[r, c - 1]]);
            sum += f64::from(here - up).hypot(f64::from(here - left));
        }
    }
    sum / ((rows - 1) * (cols - 1)).max(1) as f64
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn windows_are_means_and_scatter_of_the_pixels_that_exist() {
        let image = Array2::from_shape_fn((6, 7), |(r, c)| ((r * 7 + c * 3) % 5) as f32);
        let (means, scatters) = (mean(image.view(), 1), scatter(image.view(), 2));
        for (r, c) in [(0, 0), (3, 3), (5, 6)] {
            let around = |half: usize| -> Vec<f64> {
                let near = |(i, j): (usize, usize)| i.abs_diff(r) <= half && j.abs_diff(c) <= half;
                image.indexed_iter().filter(|(at, _)| near(*at)).map(|(_, v)| f64::from(*v)).collect()
            };
            let average = |all: &[f64]| all.iter().sum::<f64>() / all.len() as f64;
            assert!((f64::from(means[[r, c]]) - average(&around(1))).abs() < 1e-6);
            let m = average(&around(2));
            let variance = around(2).iter().map(|v| (v - m).powi(2)).sum::<f64>() / around(2).len() as f64;
            assert!((f64::from(scatters[[r, c]]) - variance.sqrt()).abs() < 1e-6);
        }
    }
}
