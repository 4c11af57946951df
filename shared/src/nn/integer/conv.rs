//! The 3x3 convolution in integers, in bands of rows as that of [halves](crate::nn::conv).

use super::packed::{self, OUTPUTS};
use super::rescale::{accumulate_row, rescale_row};
use super::weights::{Channel, Convolution};
use crate::nn::activation::Activation;
use crate::nn::conv::{Conv3x3, Store, Tensors};
use crate::nn::error::{NnError, check_scratch, check_weights};
use crate::nn::packed::{padded, pitch};
use crate::num::simd::{Kernel, Simd, Vector};

/// Length of scratch for bands of `band` rows, numbers of 32 bits. With bands of 1 row it is what [`process`] needs at
/// least.
pub const fn scratch_len(conv: &Conv3x3, band: usize) -> usize {
    fixed_len(conv) + (band + 2) * packed::slot_len(conv.inputs, conv.cols) / 2
}

const fn fixed_len(conv: &Conv3x3) -> usize {
    packed::packed_len(conv.inputs) / 2 + packed::sums_len(conv.cols)
}

/// Computes a convolution with the activation `Linear` or `Relu`. Numbers of the input of the network are multiplied by
/// `input_scale`, a power of two.
///
/// # Errors
/// [`NnError::Activation`] where the activation is another one; [`NnError::Shape`], [`NnError::Weights`] or
/// [`NnError::Scratch`] where an argument does not fit the plan. Nothing is written then.
pub fn process(
    conv: &Conv3x3,
    simd: Simd,
    weights: Convolution<'_>,
    input_scale: f32,
    tensors: Tensors<'_, i16>,
    scratch: &mut [f32],
) -> Result<(), NnError> {
    if conv.activation == Activation::Sigmoid {
        return Err(NnError::Activation);
    }
    check_weights(conv.weights_len(), weights.weights.len())?;
    check_weights(conv.outputs, weights.channels.len())?;
    conv.check_tensors(&tensors)?;
    check_scratch(scratch_len(conv, 1), scratch.len())?;
    simd.run(Job { conv: *conv, weights, input_scale, tensors, scratch });
    Ok(())
}

struct Job<'a> {
    conv: Conv3x3,
    weights: Convolution<'a>,
    input_scale: f32,
    tensors: Tensors<'a, i16>,
    scratch: &'a mut [f32],
}

impl Kernel for Job<'_> {
    type Output = ();

    #[inline(always)]
    fn run<V: Vector>(self) {
        let Self { conv, weights, input_scale, mut tensors, scratch } = self;
        let (packed, scratch) = scratch.split_at_mut(packed::packed_len(conv.inputs) / 2);
        let (sums, scratch) = scratch.split_at_mut(packed::sums_len(conv.cols));
        let (packed, slots) = (bytemuck::cast_slice_mut(packed), bytemuck::cast_slice_mut(scratch));
        let sums = bytemuck::cast_slice_mut(sums);
        let slot_len = packed::slot_len(conv.inputs, conv.cols);
        let band = (slots.len() / slot_len - 2).min(conv.rows);
        let slots = &mut slots[..(band + 2) * slot_len];
        for start in (0..conv.rows).step_by(band) {
            let height = band.min(conv.rows - start);
            fill(&conv, &tensors, input_scale, start, height, slots);
            for first in (0..conv.outputs).step_by(OUTPUTS) {
                let packed = packed::pack(weights.weights, conv.inputs, first, packed);
                let block = packed::block(weights.channels, first);
                for row in 0..height {
                    let input = &slots[row * slot_len..][..3 * slot_len];
                    packed::row::<V>(input, conv.cols, packed, block, sums);
                    for (o, (sums, channel)) in sums.chunks_exact(padded(conv.cols)).zip(block).enumerate() {
                        finish(&conv, &sums[..conv.cols], *channel, tensors.output_row(first + o, start + row));
                    }
                }
            }
        }
    }
}

/// Fills slots 0..height + 2 with rows start - 1..=start + height. The last two rows of the band before are moved and
/// not read again, as the output may have overwritten them.
#[cfg_attr(target_arch = "arm", inline(never))]
#[cfg_attr(not(target_arch = "arm"), inline(always))]
fn fill(conv: &Conv3x3, tensors: &Tensors<'_, i16>, input_scale: f32, start: usize, height: usize, slots: &mut [i16]) {
    let len = packed::slot_len(conv.inputs, conv.cols);
    let known = if start == 0 {
        // Padding is written here only: every other row is written to the same columns.
        packed::clear_borders(slots, conv.cols);
        slots[..len].fill(0);
        1
    } else {
        let band = slots.len() / len - 2;
        slots.copy_within(band * len.., 0);
        2
    };
    for (slot, to) in slots.chunks_exact_mut(len).enumerate().take(height + 2).skip(known) {
        let row = start + slot - 1;
        if row == conv.rows {
            to.fill(0);
            continue;
        }
        for channel in 0..conv.inputs {
            match tensors {
                Tensors::Unshuffled { input, .. } => {
                    let from = input.row(channel / 4, 2 * row + channel / 2 % 2);
                    packed::put_halves(to, conv.cols, channel, channel % 2 == 1, from, input_scale);
                }
                Tensors::Apart { input, .. } => {
                    packed::put_row(to, conv.cols, channel, input.row(channel, row));
                }
                Tensors::InPlace(tensor) => {
                    packed::put_row(to, conv.cols, channel, tensor.as_chw().row(channel, row));
                }
            }
        }
    }
}

/// Rescales a row of sums, and applies activation and skip connection.
#[cfg_attr(target_arch = "arm", inline(never))]
#[cfg_attr(not(target_arch = "arm"), inline(always))]
fn finish(conv: &Conv3x3, sums: &[i32], Channel { multiplier, .. }: Channel, to: &mut [i16]) {
    match (conv.activation, conv.store) {
        (Activation::Relu, Store::Replace) => rescale_row::<0>(sums, multiplier, to),
        (Activation::Relu, Store::Accumulate) => accumulate_row::<0>(sums, multiplier, to),
        (_, Store::Replace) => rescale_row::<{ i32::MIN }>(sums, multiplier, to),
        (_, Store::Accumulate) => accumulate_row::<{ i32::MIN }>(sums, multiplier, to),
    }
}

const _: () = assert!(pitch(1).is_multiple_of(2), "slots are whole numbers of 32 bits");
