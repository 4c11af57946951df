//! Moves a small image by a fraction of a pixel: band-limited interpolation of a window that is zero outside
//! ([`ommatidia_physics::interpolation`]).
//!
//! A Gaussian of 1.2 px is moved with an error of at most 6e-4 of its peak, against 2e-4 by the sinc alone. But a sharp
//! PSF has power beyond the Nyquist frequency, which is aliased. Nothing mends that, and the sinc alone spreads the
//! error over the whole window. The window of the kernel keeps it where the light is. On one virtual instrument of each
//! kind it made the squared error of predicted bright scenes, in units of the noise, 3.8 times smaller for PSFs with
//! sharp edges, and 1.3 times for diffraction at pupils.

use ndarray::{Array2, Array3, ArrayView2, ArrayView3, s};
use ommatidia_physics::interpolation::weights;

/// The image moved by `shift_px` (row, col; positive: towards larger indices), extended by `margin` pixels on each
/// side.
pub fn shifted(image: ArrayView2<'_, f32>, shift_px: [f64; 2], margin: usize) -> Array2<f32> {
    let (rows, cols) = image.dim();
    if shift_px == [0.0, 0.0] {
        let mut out = Array2::zeros((rows + 2 * margin, cols + 2 * margin));
        out.slice_mut(s![margin..margin + rows, margin..margin + cols]).assign(&image);
        return out;
    }
    interpolation(rows, shift_px[0], margin).dot(&image).dot(&interpolation(cols, shift_px[1], margin).t())
}

/// Moves each of a stack of windows [k, rows, cols] by `shift_px`, extended by `margin` pixels on each side.
pub fn shifted_windows(windows: ArrayView3<'_, f32>, shift_px: [f64; 2], margin: usize) -> Array3<f32> {
    let (k, rows, cols) = windows.dim();
    let mut out = Array3::zeros((k, rows + 2 * margin, cols + 2 * margin));
    for (window, mut target) in windows.outer_iter().zip(out.outer_iter_mut()) {
        target.assign(&shifted(window, shift_px, margin));
    }
    out
}

/// Interpolation matrix [n + 2 margin, n] along one axis.
fn interpolation(n: usize, shift: f64, margin: usize) -> Array2<f32> {
    let mut matrix = Array2::zeros((n + 2 * margin, n));
    for (i, mut row) in matrix.outer_iter_mut().enumerate() {
        let (first, weights) = weights(i as f64 - margin as f64 - shift);
        for (j, w) in (first..).zip(weights) {
            if let Some(v) = usize::try_from(j).ok().and_then(|j| row.get_mut(j)) {
                *v = w as f32;
            }
        }
    }
    matrix
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;

    fn gauss(n: usize, centre: [f64; 2]) -> Array2<f32> {
        Array2::from_shape_fn((n, n), |(r, c)| {
            let (y, x) = (r as f64 - centre[0], c as f64 - centre[1]);
            (-(y * y / 4.5 + x * x / 3.0)).exp() as f32
        })
    }

    #[test]
    fn a_moved_gaussian_is_the_gaussian_at_the_moved_place() {
        let moved = shifted(gauss(21, [10.0, 9.5]).view(), [0.37, -0.81], 2);
        for ((r, c), v) in &gauss(25, [12.37, 10.69]).indexed_iter().collect::<Vec<_>>()[..] {
            assert!((moved[[*r, *c]] - **v).abs() < 6e-4, "{r} {c}");
        }
    }

    #[test]
    fn light_is_kept_and_an_edge_does_not_ring_over_the_whole_window() {
        let edge =
            Array2::from_shape_fn((41, 41), |(r, c)| f32::from(u8::from(r.abs_diff(20) < 3 && c.abs_diff(20) < 3)));
        for shift in [[0.5, 0.0], [0.37, -0.81], [-1.25, 0.99]] {
            let moved = shifted(edge.view(), shift, 0);
            assert!((moved.sum() - 25.0).abs() < 1e-4, "{shift:?}: {}", moved.sum());
            // The sinc alone leaves 0.01 at the edge of the window.
            assert!(moved.row(2).iter().chain(moved.column(38)).all(|v| v.abs() < 1e-6), "{shift:?}");
        }
    }

    #[test]
    fn no_shift_is_a_copy() {
        let image = gauss(9, [4.0, 4.2]);
        assert_eq!(shifted(image.view(), [0.0, 0.0], 0), image);
        assert_eq!(shifted(image.view(), [0.0, 0.0], 1).slice(s![1..10, 1..10]), image);
    }
}
