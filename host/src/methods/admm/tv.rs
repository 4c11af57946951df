//! Forward differences, their transpose, and the shrinkage of isotropic total variation.

use ndarray::{Array2, ArrayView2, Zip};

/// Boundary condition beyond the last row and column.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Edge {
    /// Periodic, as FFTs assume: the first row follows the last.
    Wrap,
    /// The last row and column repeat, so the difference there is 0.
    Mirror,
}

/// Differences to the next row and to the next column of an image [rows, cols]; both of its shape.
pub fn gradient(x: ArrayView2<'_, f32>, edge: Edge) -> [Array2<f32>; 2] {
    let (rows, cols) = x.dim();
    let next = |i: usize, n: usize| match edge {
        Edge::Wrap => (i + 1) % n,
        Edge::Mirror => (i + 1).min(n - 1),
    };
    [
        Array2::from_shape_fn((rows, cols), |(r, c)| x[[next(r, rows), c]] - x[[r, c]]),
        Array2::from_shape_fn((rows, cols), |(r, c)| x[[r, next(c, cols)]] - x[[r, c]]),
    ]
}

/// The transpose of [`gradient`]: two images to one, all of one shape.
pub fn gradient_transposed(p: &[Array2<f32>; 2], edge: Edge) -> Array2<f32> {
    let (rows, cols) = p[0].dim();
    // Element i is the minuend of difference i and the subtrahend of difference i - 1.
    let part = |own: f32, before: Option<f32>, last: bool| {
        let own = if last && edge == Edge::Mirror { 0.0 } else { own };
        before.unwrap_or(0.0) - own
    };
    let before = |i: usize, n: usize| match edge {
        Edge::Wrap => Some((i + n - 1) % n),
        Edge::Mirror => i.checked_sub(1),
    };
    Array2::from_shape_fn((rows, cols), |(r, c)| {
        part(p[0][[r, c]], before(r, rows).map(|b| p[0][[b, c]]), r + 1 == rows)
            + part(p[1][[r, c]], before(c, cols).map(|b| p[1][[r, b]]), c + 1 == cols)
    })
}

/// Shortens the gradient vector of each pixel by `by`, at most to 0: the proximal map of isotropic total variation.
pub fn shrink(p: &mut [Array2<f32>; 2], by: f32) {
    let [rows, cols] = p;
    Zip::from(rows).and(cols).for_each(|a, b| {
        let length = a.hypot(*b);
        let keep = if length > by { 1.0 - by / length } else { 0.0 };
        (*a, *b) = (*a * keep, *b * keep);
    });
}

/// Isotropic total variation: the sum over all pixels of the length of the gradient.
#[cfg(test)]
pub fn total_variation(x: ArrayView2<'_, f32>, edge: Edge) -> f64 {
    let [a, b] = gradient(x, edge);
    a.iter().zip(&b).map(|(&a, &b)| f64::from(a).hypot(f64::from(b))).sum()
}
