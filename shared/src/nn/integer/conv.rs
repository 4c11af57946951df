//! The 3x3 convolution in integers, in bands of rows as that of [halves](crate::nn::conv).

use super::feature::Feature;
use super::packed::{self, OUTPUTS};
use super::rescale::{accumulate_row, rescale_row};
use super::weights::{Channel, Convolution};
use crate::image::{Chw, ChwMut};
use crate::nn::activation::Activation;
use crate::nn::conv::{Conv3x3, Store, Tensors};
use crate::nn::error::{NnError, check_scratch, check_weights};
use crate::nn::packed::{padded, pitch};
use crate::num::f16;
use crate::num::simd::{Kernel, Simd, Vector};

/// Length of scratch for bands of `band` rows, numbers of 32 bits. With bands of 1 row it is what [`process`] needs at
/// least.
pub const fn scratch_len(conv: &Conv3x3, band: usize) -> usize {
    fixed_len(conv) + (band + 2) * packed::slot_room(conv.inputs, conv.cols) / 2
}

const fn fixed_len(conv: &Conv3x3) -> usize {
    packed::packed_room(conv.inputs) / 2 + packed::sums_len(conv.cols)
}

/// Computes a convolution with the activation `Linear` or `Relu`. Numbers of the input of the network are multiplied by
/// `input_scale`, a power of two.
///
/// # Errors
/// [`NnError::Activation`] where the activation is another one; [`NnError::Shape`], [`NnError::Weights`] or
/// [`NnError::Scratch`] where an argument does not fit the plan. Nothing is written then.
pub fn process<F: Feature>(
    conv: &Conv3x3,
    simd: Simd,
    weights: Convolution<'_>,
    input_scale: f32,
    tensors: Tensors<'_, F>,
    scratch: &mut [f32],
) -> Result<(), NnError> {
    if conv.activation == Activation::Sigmoid {
        return Err(NnError::Activation);
    }
    check_weights(conv.weights_len(), weights.weights.len())?;
    check_weights(conv.outputs, weights.channels.len())?;
    conv.check_tensors(&tensors)?;
    check_scratch(scratch_len(conv, 1), scratch.len())?;
    let conv = *conv;
    match tensors {
        Tensors::Unshuffled { input, output } => {
            simd.run(Job { conv, weights, layer: Head { input, output, scale: input_scale }, scratch });
        }
        Tensors::Apart { input, output } => simd.run(Job { conv, weights, layer: Apart { input, output }, scratch }),
        Tensors::InPlace(tensor) => simd.run(Job { conv, weights, layer: InPlace(tensor), scratch }),
    }
    Ok(())
}

/// What a convolution reads and writes.
trait Layer {
    /// What the inner loops read.
    type Input: Feature;
    /// What is stored.
    type Output: Feature;

    /// Writes a row of an input channel into a slot.
    fn load(&self, conv: &Conv3x3, channel: usize, row: usize, to: &mut [<Self::Input as Feature>::Slot]);

    /// A row of an output channel.
    fn output_row(&mut self, channel: usize, row: usize) -> &mut [Self::Output];
}

/// From the input of the network, whose numbers have 16 bits whatever the features have.
struct Head<'a, F> {
    input: Chw<'a, f16>,
    output: ChwMut<'a, F>,
    scale: f32,
}

impl<F: Feature> Layer for Head<'_, F> {
    type Input = i16;
    type Output = F;

    #[inline(always)]
    fn load(&self, conv: &Conv3x3, channel: usize, row: usize, to: &mut [<i16 as Feature>::Slot]) {
        let from = self.input.row(channel / 4, 2 * row + channel / 2 % 2);
        packed::put_halves(to, conv.cols, channel, channel % 2 == 1, from, self.scale);
    }

    #[inline(always)]
    fn output_row(&mut self, channel: usize, row: usize) -> &mut [F] {
        self.output.row_mut(channel, row)
    }
}

struct Apart<'a, F> {
    input: Chw<'a, F>,
    output: ChwMut<'a, F>,
}

impl<F: Feature> Layer for Apart<'_, F> {
    type Input = F;
    type Output = F;

    #[inline(always)]
    fn load(&self, conv: &Conv3x3, channel: usize, row: usize, to: &mut [F::Slot]) {
        packed::put_row(to, conv.cols, channel, self.input.row(channel, row));
    }

    #[inline(always)]
    fn output_row(&mut self, channel: usize, row: usize) -> &mut [F] {
        self.output.row_mut(channel, row)
    }
}

struct InPlace<'a, F>(ChwMut<'a, F>);

impl<F: Feature> Layer for InPlace<'_, F> {
    type Input = F;
    type Output = F;

    #[inline(always)]
    fn load(&self, conv: &Conv3x3, channel: usize, row: usize, to: &mut [F::Slot]) {
        packed::put_row(to, conv.cols, channel, self.0.as_chw().row(channel, row));
    }

    #[inline(always)]
    fn output_row(&mut self, channel: usize, row: usize) -> &mut [F] {
        self.0.row_mut(channel, row)
    }
}

struct Job<'a, L> {
    conv: Conv3x3,
    weights: Convolution<'a>,
    layer: L,
    scratch: &'a mut [f32],
}

impl<L: Layer> Kernel for Job<'_, L> {
    type Output = ();

    #[inline(always)]
    fn run<V: Vector>(self) {
        let Self { conv, weights, mut layer, scratch } = self;
        let (packed, scratch) = scratch.split_at_mut(packed::packed_room(conv.inputs) / 2);
        let (sums, scratch) = scratch.split_at_mut(packed::sums_len(conv.cols));
        let (packed, slots) = (bytemuck::cast_slice_mut(packed), bytemuck::cast_slice_mut(scratch));
        let sums = bytemuck::cast_slice_mut(sums);
        let slot_len = packed::slot_len::<L::Input>(conv.inputs, conv.cols);
        let band = (slots.len() / slot_len - 2).min(conv.rows);
        let slots = &mut slots[..(band + 2) * slot_len];
        for start in (0..conv.rows).step_by(band) {
            let height = band.min(conv.rows - start);
            fill(&conv, &layer, start, height, slots);
            for first in (0..conv.outputs).step_by(OUTPUTS) {
                let packed = packed::pack::<L::Input>(weights.weights, conv.inputs, first, packed);
                let block = packed::block(weights.channels, first);
                for row in 0..height {
                    let input = &slots[row * slot_len..][..3 * slot_len];
                    packed::row::<L::Input, V>(input, conv.cols, packed, block, sums);
                    for (o, (sums, channel)) in sums.chunks_exact(padded(conv.cols)).zip(block).enumerate() {
                        finish(&conv, &sums[..conv.cols], *channel, layer.output_row(first + o, start + row));
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
fn fill<L: Layer>(conv: &Conv3x3, layer: &L, start: usize, height: usize, slots: &mut [<L::Input as Feature>::Slot]) {
    let len = packed::slot_len::<L::Input>(conv.inputs, conv.cols);
    let known = if start == 0 {
        // Padding is written here only: every other row is written to the same columns.
        packed::clear_borders::<L::Input>(slots, conv.cols);
        slots[..len].fill(0.into());
        1
    } else {
        let band = slots.len() / len - 2;
        slots.copy_within(band * len.., 0);
        2
    };
    for (slot, to) in slots.chunks_exact_mut(len).enumerate().take(height + 2).skip(known) {
        let row = start + slot - 1;
        if row == conv.rows {
            to.fill(0.into());
            continue;
        }
        (0..conv.inputs).for_each(|channel| layer.load(conv, channel, row, to));
    }
}

/// Rescales a row of sums, and applies activation and skip connection.
#[cfg_attr(target_arch = "arm", inline(never))]
#[cfg_attr(not(target_arch = "arm"), inline(always))]
fn finish<F: Feature>(conv: &Conv3x3, sums: &[i32], Channel { multiplier, .. }: Channel, to: &mut [F]) {
    match (conv.activation, conv.store) {
        (Activation::Relu, Store::Replace) => rescale_row::<F, 0>(sums, multiplier, to),
        (Activation::Relu, Store::Accumulate) => accumulate_row::<F, 0>(sums, multiplier, to),
        (_, Store::Replace) => rescale_row::<F, { i32::MIN }>(sums, multiplier, to),
        (_, Store::Accumulate) => accumulate_row::<F, { i32::MIN }>(sums, multiplier, to),
    }
}

const _: () = assert!(pitch(1).is_multiple_of(2), "slots are whole numbers of 32 bits");
