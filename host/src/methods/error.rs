use std::path::PathBuf;
use thiserror::Error;

/// Why a method cannot be set up or cannot reconstruct a frame.
#[derive(Debug, Error)]
pub enum MethodError {
    /// The frame does not fit the instrument.
    #[error(
        "expected a frame of {expected:?} pixels (rows, cols), found {found:?}; a session and its instrument go together"
    )]
    FrameShape {
        /// Shape of the sensor.
        expected: (usize, usize),
        /// Shape of the frame.
        found: (usize, usize),
    },
    /// A value of the frame is no number.
    #[error("expected finite values in the frame, found {found} at row {row}, column {col}")]
    NotFinite {
        /// Row of the value.
        row: usize,
        /// Column of the value.
        col: usize,
        /// The value.
        found: f32,
    },
    /// Every lens is dead.
    #[error("expected at least one living lens, found none; calibrate again with a bead scan that shows foci")]
    NoLens,
    /// The instrument's PSF at the field's centre holds no light.
    #[error("expected light in the PSF at the field's centre, found none; calibrate again")]
    DarkPsf,
    /// K is no positive number.
    #[error("expected a positive K for the Wiener filter, found {0}")]
    Regularisation(f64),
    /// The file cannot be used by the method that was asked for.
    #[error("{path}: the method `{method}` needs {expected}, found {found}")]
    WrongFile {
        /// The file.
        path: PathBuf,
        /// The method.
        method: String,
        /// What it needs.
        expected: &'static str,
        /// What the file is.
        found: String,
    },
}
