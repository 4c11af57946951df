//! The few dense decompositions that calibration needs, in f64, over faer.

use faer::{Mat, Side};
use ndarray::{Array1, Array2};
use thiserror::Error;

/// A decomposition did not converge: the matrix holds values that are no numbers.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Error)]
#[error("the eigenvalues of a {0} x {0} matrix did not converge: it holds values that are no numbers or out of range")]
pub struct NotConverged(pub usize);

/// Eigenvalues (ascending) and eigenvectors (columns) of a symmetric matrix, of which the lower half is read.
///
/// # Errors
/// The iteration did not converge.
pub fn symmetric_eigen(a: &Array2<f64>) -> Result<(Array1<f64>, Array2<f64>), NotConverged> {
    let n = a.nrows();
    let mat = Mat::from_fn(n, n, |i, j| a[[i, j]]);
    let eigen = mat.self_adjoint_eigen(Side::Lower).map_err(|_| NotConverged(n))?;
    let (values, vectors) = (eigen.S().column_vector(), eigen.U());
    let values = Array1::from_shape_fn(n, |i| values[i]);
    if values.iter().any(|v| !v.is_finite()) {
        return Err(NotConverged(n));
    }
    Ok((values, Array2::from_shape_fn((n, n), |(i, j)| vectors[(i, j)])))
}

/// Least squares of least norm: x that minimises |a x - b|, column by column; directions of `a` below 1e-10 of the
/// largest are left alone.
///
/// # Errors
/// The iteration did not converge.
pub fn least_squares(a: &Array2<f64>, b: &Array2<f64>) -> Result<Array2<f64>, NotConverged> {
    let (values, v) = symmetric_eigen(&a.t().dot(a))?;
    let floor = values.iter().fold(0.0f64, |m, x| m.max(*x)) * 1e-20_f64.max(f64::EPSILON * a.nrows() as f64);
    let inverse = values.mapv(|x| if x > floor { 1.0 / x } else { 0.0 });
    let projected = v.t().dot(&a.t().dot(b));
    Ok(v.dot(&(&projected * &inverse.insert_axis(ndarray::Axis(1)))))
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;
    use ndarray::arr2;

    #[test]
    fn eigenpairs_of_a_known_matrix() {
        let a = arr2(&[[2.0, 1.0], [1.0, 2.0]]);
        let (values, vectors) = symmetric_eigen(&a).unwrap();
        assert!((values[0] - 1.0).abs() < 1e-12 && (values[1] - 3.0).abs() < 1e-12);
        let back = vectors.dot(&Array2::from_diag(&values)).dot(&vectors.t());
        assert!((back - a).iter().all(|d| d.abs() < 1e-12));
        assert!(symmetric_eigen(&arr2(&[[f64::NAN, 0.0], [0.0, 1.0]])).is_err());
    }

    #[test]
    fn a_line_through_points_and_a_redundant_column() {
        let a = arr2(&[[1.0, 0.0, 0.0], [1.0, 1.0, 1.0], [1.0, 2.0, 2.0]]);
        let x = least_squares(&a, &arr2(&[[1.0], [3.0], [5.0]])).unwrap();
        // The slope 2 is shared evenly by the two equal columns.
        assert!((x[[0, 0]] - 1.0).abs() < 1e-9 && (x[[1, 0]] - 1.0).abs() < 1e-9 && (x[[2, 0]] - 1.0).abs() < 1e-9);
    }
}
