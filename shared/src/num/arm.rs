//! The instructions of the Cortex-M's floating-point unit (FPv4-SP, FPv5) that the language does not reach: conversions between
//! halves and singles, and the fused multiply-accumulate for exact products.
//!
//! The assembly saves and restores every vector register that it uses, because the compiler does not let it name them.
//! NaN: the unit keeps sign and payload. Arithmetic only makes the default NaN, which converts as the rest of [`super`] says.
#![allow(unsafe_code)]

use core::arch::asm;

use super::convert::{narrow, widen};
use super::f16;
use super::pairs::{Order, Parts};

/// Widens `from` into the equally long `to`; eight in twelve instructions.
pub(super) fn widen_slice(from: &[f16], to: &mut [f32]) {
    let len = from.len().min(to.len());
    let head = len.min(usize::from(!from.as_ptr().addr().is_multiple_of(4)));
    let blocks = (len - head) / 8;
    let tail = head + 8 * blocks;
    for i in (0..head).chain(tail..len) {
        to[i] = widen(from[i]);
    }
    if blocks == 0 {
        return;
    }
    // SAFETY: 8 * blocks numbers from `head` on lie in both slices; the halves are word-aligned there. All registers used
    // are restored.
    unsafe {
        asm!(
            "vpush {{d0-d5}}",
            "2:",
            "vldmia {from}!, {{s8-s11}}",
            "vcvtb.f32.f16 s0, s8",
            "vcvtt.f32.f16 s1, s8",
            "vcvtb.f32.f16 s2, s9",
            "vcvtt.f32.f16 s3, s9",
            "vcvtb.f32.f16 s4, s10",
            "vcvtt.f32.f16 s5, s10",
            "vcvtb.f32.f16 s6, s11",
            "vcvtt.f32.f16 s7, s11",
            "vstmia {to}!, {{s0-s7}}",
            "subs {blocks}, #1",
            "bne 2b",
            "vpop {{d0-d5}}",
            from = inout(reg) from.as_ptr().add(head) => _,
            to = inout(reg) to.as_mut_ptr().add(head) => _,
            blocks = inout(reg) blocks => _,
        );
    }
}

/// Narrows `from` into the equally long `to`; eight in twelve instructions.
pub(super) fn narrow_slice(from: &[f32], to: &mut [f16]) {
    let len = from.len().min(to.len());
    let head = len.min(usize::from(!to.as_ptr().addr().is_multiple_of(4)));
    let blocks = (len - head) / 8;
    let tail = head + 8 * blocks;
    for i in (0..head).chain(tail..len) {
        to[i] = narrow(from[i]);
    }
    if blocks == 0 {
        return;
    }
    // SAFETY: 8 * blocks numbers from `head` on lie in both slices; the halves are word-aligned there. All registers used
    // are restored.
    unsafe {
        asm!(
            "vpush {{d0-d5}}",
            "2:",
            "vldmia {from}!, {{s0-s7}}",
            "vcvtb.f16.f32 s8, s0",
            "vcvtt.f16.f32 s8, s1",
            "vcvtb.f16.f32 s9, s2",
            "vcvtt.f16.f32 s9, s3",
            "vcvtb.f16.f32 s10, s4",
            "vcvtt.f16.f32 s10, s5",
            "vcvtb.f16.f32 s11, s6",
            "vcvtt.f16.f32 s11, s7",
            "vstmia {to}!, {{s8-s11}}",
            "subs {blocks}, #1",
            "bne 2b",
            "vpop {{d0-d5}}",
            from = inout(reg) from.as_ptr().add(head) => _,
            to = inout(reg) to.as_mut_ptr().add(head) => _,
            blocks = inout(reg) blocks => _,
        );
    }
}

/// One output channel of one tap: four columns from input register `x` on, times weight register `w`.
macro_rules! tap {
    ($a:literal, $b:literal, $c:literal, $d:literal, $x0:literal, $x1:literal, $x2:literal, $x3:literal, $w:literal) => {
        concat!(
            "vfma.f32 s",
            $a,
            ", s",
            $x0,
            ", s",
            $w,
            "\n",
            "vfma.f32 s",
            $b,
            ", s",
            $x1,
            ", s",
            $w,
            "\n",
            "vfma.f32 s",
            $c,
            ", s",
            $x2,
            ", s",
            $w,
            "\n",
            "vfma.f32 s",
            $d,
            ", s",
            $x3,
            ", s",
            $w
        )
    };
}

/// The four output channels of one tap.
macro_rules! taps {
    ($x0:literal, $x1:literal, $x2:literal, $x3:literal, $w0:literal, $w1:literal, $w2:literal, $w3:literal) => {
        concat!(
            tap!("0", "1", "2", "3", $x0, $x1, $x2, $x3, $w0),
            "\n",
            tap!("4", "5", "6", "7", $x0, $x1, $x2, $x3, $w1),
            "\n",
            tap!("8", "9", "10", "11", $x0, $x1, $x2, $x3, $w2),
            "\n",
            tap!("12", "13", "14", "15", $x0, $x1, $x2, $x3, $w3)
        )
    };
}

/// One kernel row: six inputs in s16-s21, weights in s22-s29, then s22-s25.
macro_rules! kernel_row {
    () => {
        concat!(
            "vldmia {row}, {{s16-s21}}\n",
            "vldmia {weights}!, {{s22-s29}}\n",
            taps!("16", "17", "18", "19", "22", "23", "24", "25"),
            "\n",
            taps!("17", "18", "19", "20", "26", "27", "28", "29"),
            "\n",
            "vldmia {weights}!, {{s22-s25}}\n",
            taps!("18", "19", "20", "21", "22", "23", "24", "25")
        )
    };
}

/// Columns of the block that [`correlate`] computes.
pub(crate) const COLUMNS: usize = 4;

/// A block of 4 output channels by 4 columns of a 3x3 correlation, 158 instructions for 144 products.
///
/// `input`: three rows of all channels from the block's first column on, `[3, channels, pitch]`; `weights`: `[channels, 3, 3, 4]`;
/// `sums`: the biases on the way in, the sums over (channel, ky, kx) in this order on the way out. All products must be exact.
#[inline(always)]
pub(crate) fn correlate(input: &[f32], pitch: usize, weights: &[f32], sums: &mut [[f32; COLUMNS]; 4]) {
    let channels = weights.len() / 36;
    if channels == 0 {
        return;
    }
    assert!(input.len() >= (3 * channels - 1) * pitch + 6, "{} numbers are too few", input.len());
    // SAFETY: the last row read begins at (3 * channels - 1) * pitch and is six long; 36 weights a channel are there. All
    // vector registers used are restored.
    unsafe {
        asm!(
            "vpush {{d0-d15}}",
            "vldmia {sums}, {{s0-s15}}",
            "2:",
            "mov {row}, {input}",
            kernel_row!(),
            "add {row}, {row}, {stride}",
            kernel_row!(),
            "add {row}, {row}, {stride}",
            kernel_row!(),
            "add {input}, {input}, {pitch}",
            "subs {channels}, #1",
            "bne 2b",
            "vstmia {sums}, {{s0-s15}}",
            "vpop {{d0-d15}}",
            input = inout(reg) input.as_ptr() => _,
            row = out(reg) _,
            weights = inout(reg) weights.as_ptr() => _,
            sums = in(reg) sums,
            stride = in(reg) channels * pitch * size_of::<f32>(),
            pitch = in(reg) pitch * size_of::<f32>(),
            channels = inout(reg) channels => _,
        );
    }
}

/// See [`super::pairs::gather_pairs`], which has checked the lengths. Returns how many pairs are done, an even number; 17
/// instructions for two pairs if reversed, 12 if not.
#[inline(always)]
pub(super) fn gather_pairs(from: &[f16], stride: usize, order: Order, to: &mut [[f32; 2]]) -> usize {
    let half = to.len() / 2;
    if half == 0 {
        return 0;
    }
    let stride = stride * size_of::<f16>();
    // SAFETY: the caller has checked that `to.len()` pairs a stride apart lie in `from`, and that the reversed order has a power
    // of two of them. All vector registers used are restored.
    unsafe {
        match order {
            // Pairs i and i + n/2 lie side by side when the bits are reversed.
            Order::Reversed => asm!(
                "vpush {{d0-d2}}",
                "2:",
                "ldr {t}, [{from}]",
                "ldr {u}, [{from}, {far}]",
                "add {from}, {from}, {stride}",
                "vmov s0, s1, {t}, {u}",
                "vcvtb.f32.f16 s2, s0",
                "vcvtt.f32.f16 s3, s0",
                "vcvtb.f32.f16 s4, s1",
                "vcvtt.f32.f16 s5, s1",
                "rbit {t}, {i}",
                "lsr {t}, {t}, {shift}",
                "add {t}, {t}, {to}",
                "vstmia {t}, {{s2-s5}}",
                "adds {i}, #1",
                "cmp {i}, {half}",
                "bne 2b",
                "vpop {{d0-d2}}",
                t = out(reg) _,
                u = out(reg) _,
                from = inout(reg) from.as_ptr() => _,
                far = in(reg) half * stride,
                stride = in(reg) stride,
                i = inout(reg) 0 => _,
                // Eight bytes a pair.
                shift = in(reg) u32::BITS - 3 - to.len().trailing_zeros(),
                to = in(reg) to.as_mut_ptr(),
                half = in(reg) half,
            ),
            Order::Natural => asm!(
                "vpush {{d0-d2}}",
                "2:",
                "ldr {t}, [{from}]",
                "ldr {u}, [{from}, {stride}]",
                "add {from}, {from}, {stride}, lsl #1",
                "vmov s0, s1, {t}, {u}",
                "vcvtb.f32.f16 s2, s0",
                "vcvtt.f32.f16 s3, s0",
                "vcvtb.f32.f16 s4, s1",
                "vcvtt.f32.f16 s5, s1",
                "vstmia {to}!, {{s2-s5}}",
                "subs {half}, #1",
                "bne 2b",
                "vpop {{d0-d2}}",
                t = out(reg) _,
                u = out(reg) _,
                from = inout(reg) from.as_ptr() => _,
                stride = in(reg) stride,
                to = inout(reg) to.as_mut_ptr() => _,
                half = inout(reg) half => _,
            ),
        }
    }
    2 * half
}

/// The loop of [`scatter_pairs`]: which half of the word each number goes to.
macro_rules! scatter {
    ($first:literal, $second:literal, $from:ident, $scale:ident, $to:ident, $stride:ident, $half:ident) => {
        asm!(
            "vpush {{d0-d3}}",
            "vmov s6, {scale}",
            "2:",
            "vldmia {from}!, {{s0-s3}}",
            "vmul.f32 s0, s0, s6",
            "vmul.f32 s1, s1, s6",
            "vmul.f32 s2, s2, s6",
            "vmul.f32 s3, s3, s6",
            concat!($first, ".f16.f32 s4, s0"),
            concat!($second, ".f16.f32 s4, s1"),
            concat!($first, ".f16.f32 s5, s2"),
            concat!($second, ".f16.f32 s5, s3"),
            "vmov {t}, {u}, s4, s5",
            "str {t}, [{to}]",
            "str {u}, [{to}, {stride}]",
            "add {to}, {to}, {stride}, lsl #1",
            "subs {half}, #1",
            "bne 2b",
            "vpop {{d0-d3}}",
            t = out(reg) _,
            u = out(reg) _,
            scale = in(reg) $scale.to_bits(),
            from = inout(reg) $from.as_ptr() => _,
            to = inout(reg) $to.as_mut_ptr() => _,
            stride = in(reg) $stride * size_of::<f16>(),
            half = inout(reg) $half => _,
        )
    };
}

/// See [`super::pairs::scatter_pairs`], which has checked the lengths. Returns how many pairs are done, an even number; 16
/// instructions for two pairs.
#[inline(always)]
pub(super) fn scatter_pairs(from: &[[f32; 2]], scale: f32, parts: Parts, to: &mut [f16], stride: usize) -> usize {
    let half = from.len() / 2;
    if half == 0 {
        return 0;
    }
    // SAFETY: the caller has checked that `from.len()` pairs a stride apart lie in `to`. All vector registers used are restored.
    unsafe {
        match parts {
            Parts::InOrder => scatter!("vcvtb", "vcvtt", from, scale, to, stride, half),
            Parts::Exchanged => scatter!("vcvtt", "vcvtb", from, scale, to, stride, half),
        }
    }
    2 * half
}
