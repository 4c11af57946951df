//! Why an instrument cannot be watched.

use crate::uncertainty::UncertaintyError;
use ommatidia_model::forward::ForwardError;
use ommatidia_physics::linalg::NotConverged;
use thiserror::Error;

/// Why no maps can be made for an instrument.
#[derive(Debug, Error)]
pub enum WatchError {
    /// Too few views to compare, or too many lenses.
    #[error("a watch compares lenses: expected 3 to {most} that give light, found {found}; leave --watch out")]
    Lenses {
        /// Lenses that give light.
        found: usize,
        /// The most.
        most: usize,
    },
    /// The frame is too large.
    #[error("a watch takes frames of at most {most} pixels, found {rows} x {cols}; leave --watch out")]
    Frame {
        /// Rows.
        rows: usize,
        /// Columns.
        cols: usize,
        /// The most pixels.
        most: u64,
    },
    /// The frames of network and instrument differ.
    #[error(
        "--watch: expected an instrument with frames of {} x {} pixels as the network has, found {} x {}",
        expected[0], expected[1], found[0], found[1]
    )]
    OtherFrame {
        /// Rows and columns of the network's frames.
        expected: [usize; 2],
        /// Rows and columns of the instrument's frames.
        found: [usize; 2],
    },
    /// The instrument cannot be planned.
    #[error(transparent)]
    Forward(#[from] ForwardError),
    /// The normal equations hold values that are not finite.
    #[error(transparent)]
    NotConverged(#[from] NotConverged),
    /// No virtual frames can be made.
    #[error(transparent)]
    Scenes(#[from] UncertaintyError),
}
