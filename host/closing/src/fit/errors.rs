//! Errors of the calibration in the frames of a session.

use ndarray::Array2;

/// Changes of the expected frames by errors of the calibration: independent directions, each of one standard deviation,
/// so that the covariance of the frames is the sum of their squares.
#[derive(Clone, Debug, Default)]
pub struct Errors {
    /// For each direction and frame the change, as far as the frame can show it, DN, [sensor rows, sensor cols]. None:
    /// the frame does not depend on the calibration.
    pub changes: Vec<Vec<Option<Array2<f32>>>>,
    /// Number of the first directions that are the scatter of replicates, which few of them show; the others are
    /// stated.
    pub scattered: usize,
}
