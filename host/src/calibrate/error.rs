//! Why a session cannot be calibrated.

use crate::bead::BeadError;
use crate::forward::ForwardError;
use crate::linalg::NotConverged;
use crate::noise::NoiseError;
use crate::session::SessionError;
use thiserror::Error;

/// Why a session cannot be calibrated.
#[derive(Debug, Error)]
pub enum CalibrateError {
    /// The session.
    #[error(transparent)]
    Session(#[from] SessionError),
    /// The noise measurement.
    #[error(transparent)]
    Noise(#[from] NoiseError),
    /// The bead scan.
    #[error(transparent)]
    Bead(#[from] BeadError),
    /// The forward model of the calibrated instrument.
    #[error(transparent)]
    Forward(#[from] ForwardError),
    /// A decomposition failed.
    #[error(transparent)]
    NotConverged(#[from] NotConverged),
    /// The window has an even side.
    #[error("window: expected an odd number of pixels, found {found}")]
    Window {
        /// The requested value.
        found: usize,
    },
    /// The rank is zero or larger than the number of beads.
    #[error("rank: expected 1 to {most} (the number of bead frames), found {found}")]
    Rank {
        /// Largest rank that the data allow.
        most: usize,
        /// The requested value.
        found: usize,
    },
}
