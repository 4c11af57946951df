//! The Fourier filter bank: uniformly partitioned overlap-save convolution of the frame with C filters.
//!
//! The same method covers the dense global filter of SV-FourierNet (Yang et al. 2024, section 3B: `irfft2(rfft2(y) K)`)
//! and filters of a few compact foci.
//!
//! # Geometry
//! The geometry is that of one axis; rows and columns are alike. The frame has `n` pixels, the object `m`, the
//! transform `T`, the step is `S <= T`.
//! - *Centres.* The centres of frame and object coincide: padded to any even number `P` of pixels, the frame begins at
//!   `floor((P - n) / 2)` and the object at `floor((P - m) / 2)`. Object pixel 0 therefore lies at frame pixel
//!   `D = floor((T - m) / 2) - floor((T - n) / 2)`. Beyond the frame there are zeros.
//! - *Tiles.* The object is covered by `ceil(m / S)` output tiles of `V = min(S, m)` pixels; tile `i` begins at object
//!   pixel `i S`. The tile is the part `[L, L + V)` of the T results of an inverse transform, `L = floor((T - V) / 2)`:
//!   the middle.
//! - *Windows.* Window `i` holds the T frame pixels from `D + i S - L` on, with tile `i` in its middle.
//! - *Taps.* A tap (channel, dy, dx, spectrum) of tile (i, j) filters window (i + dy, j + dx) by circular convolution.
//!   The valid part is the middle, so it is free of wrap-around for lags `L + V - T ..= L` of the tap's kernel k. With
//!   frame y and object pixel p `out[p] = sum over taps, over lags l, of k[l mod T] y[D + p + dy S - l]`: the tap
//!   covers the lags `l - dy S` of the whole filter. To split a long filter, give each tap the `S` lags
//!   `-S/2 <= l < S/2`. That needs `T >= 2 S - 1`, so S = T/2.
//!
//! With T >= n, S >= m and one tap at (0, 0) in each channel, there is one tile and one window, which holds the whole
//! frame from pixel `floor((T - n) / 2)` on. This is the dense layer: a circular convolution on the padded plane, and a
//! crop to the object at `floor((T - m) / 2)`.
//!
//! # Kernels in space
//! A dense filter that was pruned to a few blocks of lags is stored as these blocks, and the device transforms it. With
//! a tenth of the blocks the file is a tenth as large, at the cost of one more transform per channel. The rest of the
//! computation is the same.
//!
//! # Parts
//! For a part of the object ([`FilterBank::of_part`]), only the tiles that it touches are computed, of each tile only
//! the rows in the part, from only the windows that these tiles read. The result has the bits of the whole.
//!
//! # Numbers
//! The window is transformed once for all channels ([`crate::fft`], scaled by 1/T, stored as halves). The sum over the
//! taps of a channel is taken in the spectrum in binary32, in the order of the file: `re = (re + kr xr) - ki xi`,
//! `im = (im + kr xi) + ki xr`, the products being exact. One inverse transform a channel and tile, scaled by 1/T, so
//! that a spectrum of ones is the identity. Outputs are rounded to half.
//!
//! The pipeline divides by the maximum of all outputs. So all spectra may have a common factor, a power of two, which
//! should keep the outputs far from the ends of the range of halves (6e-5 .. 65504), for example with a maximum near 1.
//!
//! ```
//! use ommatidia_shared::blob::{Bank, Size, Tap};
//! use ommatidia_shared::filter::{FilterBank, Filters, FrameRows};
//! use ommatidia_shared::image::ChwMut;
//! use ommatidia_shared::num::f16;
//! use ommatidia_shared::num::simd::Simd;
//!
//! /// A frame of 8 x 8 pixels: 1 at (3, 4), 0 elsewhere.
//! struct Point;
//!
//! impl FrameRows for Point {
//!     fn load(&self, row: usize, first: usize, to: &mut [f32]) {
//!         for (col, to) in (first..).zip(to) {
//!             *to = if (row, col) == (3, 4) { 1.0 } else { 0.0 };
//!         }
//!     }
//! }
//!
//! // One dense filter whose spectrum is 1 everywhere: the identity.
//! let taps = [Tap { channel: 0, dy: 0, dx: 0 }].into_iter().collect();
//! let bank = Bank { tile: 8, step: 8, channels: 1, taps, blocks: None };
//! let filter = FilterBank::new(&bank, Size { rows: 8, cols: 8 }, Size { rows: 4, cols: 4 }).unwrap();
//! let mut spectrum = vec![f16::ZERO; filter.spectrum_len()];
//! spectrum.chunks_mut(2).for_each(|number| number[0] = f16::ONE);
//!
//! let mut output = vec![f16::ZERO; filter.output_len()];
//! let tensor = ChwMut::new(&mut output, 1, 4, 4).unwrap();
//! let (mut arena, mut scratch) = (vec![f16::ZERO; filter.arena_len()], vec![0.0; filter.scratch_len()]);
//! let filters = Filters { halves: &spectrum, index: &[] };
//! filter.process(Simd::detect(), Some(&Point), filters, tensor, &mut arena, &mut scratch).unwrap();
//!
//! // The object is the middle of the frame, so the point lies at (1, 2) of it.
//! for (i, pixel) in output.iter().enumerate() {
//!     let expected = if i == 4 + 2 { 1.0 } else { 0.0 };
//!     assert!((pixel.to_f32() - expected).abs() < 1e-3, "{i}: {pixel}");
//! }
//! ```

mod bank;
mod geometry;
mod kernel;

pub use bank::{FilterBank, FrameRows};
pub use geometry::{Axis, FilterError, Geometry};
pub use kernel::Filters;

#[cfg(test)]
mod tests;
