//! Weights of the integer convolutions, and the bound of their sums.

use crate::blob::{self, BlobError, Section};
use crate::nn::layout::{Entry, layout};
use bytemuck::{Pod, Zeroable};

/// Largest magnitude of a sum.
pub const MAX_SUM: i64 = i32::MAX as i64;
/// Largest magnitude of a feature.
const MAX_FEATURE: i64 = 1 << 15;

/// What an output channel has besides its weights.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Pod, Zeroable)]
#[repr(C)]
pub struct Channel {
    /// Bias, in units of the sum.
    pub bias: i32,
    /// Multiplier of the sum, 2^-32; not negative.
    pub multiplier: i32,
}

/// The weights of all 3x3 convolutions of a network, in the order of [`layout`].
#[derive(Clone, Copy, Debug)]
pub struct Convolutions<'a> {
    /// Weights of 8 bits, two in a word, the first in the low byte; `[out, in, 3, 3]` for each layer. Behind an odd
    /// number of weights lies a byte that is not used.
    pub weights: &'a [u16],
    /// The output channels of all layers.
    pub channels: &'a [Channel],
}

/// The weights of one 3x3 convolution.
#[derive(Clone, Copy, Debug)]
pub struct Convolution<'a> {
    /// Weights `[out, in, 3, 3]`.
    pub weights: &'a [i8],
    /// Output channels.
    pub channels: &'a [Channel],
}

impl<'a> Convolutions<'a> {
    /// Cuts the weights of a layer off the front, as many as there are.
    pub(crate) fn next(weights: &mut &'a [i8], channels: &mut &'a [Channel], entry: &Entry) -> Convolution<'a> {
        let (count, outputs) = (entry.weights_len().min(weights.len()), entry.outputs.min(channels.len()));
        Convolution {
            weights: weights.split_off(..count).unwrap_or_default(),
            channels: channels.split_off(..outputs).unwrap_or_default(),
        }
    }

    /// The weights one by one.
    pub(crate) fn bytes(&self) -> &'a [i8] {
        bytemuck::cast_slice(self.weights)
    }

    /// Checks that no multiplier is negative, and that no sum of a network of this shape can overflow:
    /// `|bias| + 2^15 sum |w| < 2^31` in every channel.
    ///
    /// # Errors
    /// [`BlobError::Channel`] names the first channel where that does not hold.
    pub fn check(&self, rcan: &blob::Rcan, filters: u8) -> Result<(), BlobError> {
        let (mut weights, mut channels, mut index) = (self.bytes(), self.channels, 0);
        for entry in layout(rcan, filters).filter(|entry| entry.kernel == 3) {
            let layer = Self::next(&mut weights, &mut channels, &entry);
            let each = layer.weights.chunks_exact((entry.inputs * 9).max(1));
            for (weights, channel) in each.zip(layer.channels) {
                // At most 2^7 for each of fewer than 2^14 weights.
                let sum: i64 = weights.iter().map(|&w| i64::from(w.unsigned_abs())).sum();
                let bound = i64::from(channel.bias.unsigned_abs()) + MAX_FEATURE * sum;
                if bound > MAX_SUM || channel.multiplier < 0 {
                    return Err(BlobError::Channel { section: Section::Channels, index });
                }
                index += 1;
            }
        }
        Ok(())
    }
}

/// Number of weights of 8 bits, and of output channels, of all 3x3 convolutions of a network.
pub(crate) fn counts(rcan: &blob::Rcan, filters: u8) -> (u64, u64) {
    let convolutions = layout(rcan, filters).filter(|entry| entry.kernel == 3);
    convolutions.fold((0, 0), |(weights, channels), entry| {
        (weights + entry.weights_len() as u64, channels + entry.outputs as u64)
    })
}
