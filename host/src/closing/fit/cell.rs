//! One frame by one spatial block: the unit of hold-outs, clusters and bootstraps.

use ndarray::Array2;

/// One frame by one block.
#[derive(Clone, Debug)]
pub struct Cell {
    /// Frame.
    pub frame: usize,
    /// Spatial block.
    pub block: usize,
    /// Kept out of every fit.
    pub held_out: bool,
    /// Pixels that count.
    pub pixels: usize,
    /// Gram matrix: columns, then replicates, then the residual.
    pub gram: Array2<f32>,
    /// Sum of the logarithms of the variances, DN^2.
    pub log_variance: f64,
}
