//! The conversions and the storing loops on every half, as digests that host and boards compare.
//!
//! NaN is left out: of a NaN only that it is one is the same everywhere, and none is ever stored as a feature.

use half::f16;
use ommatidia_shared::image::{Chw, ChwMut};
use ommatidia_shared::nn::activation::Activation;
use ommatidia_shared::nn::conv::{Conv3x3, Store, Tensors};
use ommatidia_shared::nn::integer::{self, Channel, Convolution};
use ommatidia_shared::num::pairs::{Parts, gather_pairs, scatter_pairs};
use ommatidia_shared::num::simd::Simd;
use ommatidia_shared::num::{fused, narrow, narrow_slice, sigmoid_slice, widen, widen_slice};
use ommatidia_shared::sensor::FixedPattern;

/// Numbers that are converted at once: no multiple of the length of any loop, and odd, so that most slices do not begin
/// at a word.
const LEN: usize = 61;
/// Columns of the unshuffled.
const COLS: usize = LEN / 2;

/// FNV-1a of the bits of numbers.
#[derive(Clone, Copy, Debug)]
struct Digest(u64);

impl Digest {
    fn new() -> Self {
        Self(0xcbf2_9ce4_8422_2325)
    }

    fn add(&mut self, bits: u32) {
        for byte in bits.to_le_bytes() {
            self.0 = (self.0 ^ u64::from(byte)).wrapping_mul(0x0000_0100_0000_01b3);
        }
    }

    fn halves(&mut self, halves: &[f16]) {
        halves.iter().for_each(|half| self.add(if half.is_nan() { 0x7e00 } else { half.to_bits().into() }));
    }

    fn integers(&mut self, integers: &[i16]) {
        integers.iter().for_each(|&x| self.add(x as u16 as u32));
    }

    fn singles(&mut self, singles: &[f32]) {
        singles.iter().for_each(|x| self.add(if x.is_nan() { 0x7fc0_0000 } else { x.to_bits() }));
    }
}

/// All halves from `first` on, LEN of them, those beyond the last from the beginning.
fn halves(first: usize) -> [f16; LEN] {
    core::array::from_fn(|i| f16::from_bits((first + i) as u16))
}

/// The same without infinity and NaN, for loops that are never given one.
fn finite(first: usize) -> [f16; LEN] {
    halves(first).map(|half| if half.is_finite() { half } else { f16::from_bits(half.to_bits() & 0xbfff) })
}

/// Singles around each half: itself, the tie above it, the neighbours of the tie. `which` of the four.
fn around(half: f16, which: usize) -> f32 {
    // A unit of the last place of a half is 2^13 of a single; subnormal halves lie 2^-24 apart.
    let (wide, magnitude) = (widen(half), half.to_bits() & 0x7fff);
    let tie = if magnitude < 0x0400 {
        let tie = (f32::from(magnitude) + 0.5) * (1.0 / 16_777_216.0);
        if half.is_sign_negative() { -tie } else { tie }
    } else {
        f32::from_bits(wide.to_bits() + 0x1000)
    };
    match which {
        0 => wide,
        1 => tie,
        2 => f32::from_bits(tie.to_bits() - 1),
        _ => f32::from_bits(tie.to_bits() + 1),
    }
}

/// Calls `f` with each block of LEN halves of all 65,536.
fn blocks(mut f: impl FnMut(usize)) {
    (0..1 << 16).step_by(LEN).for_each(&mut f);
}

/// Frame corrected by these maps. Every other code is 0, where the signal is as small as the black level.
fn correct(black_level_dn: f32, offset: &[f16], gain: &[f16], first: usize) -> [f32; LEN] {
    let pattern = FixedPattern {
        black_level_dn,
        saturation_dn: u16::MAX,
        cols: LEN,
        offset_dn: Some(offset),
        inverse_gain: Some(gain),
    };
    let codes: [u16; LEN] = core::array::from_fn(|i| if i % 2 == 0 { 0 } else { (first + i) as u16 });
    let mut to = [0.0; LEN];
    pattern.correct(0, 0, &codes, &mut to);
    to
}

/// Two rows of halves as integers: what a convolution of the unshuffled input makes of them whose four outputs are its
/// four inputs. None where it is refused.
fn integers(even: &[f16; LEN], odd: &[f16; LEN], input_scale: f32) -> Option<[i16; 4 * COLS]> {
    let conv =
        Conv3x3 { inputs: 4, outputs: 4, rows: 1, cols: COLS, activation: Activation::Linear, store: Store::Replace };
    let mut weights = [0; 4 * 4 * 9];
    // Weight 2 in the middle, and a multiplier of nearly 1/2.
    (0..4).for_each(|channel| weights[(channel * 4 + channel) * 9 + 4] = 2);
    let channels = [Channel { bias: 0, multiplier: i32::MAX }; 4];
    let own = Convolution { weights: &weights, channels: &channels };
    let mut input = [f16::ZERO; 4 * COLS];
    input[..2 * COLS].copy_from_slice(&even[..2 * COLS]);
    input[2 * COLS..].copy_from_slice(&odd[..2 * COLS]);
    let (mut output, mut scratch) = ([0; 4 * COLS], [0.0; 2048]);
    let tensors = Tensors::Unshuffled {
        input: Chw::new(&input, 1, 2, 2 * COLS).ok()?,
        output: ChwMut::new(&mut output, 4, 1, COLS).ok()?,
    };
    integer::process(&conv, Simd::detect(), own, input_scale, tensors, &mut scratch).ok()?;
    Some(output)
}

/// Name and digest of each conversion, of every half and of the singles around each.
pub fn digests() -> [(&'static str, u64); 16] {
    let mut all = [Digest::new(); 16];
    let [one, slice, back, backs, relu, bounded, added, scaled, divided, rest @ ..] = &mut all;
    let [rounded, apart, summed, paired, logistic, corrected, whole] = rest;
    blocks(|first| {
        let from = halves(first);
        let mut wide = [0.0; LEN];
        widen_slice(&from, &mut wide);
        slice.singles(&wide);
        one.singles(&from.map(widen));
        for which in 0..4 {
            let singles = from.map(|half| if half.is_finite() { around(half, which) } else { widen(half) });
            let mut to = [f16::ZERO; LEN];
            narrow_slice(&singles, &mut to);
            backs.halves(&to);
            back.halves(&singles.map(narrow));
            let large = finite(first).map(|half| 1.5 * around(half, which));
            fused::narrow_relu(&large, &mut to);
            relu.halves(&to);
            fused::narrow_bounded(&large, &mut to);
            bounded.halves(&to);
            let mut interleaved = [0.0; 2 * LEN];
            fused::round_interleaved(&large, &singles.map(|x| if x.is_finite() { x } else { 0.0 }), &mut interleaved);
            rounded.singles(&interleaved);
            let mut arguments = singles.map(|x| if x.is_nan() { 0.0 } else { x });
            sigmoid_slice(&mut arguments);
            logistic.singles(&arguments);
        }
        // Every half meets another one of any size and sign.
        let (from, other) = (finite(first), finite(first.wrapping_mul(40_503) % (1 << 16)));
        let mut to = other;
        fused::accumulate(&from.map(widen), &mut to);
        added.halves(&to);
        to = other;
        fused::add_scaled(0.75, &from, &mut to);
        scaled.halves(&to);
        to = other;
        fused::divide(&mut to, widen(from[7]).abs().max(6.0e-8));
        divided.halves(&to);
        // The smallest black levels are subnormal, and so are signals.
        for black_level_dn in [64.25, 1.0e-3, f32::from_bits(first as u32)] {
            let (offset, gain) = (finite(first), finite(first.wrapping_mul(40_503) % (1 << 16)));
            corrected.singles(&correct(black_level_dn, &offset, &gain, first));
        }
        for input_scale in [1.0, 4096.0, 16_777_216.0] {
            integers(&from, &other, input_scale).iter().for_each(|numbers| whole.integers(numbers));
        }
        for part in 0..2 {
            let mut to = [0.0; LEN / 2];
            fused::widen_alternate(&from[..LEN - 1], part, &mut to);
            apart.singles(&to);
        }
        let mut sums = [0.0; 8];
        fused::add_eights(&from, &mut sums);
        summed.singles(&sums);
        let mut pairs = [[0.0; 2]; 16];
        gather_pairs(&halves(first), 3, &mut pairs);
        pairs.iter().for_each(|pair| paired.singles(pair));
        for parts in [Parts::Scaled(0.5), Parts::Exchanged] {
            let mut to = [f16::ZERO; LEN];
            scatter_pairs(&pairs, parts, &mut to, 3);
            paired.halves(&to);
        }
    });
    let names = [
        "widen",
        "widen_slice",
        "narrow",
        "narrow_slice",
        "narrow_relu",
        "narrow_bounded",
        "accumulate",
        "add_scaled",
        "divide",
        "round_interleaved",
        "widen_alternate",
        "add_eights",
        "pairs",
        "sigmoid_slice",
        "correct",
        "integers",
    ];
    core::array::from_fn(|i| (names[i], all[i].0))
}
