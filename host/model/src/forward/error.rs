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
