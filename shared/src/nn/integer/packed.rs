//! The inner loops of the integer convolution: rows of groups of channels, packed weights, blocks of two output
//! channels or of one.
//!
//! The rows of a band are kept as `[row, group, column, channel of the group]`, so that one instruction multiplies all
//! channels of a group and adds the products. The channels are padded to a multiple of [`CHANNELS`] on every target, so
//! that the memory plan is the same on all of them.

#[cfg(all(target_arch = "arm", feature = "helium"))]
use super::rescale::fixed_scale;
use super::rescale::{done_in_helium, from_half, rescale, saturate};
use super::weights::Channel;
use crate::nn::packed::{padded, pitch};
#[cfg(all(target_arch = "arm", feature = "fpv4"))]
use crate::num::arm;
#[cfg(all(target_arch = "arm", feature = "helium"))]
use crate::num::arm::helium;
use crate::num::f16;
#[cfg(not(all(target_arch = "arm", feature = "fpv4")))]
use crate::num::simd::PairSums;
use crate::num::simd::Vector;

/// Channels of a group: eight, as Helium's `VMLADAVA` multiplies, or two, as `SMLAD` and `PMADDWD` do.
pub(super) const GROUP: usize = if cfg!(all(target_arch = "arm", feature = "helium")) { 8 } else { 2 };
/// Input channels are padded to a multiple of this, the largest group of any target.
const CHANNELS: usize = 8;
/// Output channels of a block. The last block has one where the number of channels is odd.
pub(super) const OUTPUTS: usize = 2;

/// Input channels with their padding.
pub(super) const fn channels(inputs: usize) -> usize {
    inputs.next_multiple_of(CHANNELS)
}

/// Length of the packed weights of a block of output channels, integers of 16 bits.
pub(super) const fn packed_len(inputs: usize) -> usize {
    channels(inputs) * 9 * OUTPUTS
}

/// Length of one row of all input channels, integers of 16 bits.
pub(super) const fn slot_len(inputs: usize, cols: usize) -> usize {
    channels(inputs) * pitch(cols)
}

/// Length of the sums of a row of a block of output channels.
pub(super) const fn sums_len(cols: usize) -> usize {
    OUTPUTS * padded(cols)
}

/// Packs the weights `[out, in, 3, 3]` of the one or two output channels from `first` on as
/// `[3, group, 3, out, channel of the group]`, zeros beyond the last input channel. Returns the packed weights.
#[cfg_attr(target_arch = "arm", inline(never))]
#[cfg_attr(not(target_arch = "arm"), inline(always))]
pub(super) fn pack<'p>(weights: &[i8], inputs: usize, first: usize, packed: &'p mut [i16]) -> &'p [i16] {
    let outputs = weights.chunks_exact(inputs * 9).skip(first).take(OUTPUTS);
    let (count, groups) = (outputs.len(), channels(inputs) / GROUP);
    let packed = &mut packed[..groups * GROUP * 9 * count];
    packed.fill(0);
    for (o, weights) in outputs.enumerate() {
        for (i, taps) in weights.as_chunks::<9>().0.iter().enumerate() {
            for (ky, taps) in taps.as_chunks::<3>().0.iter().enumerate() {
                let at = ((ky * groups + i / GROUP) * 3 * count + o) * GROUP + i % GROUP;
                for (kx, &weight) in taps.iter().enumerate() {
                    packed[at + kx * count * GROUP] = weight.into();
                }
            }
        }
    }
    packed
}

/// Biases and multipliers of the one or two output channels from `first` on.
#[inline(always)]
pub(super) fn block(channels: &[Channel], first: usize) -> &[Channel] {
    &channels[first..channels.len().min(first + OUTPUTS)]
}

/// The numbers of one channel in a slot, from column `first` of the padded row on. Its columns begin `GROUP` apart.
#[inline(always)]
fn channel_of(slot: &mut [i16], cols: usize, channel: usize, first: usize) -> &mut [i16] {
    let row = &mut slot[channel / GROUP * pitch(cols) * GROUP..][..pitch(cols) * GROUP];
    &mut row[first * GROUP..]
}

/// Zeroes the columns beside the frame in slots. All other padding may hold anything: its weights are zero, or its sums
/// are not used.
pub(super) fn clear_borders(slots: &mut [i16], cols: usize) {
    for row in slots.chunks_exact_mut(pitch(cols) * GROUP) {
        let columns = row.as_chunks_mut::<GROUP>().0;
        columns[0] = [0; GROUP];
        columns[cols + 1] = [0; GROUP];
    }
}

/// Writes every other half of a row of the input of the network, from the first or the second on, into a slot.
#[cfg_attr(target_arch = "arm", inline(never))]
#[cfg_attr(not(target_arch = "arm"), inline(always))]
pub(super) fn put_halves(slot: &mut [i16], cols: usize, channel: usize, odd: bool, from: &[f16], scale: f32) {
    let place = channel % GROUP;
    let done =
        done_in_helium!(spread_halves(from, odd, fixed_scale(scale), &mut channel_of(slot, cols, channel, 1)[place..]));
    let columns = channel_of(slot, cols, channel, 1 + done).as_chunks_mut::<GROUP>().0;
    for (to, pair) in columns.iter_mut().zip(&from.as_chunks::<2>().0[done..]) {
        to[place] = from_half(pair[usize::from(odd)], scale);
    }
}

/// Writes the numbers of channel `channel` into a slot.
#[cfg_attr(target_arch = "arm", inline(never))]
#[cfg_attr(not(target_arch = "arm"), inline(always))]
pub(super) fn put_row(slot: &mut [i16], cols: usize, channel: usize, from: &[i16]) {
    let done = done_in_helium!(spread(from, &mut channel_of(slot, cols, channel, 1)[channel % GROUP..]));
    let columns = channel_of(slot, cols, channel, 1 + done).as_chunks_mut::<GROUP>().0;
    for (to, &x) in columns.iter_mut().zip(&from[done..]) {
        to[channel % GROUP] = x;
    }
}

/// Writes rescaled sums into every other column of a slot, from column `first` (0 or 1) on.
#[cfg_attr(target_arch = "arm", inline(never))]
#[cfg_attr(not(target_arch = "arm"), inline(always))]
pub(super) fn put_rescaled(slot: &mut [i16], cols: usize, channel: usize, first: usize, sums: &[i32], multiplier: i32) {
    let start = 1 + first;
    let done = done_in_helium!(spread_rescaled(
        sums,
        multiplier,
        &mut channel_of(slot, cols, channel, start)[channel % GROUP..]
    ));
    let columns = channel_of(slot, cols, channel, start + 2 * done).as_chunks_mut::<{ 2 * GROUP }>().0;
    for (to, &sum) in columns.iter_mut().zip(&sums[done..]) {
        to[channel % GROUP] = saturate(rescale(sum, multiplier));
    }
}

/// One row of a block of output channels: `sums` (1 or 2, padded columns) from three rows of all input channels.
#[cfg_attr(target_arch = "arm", inline(never))]
#[cfg_attr(not(target_arch = "arm"), inline(always))]
#[cfg_attr(
    all(target_arch = "arm", feature = "fpv4"),
    expect(
        clippy::extra_unused_type_parameters,
        reason = "loops in instructions of the core choose their own vectors"
    )
)]
pub(super) fn row<V: Vector>(input: &[i16], cols: usize, weights: &[i16], block: &[Channel], sums: &mut [i32]) {
    #[cfg(all(target_arch = "arm", feature = "fpv4"))]
    {
        let rows = arm::Groups { input, pitch: pitch(cols), weights };
        match *block {
            [a, b] => arm::correlate_groups2(rows, cols, [a.bias, b.bias], sums, padded(cols)),
            [a] => arm::correlate_groups1(rows, cols, a.bias, sums, padded(cols)),
            _ => {}
        }
    }
    #[cfg(not(all(target_arch = "arm", feature = "fpv4")))]
    match *block {
        [a, b] => pairs::<V, 2>(input, cols, weights, [a, b], sums),
        [a] => pairs::<V, 1>(input, cols, weights, [a], sums),
        _ => {}
    }
}

/// The same in portable loops, where groups are pairs.
#[cfg(not(all(target_arch = "arm", feature = "fpv4")))]
#[inline(always)]
fn pairs<V: Vector, const O: usize>(
    input: &[i16],
    cols: usize,
    weights: &[i16],
    block: [Channel; O],
    sums: &mut [i32],
) {
    let (width, len) = (pitch(cols) * GROUP, V::Sums::LEN);
    for x in (0..cols).step_by(2 * len) {
        let mut acc: [[V::Sums; 2]; O] = core::array::from_fn(|o| [V::Sums::splat(block[o].bias); 2]);
        // One kernel row of one group.
        for (weights, row) in weights.chunks_exact(3 * O * GROUP).zip(input.chunks_exact(width)) {
            let row = &row[x * GROUP..][..(2 * len + 2) * GROUP];
            for (kx, weights) in weights.chunks_exact(O * GROUP).enumerate() {
                let x = [&row[kx * GROUP..], &row[(kx + len) * GROUP..]];
                for (acc, weights) in acc.iter_mut().zip(weights.as_chunks::<GROUP>().0) {
                    *acc = [acc[0].add_pairs(x[0], *weights), acc[1].add_pairs(x[1], *weights)];
                }
            }
        }
        for (o, acc) in acc.iter().enumerate() {
            let sums = &mut sums[o * padded(cols) + x..][..2 * len];
            acc[0].store(sums);
            acc[1].store(&mut sums[len..]);
        }
    }
}
