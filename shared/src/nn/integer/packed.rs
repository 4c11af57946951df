//! The inner loops of the integer convolution: rows of groups of channels, packed weights, blocks of two output
//! channels or of one.
//!
//! The rows of a band are kept as `[row, group, column, channel of the group]`, so that one instruction multiplies all
//! channels of a group and adds the products. The channels are padded to a multiple of [`CHANNELS`] on every target, so
//! that the memory plan is the same on all of them.

use super::feature::Feature;
#[cfg(all(target_arch = "arm", feature = "helium"))]
use super::rescale::fixed_scale;
use super::rescale::{done_in_helium, from_half, rescale};
use super::weights::Channel;
use crate::nn::packed::{padded, pitch};
#[cfg(all(target_arch = "arm", feature = "helium"))]
use crate::num::arm::helium;
use crate::num::f16;
use crate::num::simd::Vector;

/// Input channels are padded to a multiple of this, or of the group where that is larger.
const CHANNELS: usize = 8;
/// Output channels of a block. The last block has one where the number of channels is odd.
pub(super) const OUTPUTS: usize = 2;

/// Input channels with their padding.
const fn channels<F: Feature>(inputs: usize) -> usize {
    inputs.next_multiple_of(if F::GROUP > CHANNELS { F::GROUP } else { CHANNELS })
}

/// Room for the packed weights of a block of output channels, 16 bits each: enough for all kinds of features on all
/// targets, as groups of sixteen are of 8 bits.
pub(super) const fn packed_room(inputs: usize) -> usize {
    inputs.next_multiple_of(CHANNELS) * 9 * OUTPUTS
}

/// Room for one row of all input channels, 16 bits each, in the same sense.
pub(super) const fn slot_room(inputs: usize, cols: usize) -> usize {
    inputs.next_multiple_of(CHANNELS) * pitch(cols)
}

/// Length of one row of all input channels.
pub(super) const fn slot_len<F: Feature>(inputs: usize, cols: usize) -> usize {
    channels::<F>(inputs) * pitch(cols)
}

/// Length of the sums of a row of a block of output channels.
pub(super) const fn sums_len(cols: usize) -> usize {
    OUTPUTS * padded(cols)
}

/// Packs the weights `[out, in, 3, 3]` of the one or two output channels from `first` on as
/// `[3, group, 3, out, channel of the group]`, zeros beyond the last input channel. Returns the packed weights.
#[cfg_attr(target_arch = "arm", inline(never))]
#[cfg_attr(not(target_arch = "arm"), inline(always))]
pub(super) fn pack<'p, F: Feature>(
    weights: &[i8],
    inputs: usize,
    first: usize,
    packed: &'p mut [F::Slot],
) -> &'p [F::Slot] {
    let outputs = weights.chunks_exact(inputs * 9).skip(first).take(OUTPUTS);
    let (count, groups) = (outputs.len(), channels::<F>(inputs) / F::GROUP);
    let packed = &mut packed[..groups * F::GROUP * 9 * count];
    packed.fill(0.into());
    for (o, weights) in outputs.enumerate() {
        for (i, taps) in weights.as_chunks::<9>().0.iter().enumerate() {
            for (ky, taps) in taps.as_chunks::<3>().0.iter().enumerate() {
                let at = ((ky * groups + i / F::GROUP) * 3 * count + o) * F::GROUP + i % F::GROUP;
                for (kx, &weight) in taps.iter().enumerate() {
                    packed[at + kx * count * F::GROUP] = weight.into();
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

/// The numbers of one channel in a slot, from column `first` of the padded row on. Its columns begin a group apart.
#[inline(always)]
fn channel_of<F: Feature>(slot: &mut [F::Slot], cols: usize, channel: usize, first: usize) -> &mut [F::Slot] {
    let row = &mut slot[channel / F::GROUP * pitch(cols) * F::GROUP..][..pitch(cols) * F::GROUP];
    &mut row[first * F::GROUP..]
}

/// Zeroes the columns beside the frame in slots. All other padding may hold anything: its weights are zero, or its sums
/// are not used.
pub(super) fn clear_borders<F: Feature>(slots: &mut [F::Slot], cols: usize) {
    for row in slots.chunks_exact_mut(pitch(cols) * F::GROUP) {
        for first in [0, (cols + 1) * F::GROUP] {
            row.iter_mut().skip(first).take(F::GROUP).for_each(|x| *x = 0.into());
        }
    }
}

/// What of a row is left after its first `done` numbers; nothing beyond its end.
#[inline(always)]
fn rest<T>(row: &[T], done: usize) -> &[T] {
    row.get(done..).unwrap_or_default()
}

/// Writes every other half of a row of the input of the network, from the first or the second on, into a slot.
#[cfg_attr(target_arch = "arm", inline(never))]
#[cfg_attr(not(target_arch = "arm"), inline(always))]
pub(super) fn put_halves(slot: &mut [i16], cols: usize, channel: usize, odd: bool, from: &[f16], scale: f32) {
    let place = channel % <i16 as Feature>::GROUP;
    let to = &mut channel_of::<i16>(slot, cols, channel, 1)[place..];
    let done = done_in_helium!(spread_halves(from, odd, fixed_scale(scale), to));
    let columns = to.iter_mut().step_by(<i16 as Feature>::GROUP).skip(done);
    for (to, pair) in columns.zip(rest(from.as_chunks::<2>().0, done)) {
        *to = from_half(pair[usize::from(odd)], scale);
    }
}

/// Writes the numbers of channel `channel` into a slot.
#[cfg_attr(target_arch = "arm", inline(never))]
#[cfg_attr(not(target_arch = "arm"), inline(always))]
pub(super) fn put_row<F: Feature>(slot: &mut [F::Slot], cols: usize, channel: usize, from: &[F]) {
    let place = channel % F::GROUP;
    let done = F::spread_leading(from, &mut channel_of::<F>(slot, cols, channel, 1)[place..]);
    let columns = channel_of::<F>(slot, cols, channel, 1 + done).chunks_exact_mut(F::GROUP);
    for (to, x) in columns.zip(rest(from, done)) {
        to[place] = x.slot();
    }
}

/// Writes rescaled sums into every other column of a slot, from column `first` (0 or 1) on.
#[cfg_attr(target_arch = "arm", inline(never))]
#[cfg_attr(not(target_arch = "arm"), inline(always))]
pub(super) fn put_rescaled<F: Feature>(
    slot: &mut [F::Slot],
    cols: usize,
    channel: usize,
    first: usize,
    sums: &[i32],
    multiplier: i32,
) {
    let (start, place) = (1 + first, channel % F::GROUP);
    let to = &mut channel_of::<F>(slot, cols, channel, start)[place..];
    let done = F::spread_rescaled_leading(sums, multiplier, to);
    let columns = channel_of::<F>(slot, cols, channel, start + 2 * done).chunks_exact_mut(2 * F::GROUP);
    for (to, &sum) in columns.zip(rest(sums, done)) {
        to[place] = F::saturate(rescale(sum, multiplier)).slot();
    }
}

/// One row of a block of output channels: `sums` (1 or 2, padded columns) from three rows of all input channels.
#[cfg_attr(target_arch = "arm", inline(never))]
#[cfg_attr(not(target_arch = "arm"), inline(always))]
pub(super) fn row<F: Feature, V: Vector>(
    input: &[F::Slot],
    cols: usize,
    weights: &[F::Slot],
    block: &[Channel],
    sums: &mut [i32],
) {
    F::row::<V>(input, cols, weights, block, sums);
}
