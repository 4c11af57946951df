//! The inner loops of the 3x3 convolution: widened rows, packed weights, blocks of output channels and columns in
//! registers.
//!
//! What works on a whole row is a function of its own on Arm, where the program must stay small, and inlined elsewhere,
//! where it is compiled for each instruction set ([`crate::num::simd`]).

#[cfg(all(target_arch = "arm", feature = "fpv4"))]
use crate::num::arm;
use crate::num::{f16, simd::Vector, widen, widen_slice};

/// Output channels that are computed in one pass over the rows.
pub(super) const OUTPUTS: usize = 4;
/// Rows are padded to a multiple of the widest block of columns of any target, so that the memory plan is the same on
/// all of them.
pub(super) const COLUMNS: usize = 16;

/// Columns rounded up to whole blocks.
pub(super) const fn padded(cols: usize) -> usize {
    cols.next_multiple_of(COLUMNS)
}

/// Distance between widened rows: the columns and one zero on either side.
pub(super) const fn pitch(cols: usize) -> usize {
    padded(cols) + 2
}

/// Output channels in a block. A single one is not padded to four.
pub(super) const fn block(outputs: usize) -> usize {
    if outputs == 1 { 1 } else { OUTPUTS }
}

/// Length of the packed weights of one block and of one output channel before it is packed, numbers.
pub(super) const fn packed_len(inputs: usize, outputs: usize) -> usize {
    inputs * 9 * (block(outputs) + 1)
}

/// Packs the weights `[out, in, 3, 3]` of the output channels from `first` on as `[in, 3, 3, block]`, zeros beyond the
/// last. Returns the packed weights. The rest of `packed` is scratch.
#[cfg_attr(target_arch = "arm", inline(never))]
#[cfg_attr(not(target_arch = "arm"), inline(always))]
pub(super) fn pack<'a>(
    weights: &[f16],
    inputs: usize,
    outputs: usize,
    first: usize,
    packed: &'a mut [f32],
) -> &'a [f32] {
    let (len, block) = (inputs * 9, block(outputs));
    let (packed, channel) = packed.split_at_mut(len * block);
    for o in 0..block {
        match weights.get((first + o) * len..(first + o + 1) * len) {
            Some(weights) => widen_slice(weights, &mut channel[..len]),
            None => channel[..len].fill(0.0),
        }
        for (slot, &weight) in packed.chunks_exact_mut(block).zip(&*channel) {
            slot[o] = weight;
        }
    }
    packed
}

/// Biases of the output channels from `first` on, zeros beyond the last.
#[inline(always)]
pub(super) fn bias(bias: &[f16], first: usize) -> [f32; OUTPUTS] {
    core::array::from_fn(|o| bias.get(first + o).map_or(0.0, |&b| widen(b)))
}

/// One row of a block of output channels: `sums` (block, padded columns) from three rows of all input channels
/// `[3, in, pitch]`.
///
/// Each sum starts at the bias and runs over (input channel, ky, kx) in this order.
#[cfg_attr(target_arch = "arm", inline(never))]
#[cfg_attr(not(target_arch = "arm"), inline(always))]
pub(super) fn row<V: Vector>(
    input: &[f32],
    inputs: usize,
    outputs: usize,
    cols: usize,
    weights: &[f32],
    bias: [f32; OUTPUTS],
    sums: &mut [f32],
) {
    if block(outputs) == 1 {
        blocks::<V, 1>(input, inputs, cols, weights, bias, sums);
    } else {
        blocks::<V, OUTPUTS>(input, inputs, cols, weights, bias, sums);
    }
}

#[inline(always)]
fn blocks<V: Vector, const O: usize>(
    input: &[f32],
    inputs: usize,
    cols: usize,
    weights: &[f32],
    bias: [f32; OUTPUTS],
    sums: &mut [f32],
) {
    let (padded, pitch) = (padded(cols), pitch(cols));
    #[cfg(all(target_arch = "arm", feature = "fpv4"))]
    if inputs > 0 {
        let rows = arm::Rows { input, pitch, weights };
        if O == OUTPUTS {
            arm::correlate4(rows, cols, bias, sums, padded);
        } else {
            arm::correlate1(rows, cols, bias[0], sums, padded);
        }
        return;
    }
    for x in (0..cols).step_by(2 * V::LEN) {
        let mut acc: [[V; 2]; O] = core::array::from_fn(|o| [V::splat(bias[o]); 2]);
        for (channel, weights) in weights.chunks_exact(9 * O).enumerate() {
            for (ky, weights) in weights.chunks_exact(3 * O).enumerate() {
                let row = &input[(ky * inputs + channel) * pitch + x..][..2 * V::LEN + 2];
                taps(row, weights, &mut acc);
            }
        }
        for (o, acc) in acc.iter().enumerate() {
            let sums = &mut sums[o * padded + x..][..2 * V::LEN];
            acc[0].store(sums);
            acc[1].store(&mut sums[V::LEN..]);
        }
    }
}

/// The three taps of one kernel row. Both factors are widened halves: the products are exact.
#[inline(always)]
fn taps<V: Vector, const O: usize>(row: &[f32], weights: &[f32], acc: &mut [[V; 2]; O]) {
    for (kx, weights) in weights.chunks_exact(O).enumerate() {
        let x = [V::load(&row[kx..]), V::load(&row[kx + V::LEN..])];
        for (acc, &weight) in acc.iter_mut().zip(weights) {
            let weight = V::splat(weight);
            *acc = [acc[0].add_exact(x[0], weight), acc[1].add_exact(x[1], weight)];
        }
    }
}
