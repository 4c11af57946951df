//! The enhancement network in integers: scales from measured ranges, weights of 8 bits for each output channel.

use super::QuantizeError;
use super::pack::{describe, halves, layer, layer_values, narrow};
use super::ranges::{Ranges, feature_steps};
use crate::train::{Checkpoint, FeatureSteps, Features, MOST_WEIGHT, NetworkConfig};
use ommatidia_shared::blob::{self, FeatureBits};
use ommatidia_shared::nn::integer::{Channel, Convolutions, MAX_SUM};
use ommatidia_shared::nn::rcan::{Layer, layout};
use ommatidia_shared::num::f16;

/// What the input, and a feature of 16 bits, may be above the largest that was measured.
const MARGIN: f32 = 2.0;
/// Largest magnitude of a weight.
const MAX_WEIGHT: f64 = MOST_WEIGHT as f64;

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
    /// Quantizes the network of a checkpoint. Ranges are measured on its held-out frames; features of 8 bits have the
    /// steps that the network was trained for, if it was.
    ///
    /// # Errors
    /// There are no frames, a weight is missing, or weights are too large for their layer.
    pub fn of(checkpoint: &Checkpoint, features: FeatureBits) -> Result<Self, QuantizeError> {
        let network = &checkpoint.body.network;
        let ranges = Ranges::of(checkpoint)?;
        let (feature_log2, steps) = match (features, &checkpoint.body.feature_steps) {
            (FeatureBits::Sixteen, _) => {
                let log2 = log2_below(ranges.features).clamp(-16, 14);
                (log2, FeatureSteps::even(network, (-log2 as f32).exp2()))
            }
            (FeatureBits::Eight, Some(steps)) => (mean_log2(&steps.sums), steps.clone()),
            (FeatureBits::Eight, None) => {
                let steps = feature_steps(checkpoint)?;
                (mean_log2(&steps.sums), steps)
            }
        };
        let scales = blob::Integers {
            input_log2: log2_below(ranges.input).clamp(0, 14) as i8,
            feature_log2: feature_log2 as i8,
            output: 1.0,
            features,
        };
        Self::with(checkpoint, scales, &steps)
    }

    /// The scale of the output is not used.
    fn with(checkpoint: &Checkpoint, scales: blob::Integers, steps: &FeatureSteps) -> Result<Self, QuantizeError> {
        let network = &checkpoint.body.network;
        let (mut attention, mut weights, mut channels) = (Vec::new(), Vec::new(), Vec::new());
        let mut output = 1.0;
        let input_step = f64::from(-scales.input_log2).exp2();
        for entry in layout(&describe(network)?, narrow("channels", network.channels)?) {
            let [mut weight, bias] = layer_values(network, &checkpoint.weights, &entry)?;
            if entry.kernel != 3 {
                if let Layer::Squeeze { .. } = entry.layer {
                    // The device takes the means of all channels for multiples of one step.
                    let unit = f32::from(scales.feature_log2).exp2();
                    let steps = steps.sums.iter().cycle();
                    weight.iter_mut().zip(steps).for_each(|(weight, step)| *weight *= step * unit);
                }
                let name = layer(network, entry.layer);
                attention.extend(halves(&format!("{name}.weight"), weight.into_iter())?);
                attention.extend(halves(&format!("{name}.bias"), bias.into_iter())?);
                continue;
            }
            let [from, to] = read_and_stored(network, entry.layer).map(|features| features.and_then(|f| steps.of(f)));
            for (channel, (row, &bias)) in weight.chunks(9 * entry.inputs).zip(&bias).enumerate() {
                // What a unit of the input is worth in the output.
                let step = |input: usize| from.map_or(input_step, |steps| f64::from(steps[input]));
                let worth: Vec<f64> = row.iter().enumerate().map(|(i, w)| f64::from(*w) * step(i / 9)).collect();
                let quantized = Quantized::of(&worth, f64::from(bias));
                let multiplier = match to {
                    // The sum of the last convolution is not rescaled.
                    None => {
                        output = quantized.scale as f32;
                        0.0
                    }
                    Some(steps) => {
                        let step = f64::from(steps[channel * steps.len() / entry.outputs]);
                        (quantized.scale / step * f64::from(32).exp2()).round()
                    }
                };
                if multiplier > f64::from(i32::MAX) {
                    return Err(QuantizeError::Integers { layer: layer(network, entry.layer), channel });
                }
                channels.push(Channel { bias: quantized.bias, multiplier: multiplier as i32 });
                weights.extend(quantized.weights);
            }
        }
        weights.resize(weights.len().next_multiple_of(2), 0);
        let weights = weights.as_chunks::<2>().0.iter().map(|pair| u16::from_le_bytes(pair.map(|w| w as u8))).collect();
        Ok(Self { scales: blob::Integers { output, ..scales }, attention, weights, channels })
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

/// The exponent of the power of two that is nearest to the steps of the channels, in the mean of their logarithms; with
/// the sign of a number of units.
fn mean_log2(steps: &[f32]) -> i32 {
    let sum: f32 = steps.iter().map(|step| step.log2()).sum();
    -(sum / steps.len() as f32).round().clamp(-14.0, 16.0) as i32
}

/// The features that a convolution reads, and those that it stores or adds to; None: the input and the output of the
/// network.
fn read_and_stored(network: &NetworkConfig, layer: Layer) -> [Option<Features>; 2] {
    let sums = Some(Features::Sums);
    match layer {
        Layer::Head => [None, sums],
        Layer::BlockConv { group, block, conv } => {
            let inner = Some(Features::Inner(usize::from(group) * network.blocks + usize::from(block)));
            if conv == 0 { [sums, inner] } else { [inner, sums] }
        }
        Layer::Upscale => [sums, Some(Features::Fine)],
        Layer::Conv2 => [Some(Features::Fine), None],
        Layer::Squeeze { .. } | Layer::Excite { .. } | Layer::GroupConv { .. } | Layer::Conv1 => [sums, sums],
    }
}

/// The weights and the bias of an output channel: `scale * weights` and `scale * bias`.
struct Quantized {
    weights: Vec<i8>,
    bias: i32,
    scale: f64,
}

impl Quantized {
    /// The smallest scale at which weights have 8 bits and no sum can overflow.
    fn of(weights: &[f64], bias: f64) -> Self {
        let largest = weights.iter().fold(0.0_f64, |largest, w| largest.max(w.abs()));
        let total: f64 = weights.iter().map(|w| w.abs()).sum();
        // Rounding adds half a unit to each weight, and to the bias, at most.
        let room = MAX_SUM as f64 - 1.0 - 16_384.0 * weights.len() as f64;
        let by_sum = (32_768.0 * total + bias.abs()) / room;
        let scale = (largest / MAX_WEIGHT).max(by_sum).max(f64::from(f32::MIN_POSITIVE).sqrt());
        Self {
            weights: weights.iter().map(|w| (w / scale).round() as i8).collect(),
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
                let spread = f64::from(magnitude_log2).exp2();
                let weights: Vec<f64> = (0..count).map(|_| spread * rng.random_range(-1.0..1.0)).collect();
                for bias in [0.0, 3.0, -1.0e6, 1.0e12] {
                    let found = Quantized::of(&weights, bias);
                    let sum: i64 = found.weights.iter().map(|w| i64::from(w.unsigned_abs())).sum();
                    assert!(i64::from(found.bias.unsigned_abs()) + 32_768 * sum <= MAX_SUM, "{count} {bias}");
                    let half = 0.5001 * found.scale;
                    let near = |w: &f64, q: &i8| (w - found.scale * f64::from(*q)).abs() <= half;
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
