//! The 3x3 convolutions of the network in integers: weights of 8 bits, features of 16 or of 8, sums of 32.
//!
//! A feature is stored as an integer from -32,768 to 32,767, or from -128 to 127. What a unit is worth may differ
//! between channels: weights, biases and multipliers hold it. Skip connections and attention add tensors channel by
//! channel, so these share the units of their channels. The loops know one of them only, that of a channel's mean
//! ([`Integers::feature_log2`](crate::blob::Integers::feature_log2)). Output channel o of a convolution is
//! ```text
//! sum = b[o] + sum_{i, ky, kx} w[o][i][ky][kx] x[i][r + ky - 1][c + kx - 1]
//! y   = saturate(rescale(sum, m[o]))                  rescale(s, m) = floor(s m / 2^32 + 1/2)
//! ```
//! with ReLU: y is 0 where it is negative; with a skip connection: `y = saturate(old + rescale(sum, m[o]))`. This is
//! the only rounding: to the nearest, halves up. The multiplier m, below 2^31, holds the scale of the channel's weights
//! and the ratio of the scales of input and output. It needs no shift: its own rounding changes an output by less than
//! a quarter of a unit, since a sum is below 2^31.
//!
//! No sum overflows, whatever the features are: `|b| + 2^15 sum |w| < 2^31` holds for each channel of a
//! [`crate::blob::Network`], by [`Convolutions::check`]. So sums are exact, and their order does not matter.
//!
//! The borders to the rest of the network:
//! - The input of the network is halves. `x 2^a` is rounded to an integer of 16 bits in the same way
//!   ([`rescale::from_half`]), whatever the features have.
//! - The means of channel attention are exact sums of integers, converted to binary32 and multiplied by `2^-f`; weights
//!   of the attention hold what the unit of a channel differs from that by. Attention itself is computed in
//!   binary32 as for halves; the scale s of a channel becomes `k = min(floor(2^15 s + 1/2), 2^15 - 1)`, and
//!   `g = saturate(g + floor(k t / 2^15 + 1/2))`.
//! - The sum of the last convolution is converted to binary32 and multiplied by its scale; then the logistic function
//!   and one rounding to half, as for halves.
//!
//! Integer networks are exact everywhere, those of other libraries too: what this module adds is that they run in the
//! same memory plan, regions and network file as those in halves.

mod conv;
mod feature;
mod packed;
pub mod rescale;
mod upscale;
mod weights;

pub use conv::{process, scratch_len};
pub use feature::Feature;
pub use upscale::{Last, process as upscale, scratch_len as upscale_scratch_len};
pub(crate) use weights::counts;
pub use weights::{Channel, Convolution, Convolutions, MAX_SUM};

#[cfg(test)]
pub(super) mod tests;
