//! Inverse of Gram matrices whose columns may be linearly dependent.

use ndarray::Array2;
use ommatidia_physics::linalg::{SymmetricEigen, symmetric_eigen};

/// Pseudo-inverse of a symmetric positive semi-definite matrix, [n, n]. The matrix is first scaled to a unit diagonal;
/// eigenvectors with eigenvalues below 3e-6 of that form are left out, since their values are rounding errors of f32
/// sums.
pub fn pseudo_inverse(a: &Array2<f64>) -> Array2<f64> {
    let scale = a.diag().mapv(|v| if v > 0.0 { 1.0 / v.sqrt() } else { 0.0 });
    let n = a.nrows();
    if n == 0 {
        return a.clone();
    }
    let scaled = Array2::from_shape_fn((n, n), |(i, j)| 0.5 * (a[[i, j]] + a[[j, i]]) * scale[i] * scale[j]);
    let Ok(SymmetricEigen { values, vectors }) = symmetric_eigen(&scaled) else { return Array2::zeros((n, n)) };
    let floor = 3e-6;
    let inverse = values.mapv(|v| if v > floor { 1.0 / v } else { 0.0 });
    let full = (&vectors * &inverse).dot(&vectors.t());
    Array2::from_shape_fn((n, n), |(i, j)| full[[i, j]] * scale[i] * scale[j])
}
