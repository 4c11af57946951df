//! The low-rank terms of a lens.

use ndarray::Array3;

/// Terms of one lens.
#[derive(Clone, Debug)]
pub(super) struct Terms {
    /// Basis PSFs, [k, window, window].
    pub kernels: Array3<f32>,
    /// Coefficients at the nodes, [k, node row, node col], DN for a unit source.
    pub coefficients: Array3<f32>,
}

impl Terms {
    /// The number of terms.
    pub fn count(&self) -> usize {
        self.kernels.dim().0
    }
}

/// A living lens.
#[derive(Clone, Debug)]
pub(super) struct Lens {
    /// Its index, dead lenses counted.
    pub index: usize,
    /// Sensor pixel of object pixel (0, 0).
    pub corner: [isize; 2],
    pub terms: Terms,
}
