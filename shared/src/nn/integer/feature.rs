//! The two kinds of features, of 16 bits and of 8: how they are stored, and how the inner loops read them.
//!
//! Loops that only Helium has return the number of leading elements that they have done. A plain loop does the others.

use super::weights::Channel;
use crate::nn::packed::{padded, pitch};
#[cfg(all(target_arch = "arm", feature = "fpv4"))]
use crate::num::arm;
#[cfg(all(target_arch = "arm", feature = "helium"))]
use crate::num::arm::helium;
#[cfg(not(all(target_arch = "arm", feature = "fpv4")))]
use crate::num::simd::PairSums;
use crate::num::simd::Vector;
use bytemuck::Pod;

/// A stored feature: `i16` or `i8`.
pub trait Feature: Pod + Into<i32> {
    /// The same number in a slot of the inner loops.
    type Slot: Pod + From<i8>;
    /// Channels of a group: as many as Helium's `VMLADAVA` multiplies, or two, as `SMLAD` and `PMADDWD` do.
    const GROUP: usize;

    /// The nearest number that can be stored.
    fn saturate(x: i32) -> Self;

    /// The number in a slot.
    fn slot(self) -> Self::Slot;

    /// One row of a block of output channels: `sums` (1 or 2, padded columns) from three rows of all input channels.
    fn row<V: Vector>(input: &[Self::Slot], cols: usize, weights: &[Self::Slot], block: &[Channel], sums: &mut [i32]);

    /// `to = saturate(max(rescale(sum), least))` of leading sums.
    #[inline(always)]
    fn rescale_leading(_sums: &[i32], _multiplier: i32, _least: i32, _to: &mut [Self]) -> usize {
        0
    }

    /// `to = saturate(to + max(rescale(sum), least))` of leading sums.
    #[inline(always)]
    fn accumulate_leading(_sums: &[i32], _multiplier: i32, _least: i32, _to: &mut [Self]) -> usize {
        0
    }

    /// Writes leading numbers to the first place of the next group each.
    #[inline(always)]
    fn spread_leading(_from: &[Self], _to: &mut [Self::Slot]) -> usize {
        0
    }

    /// Writes leading rescaled sums to the first place of every other group.
    #[inline(always)]
    fn spread_rescaled_leading(_sums: &[i32], _multiplier: i32, _to: &mut [Self::Slot]) -> usize {
        0
    }

    /// `g = saturate(g + floor(scale t / 2^15 + 1/2))` of leading numbers.
    #[inline(always)]
    fn add_scaled_leading(_scale: i16, _t: &[Self], _g: &mut [Self]) -> usize {
        0
    }

    /// Adds leading numbers to a sum.
    #[inline(always)]
    fn sum_leading(_from: &[Self], _sum: &mut i32) -> usize {
        0
    }
}

/// A kind of features in the loops of Helium.
#[cfg(all(target_arch = "arm", feature = "helium"))]
macro_rules! feature {
    ($number:ident, $group:literal, $loops:ident, $rows2:ident, $rows1:ident) => {
        impl Feature for $number {
            type Slot = Self;
            const GROUP: usize = $group;

            #[inline(always)]
            fn saturate(x: i32) -> Self {
                x.clamp(Self::MIN.into(), Self::MAX.into()) as Self
            }

            #[inline(always)]
            fn slot(self) -> Self::Slot {
                self
            }

            #[inline(always)]
            fn row<V: Vector>(input: &[Self], cols: usize, weights: &[Self], block: &[Channel], sums: &mut [i32]) {
                let rows = arm::Groups { input, pitch: pitch(cols), weights };
                match *block {
                    [a, b] => helium::$rows2(rows, cols, [a.bias, b.bias], sums, padded(cols)),
                    [a] => helium::$rows1(rows, cols, a.bias, sums, padded(cols)),
                    _ => {}
                }
            }

            #[inline(always)]
            fn rescale_leading(sums: &[i32], multiplier: i32, least: i32, to: &mut [Self]) -> usize {
                helium::$loops::rescale_row(sums, multiplier, least, to)
            }

            #[inline(always)]
            fn accumulate_leading(sums: &[i32], multiplier: i32, least: i32, to: &mut [Self]) -> usize {
                helium::$loops::accumulate_row(sums, multiplier, least, to)
            }

            #[inline(always)]
            fn spread_leading(from: &[Self], to: &mut [Self]) -> usize {
                helium::$loops::spread(from, to)
            }

            #[inline(always)]
            fn spread_rescaled_leading(sums: &[i32], multiplier: i32, to: &mut [Self]) -> usize {
                helium::$loops::spread_rescaled(sums, multiplier, to)
            }

            #[inline(always)]
            fn add_scaled_leading(scale: i16, t: &[Self], g: &mut [Self]) -> usize {
                helium::$loops::add_scaled(scale, t, g)
            }

            #[inline(always)]
            fn sum_leading(from: &[Self], sum: &mut i32) -> usize {
                helium::$loops::add(from, sum)
            }
        }
    };
}

#[cfg(all(target_arch = "arm", feature = "helium"))]
feature!(i16, 8, integers16, correlate_groups2, correlate_groups1);
#[cfg(all(target_arch = "arm", feature = "helium"))]
feature!(i8, 16, integers8, correlate_bytes2, correlate_bytes1);

/// A kind of features in loops that multiply pairs of 16 bits.
#[cfg(not(all(target_arch = "arm", feature = "helium")))]
macro_rules! feature {
    ($number:ident) => {
        impl Feature for $number {
            type Slot = i16;
            const GROUP: usize = 2;

            #[inline(always)]
            fn saturate(x: i32) -> Self {
                x.clamp(Self::MIN.into(), Self::MAX.into()) as Self
            }

            #[inline(always)]
            fn slot(self) -> i16 {
                self.into()
            }

            #[inline(always)]
            fn row<V: Vector>(input: &[i16], cols: usize, weights: &[i16], block: &[Channel], sums: &mut [i32]) {
                pair_row::<V>(input, cols, weights, block, sums);
            }
        }
    };
}

#[cfg(not(all(target_arch = "arm", feature = "helium")))]
feature!(i16);
#[cfg(not(all(target_arch = "arm", feature = "helium")))]
feature!(i8);

/// [`Feature::row`] in `SMLAD`.
#[cfg(all(target_arch = "arm", feature = "fpv4", not(feature = "helium")))]
#[inline(always)]
#[expect(clippy::extra_unused_type_parameters, reason = "loops in instructions of the core choose their own vectors")]
fn pair_row<V: Vector>(input: &[i16], cols: usize, weights: &[i16], block: &[Channel], sums: &mut [i32]) {
    let rows = arm::Groups { input, pitch: pitch(cols), weights };
    match *block {
        [a, b] => arm::correlate_groups2(rows, cols, [a.bias, b.bias], sums, padded(cols)),
        [a] => arm::correlate_groups1(rows, cols, a.bias, sums, padded(cols)),
        _ => {}
    }
}

/// [`Feature::row`] in portable loops.
#[cfg(not(all(target_arch = "arm", feature = "fpv4")))]
#[inline(always)]
fn pair_row<V: Vector>(input: &[i16], cols: usize, weights: &[i16], block: &[Channel], sums: &mut [i32]) {
    match *block {
        [a, b] => pairs::<V, 2>(input, cols, weights, [a, b], sums),
        [a] => pairs::<V, 1>(input, cols, weights, [a], sums),
        _ => {}
    }
}

/// Channels of a group in portable loops.
#[cfg(not(all(target_arch = "arm", feature = "fpv4")))]
const PAIR: usize = 2;

/// A row of a block of O output channels.
#[cfg(not(all(target_arch = "arm", feature = "fpv4")))]
#[inline(always)]
fn pairs<V: Vector, const O: usize>(
    input: &[i16],
    cols: usize,
    weights: &[i16],
    block: [Channel; O],
    sums: &mut [i32],
) {
    let (width, len) = (pitch(cols) * PAIR, V::Sums::LEN);
    for x in (0..cols).step_by(2 * len) {
        let mut acc: [[V::Sums; 2]; O] = core::array::from_fn(|o| [V::Sums::splat(block[o].bias); 2]);
        // One kernel row of one group.
        for (weights, row) in weights.chunks_exact(3 * O * PAIR).zip(input.chunks_exact(width)) {
            let row = &row[x * PAIR..][..(2 * len + 2) * PAIR];
            for (kx, weights) in weights.chunks_exact(O * PAIR).enumerate() {
                let x = [&row[kx * PAIR..], &row[(kx + len) * PAIR..]];
                for (acc, weights) in acc.iter_mut().zip(weights.as_chunks::<PAIR>().0) {
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
