//! Errors of the operators.

use core::fmt;

/// An argument of an operator does not fit its plan.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum NnError {
    /// A tensor has another shape (channels, rows, columns) than the plan.
    Shape {
        /// Shape of the plan.
        expected: [usize; 3],
        /// Shape of the tensor.
        found: [usize; 3],
    },
    /// A slice of weights has another length than the plan.
    Weights {
        /// Halves that the plan needs.
        expected: usize,
        /// Halves given.
        found: usize,
    },
    /// A convolution in integers has another activation than ReLU or none.
    Activation,
    /// The features would have 4 GiB or more.
    TooLarge {
        /// Memory that the plan needs, bytes.
        needed: u64,
    },
    /// There is too little scratch memory.
    Scratch {
        /// Numbers needed at least.
        expected: usize,
        /// Numbers given.
        found: usize,
    },
}

impl fmt::Display for NnError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Shape { expected, found } => write!(f, "tensor: expected (c, h, w) = {expected:?}, found {found:?}"),
            Self::Weights { expected, found } => write!(f, "weights: expected {expected} halves, found {found}"),
            Self::Activation => f.write_str("a convolution in integers ends in ReLU or in no activation"),
            Self::TooLarge { needed } => {
                write!(f, "features: they need {needed} bytes; choose a smaller object or fewer features")
            }
            Self::Scratch { expected, found } => {
                write!(f, "scratch: expected at least {expected} numbers, found {found}")
            }
        }
    }
}

impl core::error::Error for NnError {}

pub(super) fn check_shape(expected: [usize; 3], found: [usize; 3]) -> Result<(), NnError> {
    if expected == found { Ok(()) } else { Err(NnError::Shape { expected, found }) }
}

pub(super) fn check_weights(expected: usize, found: usize) -> Result<(), NnError> {
    if expected == found { Ok(()) } else { Err(NnError::Weights { expected, found }) }
}

pub(super) fn check_scratch(expected: usize, found: usize) -> Result<(), NnError> {
    if expected <= found { Ok(()) } else { Err(NnError::Scratch { expected, found }) }
}
