//! Why a frame could not be computed.

use crate::psf::OperatorError;
use ommatidia_physics::effects::EffectError;
use ommatidia_physics::linalg::NotPositive;
use thiserror::Error;

/// Why a frame could not be computed.
#[derive(Clone, Debug, PartialEq, Error)]
pub enum ForwardError {
    /// The optical operator.
    #[error(transparent)]
    Operator(#[from] OperatorError),
    /// An effect.
    #[error(transparent)]
    Effect(#[from] EffectError),
    /// The optics have no normal matrix that can be factored.
    #[error("the optics of the instrument cannot be inverted: {0}")]
    Optics(#[from] NotPositive),
    /// A place outside the object.
    #[error("place: expected [y, x] at most {edge_um:?} um from the centre, found {found_um:?} um")]
    Place {
        /// Largest distances from the centre, [y, x], um.
        edge_um: [f64; 2],
        /// The place, [y, x], um.
        found_um: [f64; 2],
    },
    /// An object holds a non-finite or negative value.
    #[error("object pixel ({row}, {col}): expected a finite value >= 0, found {found}")]
    Object {
        /// Row.
        row: usize,
        /// Column.
        col: usize,
        /// The value.
        found: f32,
    },
}
