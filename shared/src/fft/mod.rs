//! Discrete Fourier transforms of power-of-two size: computed in binary32, 2-D spectra stored as halves.
//!
//! Plan -> `scratch_len` -> `process`. Everything is written for a number of *lanes*: independent columns (or rows) that go
//! through the same scalar algorithm side by side, so the number of lanes does not change a bit of the result. Products in
//! butterflies are rounded before they are added.

mod complex;
mod error;
mod plane;
mod real;
mod strip;
mod twiddle;

pub use complex::{Fft, Lanes};
pub use error::{FftError, MAX_LEN};
pub use plane::{Fft2, ProductSource, RowSource};
pub use real::RealFft;
#[cfg(all(target_arch = "arm", target_abi = "eabihf"))]
pub(crate) use twiddle::ROOT_TRIPLES;

#[cfg(test)]
pub(crate) mod naive;
