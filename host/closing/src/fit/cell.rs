//! One frame by one spatial block: the unit of hold-outs, clusters and bootstraps.

use ndarray::Array2;

/// Sums over the pixels of one frame in one spatial block.
#[derive(Clone, Debug)]
pub struct Cell {
    /// Index of the frame.
    pub frame: usize,
    /// Index of the spatial block.
    pub block: usize,
    /// Whether it is kept out of every fit.
    pub held_out: bool,
    /// chi-squared that noise alone gives: the number of pixels that are used, less what an estimated specimen takes
    /// up.
    pub pixels: f64,
    /// Gram matrix in units of the noise, [n, n]: columns of the design, then replicates, then the residual.
    pub gram: Array2<f32>,
    /// Sum of the logarithms of the pixels' variances in DN^2.
    pub log_variance: f64,
}
