//! The Fourier filter bank: uniformly partitioned overlap-save convolution of the frame with C filters.
//!
//! One mechanism serves from the paper's dense global filter (SV-FourierNet, section 3B: `irfft2(rfft2(y) K)`) to a few compact foci.
//!
//! # Geometry
//! All along one axis; rows and columns are alike. The frame has `n` pixels, the object `m`, the transform `T`, the step `S <= T`.
//! - *Centres meet.* Padded to any even number `P` of pixels, the frame begins at `floor((P - n) / 2)` and the object at
//!   `floor((P - m) / 2)`. Object pixel 0 therefore lies at frame pixel `D = floor((T - m) / 2) - floor((T - n) / 2)`. Beyond the frame
//!   there are zeros.
//! - *Tiles.* The object is covered by `ceil(m / S)` output tiles of `V = min(S, m)` pixels; tile `i` begins at object pixel `i S`. The
//!   tile is the part `[L, L + V)` of the T results of an inverse transform, `L = floor((T - V) / 2)`: the middle.
//! - *Windows.* Window `i` is the T frame pixels from `D + i S - L` on. It lies round tile `i`.
//! - *Taps.* A tap (channel, dy, dx, spectrum) of tile (i, j) filters window (i + dy, j + dx) by circular convolution. As the valid part
//!   is the middle, it is free of wrap-around for lags `L + V - T ..= L` of the tap's kernel k; with frame y and object pixel p
//!   `out[p] = sum over taps, over lags l, of k[l mod T] y[D + p + dy S - l]`: seen from the whole filter the tap covers lags
//!   `l - dy S`. To split a long filter, give each tap the `S` lags `-S/2 <= l < S/2`; that needs `T >= 2 S - 1`, so S = T/2.
//!
//! With T >= n and one tap at (0, 0) a channel, S >= m, there is one tile and one window, and it holds the whole frame, which begins at
//! `floor((T - n) / 2)`: the dense layer, a circular convolution on the padded plane, object crop at `floor((T - m) / 2)`.
//!
//! # Kernels in space
//! A dense filter that was pruned to a few blocks of lags is stored as these blocks, and transformed by the device: a tenth of the bytes for one
//! transform more a channel (the module `kernel`). What follows is the same.
//!
//! # Parts
//! A part of the object takes the tiles that it touches, of each the rows that it holds, and the windows that these tiles read. Nothing else is
//! transformed, and no bit is another ([`FilterBank::of_part`]).
//!
//! # Numbers
//! The window is transformed once for all channels ([`crate::fft`], scaled by 1/T, stored as halves). The sum over the taps of a channel
//! is taken in the spectrum in binary32, in the order of the file: `re = (re + kr xr) - ki xi`, `im = (im + kr xi) + ki xr`, the products
//! being exact. One inverse transform a channel and tile, scaled by 1/T, so that a spectrum of ones is the identity. Outputs are
//! rounded to half.
//!
//! The network divides by the maximum of all outputs. A power of two common to all spectra is therefore free: choose it so
//! that the outputs stay far from the ends of the range of halves (6e-5 .. 65504), say with a maximum near 1.

mod bank;
mod geometry;
mod kernel;

pub use bank::{FilterBank, FrameRows};
pub use geometry::{Axis, FilterError, Geometry};
pub use kernel::Filters;

#[cfg(test)]
mod tests;
