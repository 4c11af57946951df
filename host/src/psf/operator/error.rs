//! Why an operator could not be planned or applied.

use thiserror::Error;

/// Why an operator could not be planned or applied.
#[derive(Clone, Debug, PartialEq, Error)]
pub enum OperatorError {
    /// An array has the wrong shape.
    #[error("{what}: expected {expected:?}, found {found:?}")]
    Shape {
        /// Which array.
        what: &'static str,
        /// Rows and columns that were expected.
        expected: [usize; 2],
        /// Rows and columns that were found.
        found: [usize; 2],
    },
    /// There is no such depth.
    #[error("depth index {found}: the instrument was calibrated at {depths} depths")]
    Depth {
        /// The requested index.
        found: usize,
        /// Number of depths.
        depths: usize,
    },
    /// An effect changes the magnification, which needs a new calibration.
    #[error(
        "effective magnification {found}: the basis PSFs were calibrated at {expected}; only chief rays may be moved"
    )]
    Magnification {
        /// Magnification of the calibration.
        expected: f64,
        /// The requested magnification.
        found: f64,
    },
    /// Two tables of the instrument have different lengths.
    #[error("instrument field `{field}`: expected {expected} entries, found {found}; calibrate again")]
    Field {
        /// Which field.
        field: &'static str,
        /// Entries that were expected.
        expected: usize,
        /// Entries that were found.
        found: usize,
    },
}
