//! The end of the network in integers: `sigmoid(conv2(pixel_shuffle(conv(y))))`, in bands as that of
//! [halves](crate::nn::upscale).

use super::feature::Feature;
use super::packed::{self, OUTPUTS};
use super::weights::Convolution;
use crate::image::{Chw, PlaneMut};
use crate::nn::activation::Activation;
use crate::nn::error::{NnError, check_scratch, check_shape, check_weights};
use crate::nn::packed::padded;
use crate::nn::pixel_shuffle::shuffled;
use crate::nn::upscale::Upscale;
use crate::num::narrow_slice;
use crate::num::simd::{Kernel, Simd, Vector};

/// Weights of the two convolutions, and what a unit of the last sum is worth.
#[derive(Clone, Copy, Debug)]
pub struct Last<'a> {
    /// W -> 4 W, and W -> 1, whose multiplier is not used.
    pub convolutions: [Convolution<'a>; 2],
    /// Argument of the logistic function for a sum of 1.
    pub unit: f32,
}

/// Length of scratch for bands of `band` feature rows, numbers of 32 bits. With bands of 1 row it is what [`process`]
/// needs at least.
pub const fn scratch_len(plan: &Upscale, band: usize) -> usize {
    fixed_len(plan) + band * row_len(plan)
}

/// Length of a feature row, numbers of 32 bits.
const fn coarse_len(plan: &Upscale) -> usize {
    packed::slot_room(plan.channels, plan.cols) / 2
}

/// Length of a row at full resolution, numbers of 32 bits.
const fn fine_len(plan: &Upscale) -> usize {
    packed::slot_room(plan.channels, 2 * plan.cols) / 2
}

const fn fixed_len(plan: &Upscale) -> usize {
    let sums = packed::sums_len(plan.cols) + packed::sums_len(2 * plan.cols);
    packed::packed_room(plan.channels) + sums + 2 * coarse_len(plan) + 3 * fine_len(plan)
}

const fn row_len(plan: &Upscale) -> usize {
    coarse_len(plan) + 2 * fine_len(plan)
}

/// Computes `output`, the part of the result (2 rows, 2 cols) that begins at pixel `origin` (row, column), 0 to 1, from
/// `input` (channels, rows, cols).
///
/// # Errors
/// [`NnError::Shape`], [`NnError::Weights`] or [`NnError::Scratch`] where an argument does not fit the plan. Nothing is
/// written then.
pub fn process<F: Feature>(
    plan: &Upscale,
    simd: Simd,
    last: Last<'_>,
    input: Chw<'_, F>,
    origin: [usize; 2],
    output: PlaneMut<'_, crate::num::f16>,
    scratch: &mut [f32],
) -> Result<(), NnError> {
    check_shape([plan.channels, plan.rows, plan.cols], input.shape())?;
    plan.check_output(origin, &output)?;
    for (convolution, outputs) in last.convolutions.iter().zip([4 * plan.channels, 1]) {
        check_weights(9 * plan.channels * outputs, convolution.weights.len())?;
        check_weights(outputs, convolution.channels.len())?;
    }
    check_scratch(scratch_len(plan, 1), scratch.len())?;
    simd.run(Job { plan: *plan, last, input, origin, output, scratch });
    Ok(())
}

struct Job<'a, F> {
    plan: Upscale,
    last: Last<'a>,
    input: Chw<'a, F>,
    origin: [usize; 2],
    output: PlaneMut<'a, crate::num::f16>,
    scratch: &'a mut [f32],
}

impl<F: Feature> Kernel for Job<'_, F> {
    type Output = ();

    #[inline(always)]
    fn run<V: Vector>(self) {
        let Self { plan, last: Last { convolutions: [conv, conv2], unit }, input, origin, mut output, scratch } = self;
        let [top, left] = origin;
        let band = ((scratch.len() - fixed_len(&plan)) / row_len(&plan)).min(plan.rows);
        let (packed, scratch) = scratch.split_at_mut(packed::packed_room(plan.channels) / 2);
        let (packed2, scratch) = scratch.split_at_mut(packed::packed_room(plan.channels) / 2);
        let (sums, scratch) = scratch.split_at_mut(packed::sums_len(plan.cols));
        let (sums2, scratch) = scratch.split_at_mut(packed::sums_len(2 * plan.cols));
        let (coarse, scratch) = scratch.split_at_mut((band + 2) * coarse_len(&plan));
        let fine = &mut scratch[..(2 * band + 3) * fine_len(&plan)];
        let [packed, packed2, coarse, fine] =
            [packed, packed2, coarse, fine].map(bytemuck::cast_slice_mut::<_, F::Slot>);
        let [sums, sums2] = [sums, sums2].map(bytemuck::cast_slice_mut::<_, i32>);
        let len = |cols| packed::slot_len::<F>(plan.channels, cols);
        let (coarse_len, fine_len) = (len(plan.cols), len(2 * plan.cols));
        let wanted = top..top + output.rows();
        // Feature rows that the wanted rows depend on.
        let coarse_wanted = top.saturating_sub(1) / 2..wanted.end / 2 + 1;
        let packed2 = packed::pack::<F>(conv2.weights, plan.channels, 0, packed2);
        let block2 = packed::block(conv2.channels, 0);
        packed::clear_borders::<F>(fine, 2 * plan.cols);
        packed::clear_borders::<F>(coarse, plan.cols);
        for start in (0..plan.rows).step_by(band) {
            let height = band.min(plan.rows - start);
            fill(&plan, input, start, height, coarse);
            if start == 0 {
                // The row before the first.
                fine[fine_len..2 * fine_len].fill(0.into());
            } else {
                fine.copy_within(2 * band * fine_len..(2 * band + 2) * fine_len, 0);
            }
            for first in (0..4 * plan.channels).step_by(OUTPUTS) {
                let packed = packed::pack::<F>(conv.weights, plan.channels, first, packed);
                let block = packed::block(conv.channels, first);
                for row in (0..height).filter(|row| coarse_wanted.contains(&(start + row))) {
                    let input = &coarse[row * coarse_len..][..3 * coarse_len];
                    packed::row::<F, V>(input, plan.cols, packed, block, sums);
                    // The two channels of a block lie side by side in a row.
                    for (o, (sums, channel)) in sums.chunks_exact(padded(plan.cols)).zip(block).enumerate() {
                        let (to, row, first) = shuffled(first + o, row);
                        // Slots 0 and 1 hold the last two rows of the band before.
                        let slot = &mut fine[(row + 2) * fine_len..][..fine_len];
                        packed::put_rescaled::<F>(
                            slot,
                            2 * plan.cols,
                            to,
                            first,
                            &sums[..plan.cols],
                            channel.multiplier,
                        );
                    }
                }
            }
            let end = start + height == plan.rows;
            if end {
                fine[(2 * height + 2) * fine_len..][..fine_len].fill(0.into());
            }
            let rows = (2 * start).saturating_sub(1)..2 * (start + height) - usize::from(!end);
            for row in rows.start.max(wanted.start)..rows.end.min(wanted.end) {
                let input = &fine[(row + 1 - 2 * start) * fine_len..][..3 * fine_len];
                packed::row::<F, V>(input, 2 * plan.cols, packed2, block2, sums2);
                let to = output.row_mut(row - top);
                let sums = &mut sums2[left..left + to.len()];
                sums.iter_mut().for_each(|sum| *sum = (*sum as f32 * unit).to_bits() as i32);
                let sums: &mut [f32] = bytemuck::cast_slice_mut(sums);
                Activation::Sigmoid.apply(sums);
                narrow_slice(sums, to);
            }
        }
    }
}

/// Fills the slots with feature rows start - 1..=start + height, zeros outside the frame.
#[cfg_attr(target_arch = "arm", inline(never))]
#[cfg_attr(not(target_arch = "arm"), inline(always))]
fn fill<F: Feature>(plan: &Upscale, input: Chw<'_, F>, start: usize, height: usize, slots: &mut [F::Slot]) {
    let slots = slots.chunks_exact_mut(packed::slot_len::<F>(plan.channels, plan.cols)).take(height + 2);
    for (slot, to) in slots.enumerate() {
        let row = start + slot;
        if row == 0 || row > plan.rows {
            to.fill(0.into());
            continue;
        }
        for channel in 0..plan.channels {
            packed::put_row(to, plan.cols, channel, input.row(channel, row - 1));
        }
    }
}
