//! Dense linear algebra in f64: eigenpairs of symmetric matrices and least squares.
//!
//! ```
//! # fn main() -> Result<(), Box<dyn std::error::Error>> {
//! use ndarray::arr2;
//! use ommatidia_physics::linalg::{least_squares, symmetric_eigen};
//! // The line 1 + 2 t through (0, 1), (1, 3) and (2, 5).
//! let x = least_squares(&arr2(&[[1.0, 0.0], [1.0, 1.0], [1.0, 2.0]]), &arr2(&[[1.0], [3.0], [5.0]]))?;
//! assert!((x[[0, 0]] - 1.0).abs() < 1e-9 && (x[[1, 0]] - 2.0).abs() < 1e-9);
//!
//! let eigen = symmetric_eigen(&arr2(&[[2.0, 1.0], [1.0, 2.0]]))?;
//! assert!((eigen.values[0] - 1.0).abs() < 1e-12 && (eigen.values[1] - 3.0).abs() < 1e-12);
//! // The eigenvector of 3 is (1, 1) / sqrt(2), up to its sign.
//! assert!((eigen.vectors[[0, 1]] - eigen.vectors[[1, 1]]).abs() < 1e-12);
//! # Ok(())
//! # }
//! ```

use faer::dyn_stack::{MemBuffer, MemStack};
use faer::linalg::cholesky::llt::{factor, solve};
use faer::linalg::matmul::matmul;
use faer::{Accum, Mat, MatMut, MatRef, Par, Side, get_global_parallelism};
use ndarray::{Array1, Array2};
use thiserror::Error;

/// An eigenvalue iteration did not converge; the field is the number of rows of the matrix.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Error)]
#[error("the eigenvalues of a {0} x {0} matrix did not converge: it holds non-finite or extreme values")]
pub struct NotConverged(pub usize);

/// Eigenpairs of a symmetric matrix of n rows.
#[derive(Clone, Debug, PartialEq)]
pub struct SymmetricEigen {
    /// The n eigenvalues, ascending.
    pub values: Array1<f64>,
    /// The eigenvectors as columns, [n, n], orthonormal, in the order of the eigenvalues.
    pub vectors: Array2<f64>,
}

/// Eigenvalues and eigenvectors of the symmetric matrix `a`, [n, n]. Only its lower triangle is read.
///
/// # Errors
/// The iteration did not converge, e.g. because `a` holds non-finite values.
pub fn symmetric_eigen(a: &Array2<f64>) -> Result<SymmetricEigen, NotConverged> {
    let n = a.nrows();
    let mat = Mat::from_fn(n, n, |i, j| a[[i, j]]);
    let eigen = mat.self_adjoint_eigen(Side::Lower).map_err(|_| NotConverged(n))?;
    let (values, vectors) = (eigen.S().column_vector(), eigen.U());
    let values = Array1::from_shape_fn(n, |i| values[i]);
    if values.iter().any(|v| !v.is_finite()) {
        return Err(NotConverged(n));
    }
    Ok(SymmetricEigen { values, vectors: Array2::from_shape_fn((n, n), |(i, j)| vectors[(i, j)]) })
}

/// Least squares: the `x` [n, k] of least norm that minimises `|a x - b|` for each column of `b`; `a` is [m, n], `b` is
/// [m, k]. Directions whose singular value is negligible against the largest are set to zero. Solved by the normal
/// equations.
///
/// # Errors
/// The iteration did not converge, e.g. because `a` holds non-finite values.
pub fn least_squares(a: &Array2<f64>, b: &Array2<f64>) -> Result<Array2<f64>, NotConverged> {
    let SymmetricEigen { values, vectors: v } = symmetric_eigen(&a.t().dot(a))?;
    let floor = values.iter().fold(0.0f64, |m, x| m.max(*x)) * 1e-20_f64.max(f64::EPSILON * a.nrows() as f64);
    let inverse = values.mapv(|x| if x > floor { 1.0 / x } else { 0.0 });
    let projected = v.t().dot(&a.t().dot(b));
    Ok(v.dot(&(&projected * &inverse.insert_axis(ndarray::Axis(1)))))
}

/// A symmetric matrix has no Cholesky factor: it is not positive definite, or holds non-finite values. The field is its
/// number of rows.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Error)]
#[error("a {0} x {0} matrix is not positive definite, so it has no Cholesky factor")]
pub struct NotPositive(pub usize);

/// The Cholesky factor of a large symmetric matrix, in f32: n rows take 4 n^2 bytes.
///
/// ```
/// # fn main() -> Result<(), ommatidia_physics::linalg::NotPositive> {
/// use ommatidia_physics::linalg::Cholesky32;
/// let factor = Cholesky32::of(vec![4.0, 2.0, 0.0, 3.0], 2)?;
/// let mut x = [8.0, 7.0];
/// factor.solve(&mut x, 1);
/// assert!((x[0] - 1.25).abs() < 1e-6 && (x[1] - 1.5).abs() < 1e-6);
/// # Ok(())
/// # }
/// ```
#[derive(Clone, Debug)]
pub struct Cholesky32 {
    /// Its lower triangle, column by column.
    lower: Vec<f32>,
    rows: usize,
}

impl Cholesky32 {
    /// Factors the matrix `a`, [n, n], in the room that it takes; only its upper triangle is read, row by row.
    ///
    /// # Errors
    /// The matrix is not positive definite.
    ///
    /// # Panics
    /// `a` does not have n x n values.
    pub fn of(mut a: Vec<f32>, n: usize) -> Result<Self, NotPositive> {
        // Rows of the upper triangle are columns of the lower one.
        let lower = MatMut::from_column_major_slice_mut(&mut a, n, n);
        let (par, params) = (get_global_parallelism(), Default::default());
        let mut room = MemBuffer::new(factor::cholesky_in_place_scratch::<f32>(n, par, params));
        factor::cholesky_in_place(lower, Default::default(), par, MemStack::new(&mut room), params)
            .map_err(|_| NotPositive(n))?;
        Ok(Self { lower: a, rows: n })
    }

    /// Solves `a x = b` for k right sides, in place: `b` holds them one after the other, [k, n].
    ///
    /// # Panics
    /// `b` does not have k x n values.
    pub fn solve(&self, b: &mut [f32], k: usize) {
        let lower = MatRef::from_column_major_slice(&self.lower, self.rows, self.rows);
        let right = MatMut::from_column_major_slice_mut(b, self.rows, k);
        let par = get_global_parallelism();
        let mut room = MemBuffer::new(solve::solve_in_place_scratch::<f32>(self.rows, k, par));
        solve::solve_in_place(lower, right, par, MemStack::new(&mut room));
    }
}

/// `out += a b'` for rows of k values: `a` is [m, k], `b` is [n, k], `out` is [m, n], each row by row. On one thread.
///
/// ```
/// let mut out = [1.0, 0.0];
/// ommatidia_physics::linalg::add_products(&mut out, &[1.0, 2.0], &[3.0, 4.0, 5.0, 6.0], 2);
/// assert_eq!(out, [12.0, 17.0]);
/// ```
///
/// # Panics
/// The numbers of values do not belong to one k.
pub fn add_products(out: &mut [f32], a: &[f32], b: &[f32], k: usize) {
    let [m, n] = [a, b].map(|rows| rows.len() / k);
    matmul(
        MatMut::from_row_major_slice_mut(out, m, n),
        Accum::Add,
        MatRef::from_row_major_slice(a, m, k),
        MatRef::from_column_major_slice(b, k, n),
        1.0,
        Par::Seq,
    );
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;
    use ndarray::arr2;

    #[test]
    fn eigenpairs_of_a_known_matrix() {
        let a = arr2(&[[2.0, 1.0], [1.0, 2.0]]);
        let SymmetricEigen { values, vectors } = symmetric_eigen(&a).unwrap();
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
