//! The enhancement network in integers: scales from measured ranges, weights of 8 bits for each output channel.

use super::QuantizeError;
use super::pack::{describe, layer, layer_halves, layer_values, narrow};
use super::ranges::Ranges;
use crate::train::Checkpoint;
use ommatidia_shared::blob::{self, FeatureBits};
use ommatidia_shared::nn::integer::{Channel, Convolutions, MAX_SUM};
use ommatidia_shared::nn::rcan::{Layer, layout};
use ommatidia_shared::num::f16;

/// What the input, and a feature of 16 bits, may be above the largest that was measured.
const MARGIN: f32 = 2.0;
/// The same for a feature of 8 bits, of which each bit counts. Larger ones saturate.
const BYTE_MARGIN: f32 = 1.0;
/// Largest magnitude of a weight; -128 is not used.
const MAX_WEIGHT: f64 = 127.0;

/// An enhancement network whose 3x3 convolutions are integers.
pub struct IntegerNetwork {
    /// Scales of input, features and output.
    pub scales: blob::Integers,
    /// The channel attentions.
    pub attention: Vec<f16>,
    weights: Vec<u16>,
    channels: Vec<Channel>,
}

impl IntegerNetwork {
    /// Quantizes the network of a checkpoint. Ranges are measured on its held-out frames.
    ///
    /// # Errors
    /// There are no frames, a weight is missing, or weights are too large for their layer.
    pub fn of(checkpoint: &Checkpoint, features: FeatureBits) -> Result<Self, QuantizeError> {
        Self::with(checkpoint, Ranges::of(checkpoint)?, features)
    }

    fn with(checkpoint: &Checkpoint, ranges: Ranges, features: FeatureBits) -> Result<Self, QuantizeError> {
        let network = &checkpoint.body.network;
        let input_log2 = log2_below(ranges.input).clamp(0, 14);
        let feature_log2 = match features {
            FeatureBits::Sixteen => log2_below(ranges.features),
            FeatureBits::Eight => {
                (f32::from(i8::MAX) / (BYTE_MARGIN * ranges.features.max(f32::MIN_POSITIVE))).log2().floor() as i32
            }
        };
        let feature_log2 = feature_log2.clamp(-16, 14);
        let (mut attention, mut weights, mut channels) = (Vec::new(), Vec::new(), Vec::new());
        let mut output = 1.0;
        for entry in layout(&describe(network)?, narrow("channels", network.channels)?) {
            if entry.kernel != 3 {
                attention.extend(layer_halves(network, &checkpoint.weights, &entry)?);
                continue;
            }
            let [weight, bias] = layer_values(network, &checkpoint.weights, &entry)?;
            let from_log2 = if entry.layer == Layer::Head { input_log2 } else { feature_log2 };
            for (channel, (row, &bias)) in weight.chunks(9 * entry.inputs).zip(&bias).enumerate() {
                let quantized = Quantized::of(row, f64::from(bias) * f64::from(from_log2).exp2());
                let multiplier = (quantized.scale * f64::from(32 + feature_log2 - from_log2).exp2()).round();
                let multiplier = if entry.layer == Layer::Conv2 {
                    // The sum of the last convolution is not rescaled.
                    output = (quantized.scale * f64::from(-from_log2).exp2()) as f32;
                    0
                } else if multiplier <= f64::from(i32::MAX) {
                    multiplier as i32
                } else {
                    return Err(QuantizeError::Integers { layer: layer(network, entry.layer), channel });
                };
                channels.push(Channel { bias: quantized.bias, multiplier });
                weights.extend(quantized.weights);
            }
        }
        let scales =
            blob::Integers { input_log2: input_log2 as i8, feature_log2: feature_log2 as i8, output, features };
        weights.resize(weights.len().next_multiple_of(2), 0);
        let weights = weights.as_chunks::<2>().0.iter().map(|pair| u16::from_le_bytes(pair.map(|w| w as u8))).collect();
        Ok(Self { scales, attention, weights, channels })
    }

    /// The convolutions as the network file holds them.
    pub fn convolutions(&self) -> Convolutions<'_> {
        Convolutions { weights: &self.weights, channels: &self.channels }
    }
}

/// The largest power of two by which numbers of this range, times the margin, are integers of 16 bits.
fn log2_below(range: f32) -> i32 {
    (f32::from(i16::MAX) / (MARGIN * range.max(f32::MIN_POSITIVE))).log2().floor() as i32
}

/// The weights and the bias of an output channel: `scale * weights` and `scale * bias`.
struct Quantized {
    weights: Vec<i8>,
    bias: i32,
    scale: f64,
}

impl Quantized {
    /// The smallest scale at which weights have 8 bits and no sum can overflow.
    fn of(weights: &[f32], bias: f64) -> Self {
        let largest = weights.iter().fold(0.0_f64, |largest, w| largest.max(f64::from(w.abs())));
        let total: f64 = weights.iter().map(|w| f64::from(w.abs())).sum();
        // Rounding adds half a unit to each weight, and to the bias, at most.
        let room = MAX_SUM as f64 - 1.0 - 16_384.0 * weights.len() as f64;
        let by_sum = (32_768.0 * total + bias.abs()) / room;
        let scale = (largest / MAX_WEIGHT).max(by_sum).max(f64::from(f32::MIN_POSITIVE).sqrt());
        Self {
            weights: weights.iter().map(|w| (f64::from(*w) / scale).round() as i8).collect(),
            bias: (bias / scale).round() as i32,
            scale,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use ommatidia_session::rng;
    use rand::RngExt;

    #[test]
    fn no_channel_can_overflow() {
        let mut rng = rng::stream(1, "weights", 0);
        for count in [1, 9, 288, 567, 2268] {
            for magnitude_log2 in [-20, -3, 0, 5] {
                let spread = f32::exp2(magnitude_log2 as f32);
                let weights: Vec<f32> = (0..count).map(|_| spread * rng.random_range(-1.0..1.0f32)).collect();
                for bias in [0.0, 3.0, -1.0e6, 1.0e12] {
                    let found = Quantized::of(&weights, bias);
                    let sum: i64 = found.weights.iter().map(|w| i64::from(w.unsigned_abs())).sum();
                    assert!(i64::from(found.bias.unsigned_abs()) + 32_768 * sum <= MAX_SUM, "{count} {bias}");
                    let half = 0.5001 * found.scale;
                    let near = |w: &f32, q: &i8| (f64::from(*w) - found.scale * f64::from(*q)).abs() <= half;
                    assert!(weights.iter().zip(&found.weights).all(|(w, q)| near(w, q)), "{count} {bias}");
                    assert!((bias - found.scale * f64::from(found.bias)).abs() <= half, "{count} {bias}");
                }
            }
        }
    }

    #[test]
    fn ranges_leave_a_margin_of_two() {
        assert_eq!([0.5, 1.0, 3.9, 4.1].map(log2_below), [14, 13, 12, 11]);
    }
}
