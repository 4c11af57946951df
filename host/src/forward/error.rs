//! Why a frame could not be computed.

use crate::effects::EffectError;
use crate::psf::OperatorError;
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
