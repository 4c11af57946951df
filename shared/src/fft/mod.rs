//! Discrete Fourier transforms of power-of-two size: computed in binary32, 2-D spectra stored as halves.
//!
//! A transform is planned once for its size and then runs on buffers of the caller. The code works on a number of
//! *lanes*: independent columns (or rows) that go through the same scalar algorithm side by side. So the number of
//! lanes does not change a bit of the result. Products in butterflies are rounded before they are added.
//!
//! ```
//! use ommatidia_shared::fft::{Fft2, ProductSource, RowSource};
//! use ommatidia_shared::num::simd::Simd;
//! use ommatidia_shared::num::f16;
//!
//! /// A plane of 8 x 8 pixels: 1 at (2, 5), 0 elsewhere.
//! struct Point;
//!
//! impl RowSource for Point {
//!     fn load(&self, row: usize, to: &mut [f32]) {
//!         to.fill(0.0);
//!         to[5] = if row == 2 { 1.0 } else { 0.0 };
//!     }
//! }
//!
//! let fft = Fft2::new(8).unwrap();
//! let (mut spectrum, mut scratch) = (vec![f16::ZERO; fft.spectrum_len(8)], vec![0.0; fft.scratch_len()]);
//! fft.forward(Simd::detect(), &Point, 0..8, &mut spectrum, &mut scratch).unwrap();
//! assert_eq!(spectrum.len(), 8 * 5 * 2, "T rows of T/2 + 1 numbers (re, im)");
//! assert_eq!((spectrum[0], spectrum[1]), (f16::from_f32(0.125), f16::ZERO), "the sum of all pixels over T");
//!
//! /// The spectrum times ones.
//! struct Product<'a>(&'a [f16], &'a [f16]);
//!
//! impl ProductSource for Product<'_> {
//!     fn count(&self) -> usize {
//!         1
//!     }
//!
//!     fn product(&self, _: usize) -> Option<[&[f16]; 2]> {
//!         Some([self.0, self.1])
//!     }
//! }
//!
//! let ones: Vec<f16> = (0..80).map(|i| if i % 2 == 0 { f16::ONE } else { f16::ZERO }).collect();
//! let (mut halfway, mut back) = (vec![f16::ZERO; 80], vec![0.0; 64]);
//! fft.inverse(Simd::detect(), &Product(&spectrum, &ones), 0..8, &mut halfway, &mut scratch, &mut |row, values| {
//!     back[8 * row..][..8].copy_from_slice(values);
//! })
//! .unwrap();
//! assert!((back[2 * 8 + 5] - 1.0).abs() < 1e-3 && back[0].abs() < 1e-3);
//! ```

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
#[cfg(all(target_arch = "arm", feature = "fpv4"))]
pub(crate) use twiddle::ROOT_TRIPLES;

#[cfg(test)]
pub(crate) mod naive;
