//! Channel attention (Zhang et al., RCAN, ECCV 2018, Eq. 6-8): each channel is scaled by a function of the means of all
//! channels.
//!
//! `s = sigmoid(B relu(A mean(x) + a) + b)`, A of W/r x W, B of W x W/r. The mean is a sum in binary32 in a fixed
//! order: eight partial sums in each row (columns 8 k + j), added as a tree, row after row; then a division by the
//! number of pixels. Products of the two small layers are rounded before they are added ([`mac`]); sums start from the
//! bias.

use super::activation::Activation;
use super::arithmetic::{Arithmetic, Halves};
use super::error::{NnError, check_scratch, check_shape, check_weights};
use crate::image::Chw;
use crate::num::simd::Simd;
use crate::num::{f16, mac, widen};

/// Weights of the two 1x1 layers.
#[derive(Clone, Copy, Debug)]
pub struct Parameters<'a> {
    /// A, `[hidden, channels]`.
    pub squeeze: &'a [f16],
    /// a, `[hidden]`.
    pub squeeze_bias: &'a [f16],
    /// B, `[channels, hidden]`.
    pub excite: &'a [f16],
    /// b, `[channels]`.
    pub excite_bias: &'a [f16],
}

/// Source of the scales of the channels: those of one block, or of all blocks in the order of execution.
#[derive(Debug)]
pub enum Scales<'s> {
    /// Computed from the features of the same frame. Where a slice is given, they are written to it.
    Measured(Option<&'s mut [f32]>),
    /// Taken from another frame, for which they were computed.
    Held(&'s [f32]),
}

impl Scales<'_> {
    /// The scales of the next block, which has `channels` channels.
    pub(super) fn next(&mut self, channels: usize) -> Scales<'_> {
        match self {
            Self::Measured(None) => Scales::Measured(None),
            Self::Measured(Some(rest)) => Scales::Measured(rest.split_off_mut(..channels)),
            Self::Held(rest) => Scales::Held(rest.split_off(..channels).unwrap_or_default()),
        }
    }
}

/// Plan of a channel attention.
#[derive(Clone, Copy, Debug)]
pub struct ChannelAttention {
    /// Channels W.
    pub channels: usize,
    /// Width W/r of the bottleneck.
    pub hidden: usize,
    /// Rows of the frame.
    pub rows: usize,
    /// Columns of the frame.
    pub cols: usize,
}

impl ChannelAttention {
    /// Length of scratch for [`Self::process`], numbers.
    pub const fn scratch_len(&self) -> usize {
        self.channels + self.hidden
    }

    /// Writes the scale of each channel, 0 to 1, to `scale` (`channels` long). `input` is (channels, rows, cols).
    ///
    /// # Errors
    /// [`NnError`] where the tensor, the weights, `scale` or the scratch do not fit the plan.
    pub fn process(
        &self,
        simd: Simd,
        parameters: Parameters<'_>,
        input: Chw<'_, f16>,
        scale: &mut [f32],
        scratch: &mut [f32],
    ) -> Result<(), NnError> {
        self.process_with(Halves(simd), parameters, input, scale, scratch)
    }

    /// [`Self::process`] for features that are stored as in `arithmetic`.
    pub(super) fn process_with<A: Arithmetic>(
        &self,
        arithmetic: A,
        parameters: Parameters<'_>,
        input: Chw<'_, A::Number>,
        scale: &mut [f32],
        scratch: &mut [f32],
    ) -> Result<(), NnError> {
        check_shape([self.channels, self.rows, self.cols], input.shape())?;
        for weights in [parameters.squeeze, parameters.excite] {
            check_weights(self.channels * self.hidden, weights.len())?;
        }
        check_weights(self.hidden, parameters.squeeze_bias.len())?;
        check_weights(self.channels, parameters.excite_bias.len())?;
        check_scratch(self.channels, scale.len())?;
        check_scratch(self.scratch_len(), scratch.len())?;
        let (mean, hidden) = scratch.split_at_mut(self.channels);
        let (hidden, scale) = (&mut hidden[..self.hidden], &mut scale[..self.channels]);
        arithmetic.means(input, mean);
        dense(parameters.squeeze, parameters.squeeze_bias, mean, hidden);
        Activation::Relu.apply(hidden);
        dense(parameters.excite, parameters.excite_bias, hidden, scale);
        Activation::Sigmoid.apply(scale);
        Ok(())
    }
}

/// `to = bias + weights from`.
fn dense(weights: &[f16], bias: &[f16], from: &[f32], to: &mut [f32]) {
    for ((to, weights), &bias) in to.iter_mut().zip(weights.chunks_exact(from.len())).zip(bias) {
        *to = weights.iter().zip(from).fold(widen(bias), |sum, (&w, &x)| mac(widen(w), x, sum));
    }
}

#[cfg(test)]
mod tests {
    extern crate std;

    use super::*;
    use crate::naive::{self, Noise, Tensor, wide};
    use std::vec;
    use std::vec::Vec;

    /// The error of the sigmoid (1.8e-4) and of sums in binary32.
    const TOLERANCE: f64 = 2.0e-4;

    #[test]
    fn scales_agree_with_the_definition_on_dirty_scratch() {
        for (channels, hidden, rows, cols) in [(1, 1, 1, 1), (4, 2, 3, 5), (16, 1, 20, 48), (32, 2, 40, 41)] {
            let mut noise = Noise(2);
            let input = noise.halves(channels * rows * cols, 4.0);
            let input: Vec<_> = input.into_iter().map(|x| f16::from_f32(x.to_f32() + 1.0)).collect();
            let [squeeze, excite] = [(); 2].map(|()| noise.halves(channels * hidden, 1.0));
            let (squeeze_bias, excite_bias) = (noise.halves(hidden, 0.5), noise.halves(channels, 1.0));
            let parameters = Parameters {
                squeeze: &squeeze,
                squeeze_bias: &squeeze_bias,
                excite: &excite,
                excite_bias: &excite_bias,
            };
            let plan = ChannelAttention { channels, hidden, rows, cols };
            let mut scratch = vec![f32::NAN; plan.scratch_len()];
            let mut scale = vec![f32::NAN; channels];
            let tensor = Chw::new(&input, channels, rows, cols).unwrap();
            plan.process(Simd::detect(), parameters, tensor, &mut scale, &mut scratch).unwrap();
            let expected = naive::attention(
                &Tensor::new([channels, rows, cols], wide(&input)),
                [&wide(&squeeze), &wide(&squeeze_bias)],
                [&wide(&excite), &wide(&excite_bias)],
            );
            for (found, expected) in scale.iter().zip(expected) {
                assert!((f64::from(*found) - expected).abs() < TOLERANCE, "{channels}: {found} {expected}");
            }
            let mut portable = vec![f32::NAN; channels];
            plan.process(Simd::PORTABLE, parameters, tensor, &mut portable, &mut scratch).unwrap();
            assert_eq!(portable, scale, "vectors changed a bit");
        }
    }
}
