//! 3x3 convolution (cross-correlation, as in PyTorch) with zero padding 1.
//!
//! `y[o][r][c] = f(b[o] + sum_{i, ky, kx} w[o][i][ky][kx] x[i][r + ky - 1][c + kx - 1])`, the sum in binary32, starting
//! from the bias, in the order (i, ky, kx), padding included as zeros; then the activation; then, with
//! [`Store::Accumulate`], the old value of y is added; then one rounding to half.
//!
//! The convolution works on bands of rows. The rows of a band and one on either side are widened to scratch once, so
//! the result may overwrite the input. The height of the band follows from the length of the scratch and does not
//! change a bit of the result.

use super::activation::Activation;
use super::error::{NnError, check_scratch, check_shape, check_weights};
use super::packed::{self, OUTPUTS};
use super::pixel_shuffle::widen_unshuffled_row;
use crate::image::{Chw, ChwMut};
use crate::num::simd::{Kernel, Simd, Vector};
use crate::num::{f16, fused, widen_slice};

/// How the output is stored.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Store {
    /// `y = f(conv(x))`.
    Replace,
    /// `y = y + f(conv(x))`: the skip connection.
    Accumulate,
}

/// Weights `[out, in, 3, 3]` and biases `[out]`.
#[derive(Clone, Copy, Debug)]
pub struct Parameters<'a> {
    /// Weights.
    pub weights: &'a [f16],
    /// Biases.
    pub bias: &'a [f16],
}

/// What a convolution reads and writes: features that are stored as `T`.
#[derive(Debug)]
pub enum Tensors<'a, T = f16> {
    /// The input is that of the network, read through [PixelUnshuffle 2](super::pixel_shuffle).
    Unshuffled {
        /// (inputs / 4, 2 rows, 2 cols), read as (inputs, rows, cols).
        input: Chw<'a, f16>,
        /// (outputs, rows, cols).
        output: ChwMut<'a, T>,
    },
    /// Input and output are different tensors.
    Apart {
        /// (inputs, rows, cols).
        input: Chw<'a, T>,
        /// (outputs, rows, cols).
        output: ChwMut<'a, T>,
    },
    /// The output overwrites the input. Their numbers of channels are equal.
    InPlace(ChwMut<'a, T>),
}

/// Plan of a 3x3 convolution.
#[derive(Clone, Copy, Debug)]
pub struct Conv3x3 {
    /// Input channels.
    pub inputs: usize,
    /// Output channels.
    pub outputs: usize,
    /// Rows of input and output.
    pub rows: usize,
    /// Columns of input and output.
    pub cols: usize,
    /// Activation.
    pub activation: Activation,
    /// How the output is stored.
    pub store: Store,
}

impl Conv3x3 {
    /// Length of the weights, halves.
    pub const fn weights_len(&self) -> usize {
        self.inputs * self.outputs * 9
    }

    /// Length of scratch for bands of `band` rows, numbers. With bands of 1 row it is what [`Self::process`] needs at
    /// least.
    pub const fn scratch_len(&self, band: usize) -> usize {
        let weights_and_sums =
            packed::packed_len(self.inputs, self.outputs) + packed::block(self.outputs) * packed::padded(self.cols);
        weights_and_sums + (band + 2) * self.slot_len()
    }

    /// Length of one widened row of all input channels.
    const fn slot_len(&self) -> usize {
        self.inputs * packed::pitch(self.cols)
    }

    /// Computes the convolution.
    ///
    /// # Errors
    /// [`NnError::Shape`], [`NnError::Weights`] or [`NnError::Scratch`] where an argument does not fit the plan.
    /// Nothing is written then.
    pub fn process(
        &self,
        simd: Simd,
        parameters: Parameters<'_>,
        tensors: Tensors<'_>,
        scratch: &mut [f32],
    ) -> Result<(), NnError> {
        self.check(parameters, &tensors, scratch.len())?;
        simd.run(Job { conv: *self, parameters, tensors, scratch });
        Ok(())
    }

    fn check(&self, parameters: Parameters<'_>, tensors: &Tensors<'_>, scratch: usize) -> Result<(), NnError> {
        check_weights(self.weights_len(), parameters.weights.len())?;
        check_weights(self.outputs, parameters.bias.len())?;
        self.check_tensors(tensors)?;
        check_scratch(self.scratch_len(1), scratch)
    }

    /// Checks that the tensors have the shapes of the plan.
    pub(super) fn check_tensors<T>(&self, tensors: &Tensors<'_, T>) -> Result<(), NnError> {
        let [input, output] = [self.inputs, self.outputs].map(|channels| [channels, self.rows, self.cols]);
        match tensors {
            Tensors::Unshuffled { input: found, output: to } => {
                check_shape([self.inputs / 4, self.rows * 2, self.cols * 2], found.shape())?;
                check_shape(output, to.shape())
            }
            Tensors::Apart { input: found, output: to } => {
                check_shape(input, found.shape())?;
                check_shape(output, to.shape())
            }
            Tensors::InPlace(tensor) => {
                check_shape(input, tensor.shape())?;
                check_shape(output, tensor.shape())
            }
        }
    }
}

struct Job<'a> {
    conv: Conv3x3,
    parameters: Parameters<'a>,
    tensors: Tensors<'a>,
    scratch: &'a mut [f32],
}

impl Kernel for Job<'_> {
    type Output = ();

    #[inline(always)]
    fn run<V: Vector>(self) {
        let Self { conv, parameters, mut tensors, scratch } = self;
        let (packed, scratch) = scratch.split_at_mut(packed::packed_len(conv.inputs, conv.outputs));
        let (sums, scratch) = scratch.split_at_mut(packed::block(conv.outputs) * packed::padded(conv.cols));
        let band = (scratch.len() / conv.slot_len() - 2).min(conv.rows);
        let slots = &mut scratch[..(band + 2) * conv.slot_len()];
        for start in (0..conv.rows).step_by(band) {
            let height = band.min(conv.rows - start);
            conv.widen(&tensors, start, height, band, slots);
            for first in (0..conv.outputs).step_by(OUTPUTS) {
                let weights = packed::pack(parameters.weights, conv.inputs, conv.outputs, first, packed);
                let bias = packed::bias(parameters.bias, first);
                for row in 0..height {
                    let input = &slots[row * conv.slot_len()..][..3 * conv.slot_len()];
                    packed::row::<V>(input, conv.inputs, conv.outputs, conv.cols, weights, bias, sums);
                    conv.finish(&mut tensors, first, start + row, sums);
                }
            }
        }
    }
}

impl Conv3x3 {
    /// Fills slots 0..height + 2 with rows start - 1..=start + height. The last two rows of the band before are moved
    /// and not read again, as the output may have overwritten them.
    #[cfg_attr(target_arch = "arm", inline(never))]
    #[cfg_attr(not(target_arch = "arm"), inline(always))]
    fn widen(&self, tensors: &Tensors<'_>, start: usize, height: usize, band: usize, slots: &mut [f32]) {
        let len = self.slot_len();
        let known = if start == 0 {
            slots[..len].fill(0.0);
            1
        } else {
            slots.copy_within(band * len.., 0);
            2
        };
        for (slot, to) in slots.chunks_exact_mut(len).enumerate().take(height + 2).skip(known) {
            let row = start + slot - 1;
            if row == self.rows {
                to.fill(0.0);
                continue;
            }
            for (channel, to) in to.chunks_exact_mut(packed::pitch(self.cols)).enumerate() {
                to[0] = 0.0;
                to[1 + self.cols..].fill(0.0);
                tensors.widen_row(channel, row, &mut to[1..1 + self.cols]);
            }
        }
    }

    /// Applies activation, skip connection and rounding to one row of a block of output channels.
    #[cfg_attr(target_arch = "arm", inline(never))]
    #[cfg_attr(not(target_arch = "arm"), inline(always))]
    fn finish(&self, tensors: &mut Tensors<'_>, first: usize, row: usize, sums: &mut [f32]) {
        let channels = sums.chunks_exact_mut(packed::padded(self.cols));
        for (o, sums) in channels.enumerate().take(self.outputs - first) {
            let sums = &mut sums[..self.cols];
            let to = tensors.output_row(first + o, row);
            if (self.activation, self.store) == (Activation::Relu, Store::Replace) {
                fused::narrow_relu(sums, to);
                continue;
            }
            self.activation.apply(sums);
            match self.store {
                Store::Replace => fused::narrow_bounded(sums, to),
                Store::Accumulate => fused::accumulate(sums, to),
            }
        }
    }
}

impl Tensors<'_> {
    #[inline(always)]
    fn widen_row(&self, channel: usize, row: usize, to: &mut [f32]) {
        match self {
            Self::Apart { input, .. } => widen_slice(input.row(channel, row), to),
            Self::Unshuffled { input, .. } => widen_unshuffled_row(*input, channel, row, to),
            Self::InPlace(tensor) => widen_slice(tensor.as_chw().row(channel, row), to),
        }
    }
}

impl<T> Tensors<'_, T> {
    /// A row of the output.
    #[inline(always)]
    pub(super) fn output_row(&mut self, channel: usize, row: usize) -> &mut [T] {
        match self {
            Self::Unshuffled { output, .. } | Self::Apart { output, .. } => output.row_mut(channel, row),
            Self::InPlace(tensor) => tensor.row_mut(channel, row),
        }
    }
}

#[cfg(test)]
mod tests;
