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
    /// The noise.
    #[error(transparent)]
    Noise(#[from] NoiseError),
    /// The bead scan.
    #[error(transparent)]
    Bead(#[from] BeadError),
    /// The model of the result.
    #[error(transparent)]
    Forward(#[from] ForwardError),
    /// The numbers.
    #[error(transparent)]
    NotConverged(#[from] NotConverged),
    /// The window.
    #[error("window: expected an odd number of pixels, found {found}")]
    Window {
        /// What was asked for.
        found: usize,
    },
    /// The rank.
    #[error("rank: expected 1 to {most} (the bead frames at hand), found {found}")]
    Rank {
        /// Largest that the data allow.
        most: usize,
        /// What was asked for.
        found: usize,
    },
}
