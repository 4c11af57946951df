//! Moves a small image by a fraction of a pixel: band-limited (sinc) interpolation of a window that is zero outside.
//!
//! `out(i) = sum_j in(j) sinc(i - j - d)` along each axis. For images without power beyond the Nyquist frequency this
//! is exact, keeps white noise white, and its transpose is its inverse.

use ndarray::{Array2, Array3, ArrayView2, ArrayView3, s};
use std::f64::consts::PI;

/// The image moved by `shift_px` (row, col; positive: towards larger indices), extended by `margin` pixels on each
/// side.
pub fn shifted(image: ArrayView2<'_, f32>, shift_px: [f64; 2], margin: usize) -> Array2<f32> {
    let (rows, cols) = image.dim();
    if shift_px == [0.0, 0.0] {
        let mut out = Array2::zeros((rows + 2 * margin, cols + 2 * margin));
        out.slice_mut(s![margin..margin + rows, margin..margin + cols]).assign(&image);
        return out;
    }
    sinc_matrix(rows, shift_px[0], margin).dot(&image).dot(&sinc_matrix(cols, shift_px[1], margin).t())
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
fn sinc_matrix(n: usize, shift: f64, margin: usize) -> Array2<f32> {
    Array2::from_shape_fn((n + 2 * margin, n), |(i, j)| sinc(i as f64 - margin as f64 - j as f64 - shift) as f32)
}

fn sinc(x: f64) -> f64 {
    if x == 0.0 { 1.0 } else { (PI * x).sin() / (PI * x) }
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
            assert!((moved[[*r, *c]] - **v).abs() < 3e-4, "{r} {c}");
        }
    }

    #[test]
    fn no_shift_is_a_copy() {
        let image = gauss(9, [4.0, 4.2]);
        assert_eq!(shifted(image.view(), [0.0, 0.0], 0), image);
        assert_eq!(shifted(image.view(), [0.0, 0.0], 1).slice(s![1..10, 1..10]), image);
    }
}
