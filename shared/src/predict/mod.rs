//! The frame of a reconstruction, predicted with a short low-rank model of the calibrated PSFs, for networks with more
//! than one pass ([`crate::blob::Passes`]).
//!
//! ```text
//! g = sum_l place_l( sum_k (M_lk . x) * B_lk )
//! ```
//! x is the object (m_r, m_c), M_lk the coefficient map of term k of lens l, B_lk its basis PSF (W, W), and `*` the
//! convolution in full. `place_l` puts element (u, v) of an image at frame pixel `corner_l - (W - 1) / 2 + (u, v)`.
//! Light off the frame is cut.
//!
//! # Maps
//! The file holds a map at nodes, every S-th pixel (S a power of two); the last nodes lie on the last pixel or beyond
//! it. Maps are expanded where a row of `M_lk . x` is transformed, and never stored. Between nodes they are linear,
//! first along the columns of nodes, then along the row, with weights that are multiples of 1/S:
//! `v_j = a + (b - a) i/S`, `M = v_j + (v_(j+1) - v_j) n/S`, each operation rounded to binary32, and `M x` once more.
//!
//! # Transforms
//! Planes are padded with zeros to T, the smallest power of two that holds an image (m + W - 1), so no convolution
//! wraps around. Of each lens up to [`GROUP`] terms are taken together: `M_lk . x` and `T B_lk` are transformed
//! ([`crate::fft`], scaled by 1/T, stored as halves), their products are summed in the spectrum in binary32 in the
//! order of the terms, and one inverse transform gives their image. Its rows are added to the frame, which is stored as
//! halves, in the order of the lenses.
//!
//! # Range
//! A network file is refused unless |M| <= 1 and the magnitudes of all lags of a lens sum to 1 at most (T as they are
//! stored). With x from 0 to 1 an image then lies within -1 and 1 up to rounding, half-transformed rows within -2 T and
//! 2 T, T <= 1024, and a frame within -[`MAX_LENSES`](crate::blob::MAX_LENSES) and as many: no half overflows. The
//! scale of the frame is free otherwise, since passes fit it.

mod plan;
mod source;

pub use plan::{GROUP, Predictor};

#[cfg(test)]
mod tests;
