//! PSFs that grow or shrink about their foci: derivatives of the basis PSFs with respect to their size.
//!
//! Let `h_w(x) = h(x / (1 + w)) / (1 + w)^2`, with x from the centre of the window. Three sizes, `w = -s, 0, s`, fix
//! the parabola
//! ```text
//! h_w = h + w G + w^2 / 2 H,   G = (h_s - h_(-s)) / (2 s),   H = (h_s + h_(-s) - 2 h) / s^2
//! ```
//! which is exact at the three, and keeps the light of h. Coefficients over the field stay as they are, since every PSF
//! is a sum of basis PSFs.

use ndarray::{Array2, Array4, ArrayView2};
use ommatidia_physics::interpolation::weights;

/// The size s of the two outer nodes: half of the largest change that is expected of a wavelength.
const NODE: f64 = 0.05;

/// The kernels G and H of basis PSFs `[lens, term, row, col]`, in the same windows.
pub fn growth_kernels(basis: &Array4<f32>) -> [Array4<f32>; 2] {
    let n = basis.dim().2;
    let sizes = [scaling(n, 1.0 - NODE), scaling(n, 1.0 + NODE)];
    let mut out = [Array4::zeros(basis.dim()), Array4::zeros(basis.dim())];
    let [first, second] = &mut out;
    for (lens, (mut first, mut second)) in basis.outer_iter().zip(first.outer_iter_mut().zip(second.outer_iter_mut())) {
        for (k, window) in lens.outer_iter().enumerate() {
            let [small, large] = [0, 1].map(|i| resized(window, &sizes[i]));
            let (g, h) =
                ((&large - &small) / (2.0 * NODE) as f32, (&large + &small - &window * 2.0) / NODE.powi(2) as f32);
            first.index_axis_mut(ndarray::Axis(0), k).assign(&g);
            second.index_axis_mut(ndarray::Axis(0), k).assign(&h);
        }
    }
    out
}

/// A window that `scaling` matrices make larger or smaller about its centre; its sum is kept.
fn resized(window: ArrayView2<'_, f32>, scaling: &Array2<f32>) -> Array2<f32> {
    let mut out = scaling.dot(&window).dot(&scaling.t());
    // Light that grows beyond the window would be lost, and a PSF on pixels is not sampled evenly.
    let (before, after) = (window.sum(), out.sum());
    if after != 0.0 && (before / after - 1.0).abs() < 0.5 {
        out *= before / after;
    }
    out
}

/// Interpolation matrix [n, n] along one axis: sample x of the result is sample `x / size` of the window, over `size`.
fn scaling(n: usize, size: f64) -> Array2<f32> {
    let centre = (n as f64 - 1.0) / 2.0;
    let mut matrix = Array2::zeros((n, n));
    for (i, mut row) in matrix.outer_iter_mut().enumerate() {
        let (first, weights) = weights((i as f64 - centre) / size + centre);
        for (j, w) in (first..).zip(weights) {
            if let Some(v) = usize::try_from(j).ok().and_then(|j| row.get_mut(j)) {
                *v = (w / size) as f32;
            }
        }
    }
    matrix
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A Gaussian has its exact counterpart at every size.
    #[test]
    fn a_grown_gaussian_is_a_wider_gaussian() {
        let gaussian = |sigma: f32| {
            Array4::from_shape_fn((1, 1, 31, 31), |(_, _, r, c)| {
                let square = (r as f32 - 15.0).powi(2) + (c as f32 - 14.6).powi(2);
                (-square / (2.0 * sigma * sigma)).exp() / (sigma * sigma)
            })
        };
        let norm = |a: &Array4<f32>| a.iter().map(|v| v * v).sum::<f32>().sqrt();
        let before = gaussian(1.6);
        let [first, second] = growth_kernels(&before);
        for w in [-0.08f32, -0.05, 0.01, 0.03, 0.1] {
            // The centre of the light is 0.4 px from that of the window, and moves by that much times w.
            let grown = &before + &(w * &first) + &(0.5 * w * w * &second);
            let after = Array4::from_shape_fn((1, 1, 31, 31), |(_, _, r, c)| {
                let sigma = 1.6 * (1.0 + w);
                let square = (r as f32 - 15.0).powi(2) + (c as f32 - (15.0 - 0.4 * (1.0 + w))).powi(2);
                (-square / (2.0 * sigma * sigma)).exp() / (sigma * sigma)
            });
            let (off, change) = (norm(&(&grown - &after)), norm(&(&before - &after)));
            assert!(off < 0.03 * change, "{w}: {off} of {change}");
            assert!((grown.sum() / before.sum() - 1.0).abs() < 1e-4, "{w}");
        }
    }
}
