//! Why a method cannot be used.

use ommatidia_model::forward::ForwardError;
use ommatidia_physics::sensor::{FrameError, MapShapeError};
use std::path::PathBuf;
use thiserror::Error;

/// Why a method cannot be set up or cannot reconstruct a frame.
#[derive(Debug, Error)]
pub enum MethodError {
    /// The raw frame does not fit the sensor, or holds values that are not finite.
    #[error(transparent)]
    Frame(#[from] FrameError),
    /// A map of the sensor has another shape than the sensor.
    #[error(transparent)]
    Maps(#[from] MapShapeError),
    /// The parts of the instrument disagree.
    #[error(transparent)]
    Forward(#[from] ForwardError),
    /// The PSF of the array has another shape than the sensor.
    #[error(
        "expected a PSF of {} x {} pixels (rows x columns) like the sensor, found {} x {}",
        expected[0], expected[1], found[0], found[1]
    )]
    PsfShape {
        /// Rows and columns of the sensor.
        expected: [usize; 2],
        /// Rows and columns of the PSF.
        found: [usize; 2],
    },
    /// Every lens is dead.
    #[error("expected at least one living lens, found none; calibrate again with a bead scan that shows foci")]
    NoLens,
    /// The instrument's PSF at the centre of the field holds no light.
    #[error("expected light in the PSF at the centre of the field, found none; calibrate again")]
    DarkPsf,
    /// The regularisation K is not a positive number.
    #[error("expected a positive K for the Wiener filter, found {0}")]
    Regularisation(f64),
    /// No method is made from files of this kind.
    #[error(
        "{path}: expected a checkpoint, a network file (blob) or an instrument, found {found}; name a file that \
         `train`, `quantize` or `calibrate` wrote"
    )]
    NoMethod {
        /// The file.
        path: PathBuf,
        /// Kind of the file.
        found: String,
    },
    /// The file is not of a kind that the method can be made from.
    #[error("{path}: the method `{method}` needs {expected}, found {found}")]
    WrongFile {
        /// The file.
        path: PathBuf,
        /// The method.
        method: String,
        /// Kind of file that the method needs.
        expected: &'static str,
        /// Kind of the file.
        found: String,
    },
}
