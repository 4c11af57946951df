//! What a transform refuses.

use core::fmt;

/// Length of the longest transform.
pub const MAX_LEN: usize = 1024;

/// Why a transform refuses its size or a buffer.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FftError {
    /// Not a power of two from 8 to [`MAX_LEN`].
    Size {
        /// Size given.
        found: usize,
    },
    /// A buffer is too short.
    Buffer {
        /// Elements that the plan needs.
        expected: usize,
        /// Elements that the buffer has.
        found: usize,
    },
}

impl fmt::Display for FftError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Size { found } => write!(f, "FFT size: expected a power of two from 8 to {MAX_LEN}, found {found}"),
            Self::Buffer { expected, found } => write!(f, "FFT buffer: expected {expected} elements, found {found}"),
        }
    }
}

impl core::error::Error for FftError {}

pub(super) fn check_len(expected: usize, found: usize) -> Result<(), FftError> {
    if expected <= found { Ok(()) } else { Err(FftError::Buffer { expected, found }) }
}
