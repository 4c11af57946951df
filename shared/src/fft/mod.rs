//! Discrete Fourier transforms of power-of-two size: computed in binary32, 2-D spectra stored as halves.
//!
//! Plan -> `scratch_len` -> `process`. Everything is written for a number of *lanes*: independent columns (or rows) that go
//! through the same scalar algorithm side by side, so the number of lanes does not change a bit of the result. Products in
//! butterflies are rounded before they are added.

mod complex;
mod plane;
mod real;
mod strip;
mod twiddle;

pub use complex::{Fft, Lanes};
pub use plane::{Fft2, ProductSource, RowSource};
pub use real::RealFft;
#[cfg(all(target_arch = "arm", target_abi = "eabihf"))]
pub(crate) use twiddle::ROOT_TRIPLES;

use core::fmt;

/// The largest transform.
pub const MAX_LEN: usize = 1024;

/// What a transform refuses.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FftError {
    /// Not a power of two from 8 to [`MAX_LEN`].
    Size {
        /// The size asked for.
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

fn check_len(expected: usize, found: usize) -> Result<(), FftError> {
    if expected <= found { Ok(()) } else { Err(FftError::Buffer { expected, found }) }
}

#[cfg(test)]
pub(crate) mod naive;
