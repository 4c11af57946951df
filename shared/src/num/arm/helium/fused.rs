//! The routines of [`crate::num::fused`], eight elements at a time: even ones in one register, odd ones in another, as
//! the conversions need them. Each function returns the number of elements that it has done.
//!
//! The numbers are halves, sums of products of halves, and halves times a weight of channel attention (0, or 2^-26 at
//! least): multiples of 2^-76, so that nothing is flushed. [`correct`] looks whether it was.

use super::unflushed;
use crate::num::{f16, narrow, widen};

/// Widens `from` into the equally long `to`; eight in six instructions.
#[inline(always)]
pub(in crate::num) fn widen_slice(from: &[f16], to: &mut [f32]) {
    let len = from.len().min(to.len());
    let n = len / 8;
    if n > 0 {
        // SAFETY: 8 n elements lie in both slices.
        unsafe {
            asm_all!(
                "dls lr, {n}",
                "2:",
                "vldrh.u16 q0, [{from}], #16",
                "vcvtb.f32.f16 q2, q0",
                "vcvtt.f32.f16 q3, q0",
                "vst20.32 {{q2, q3}}, [{to}]",
                "vst21.32 {{q2, q3}}, [{to}]!",
                "le lr, 2b",
                n = in(reg) n,
                from = inout(reg) from.as_ptr() => _,
                to = inout(reg) to.as_mut_ptr() => _,
                out("lr") _,
            );
        }
    }
    for i in 8 * n..len {
        to[i] = widen(from[i]);
    }
}

/// Narrows `from` into the equally long `to`; eight in six instructions.
#[inline(always)]
pub(in crate::num) fn narrow_slice(from: &[f32], to: &mut [f16]) {
    let len = from.len().min(to.len());
    let n = len / 8;
    if n > 0 {
        // SAFETY: 8 n elements lie in both slices.
        unsafe {
            asm_all!(
                "dls lr, {n}",
                "2:",
                "vld20.32 {{q0, q1}}, [{from}]",
                "vld21.32 {{q0, q1}}, [{from}]!",
                "vcvtb.f16.f32 q2, q0",
                "vcvtt.f16.f32 q2, q1",
                "vstrh.16 q2, [{to}], #16",
                "le lr, 2b",
                n = in(reg) n,
                from = inout(reg) from.as_ptr() => _,
                to = inout(reg) to.as_mut_ptr() => _,
                out("lr") _,
            );
        }
    }
    for i in 8 * n..len {
        to[i] = narrow(from[i]);
    }
}

/// [`crate::num::fused::narrow_relu`]: 7 instructions for eight elements; as integers, negative halves are below zero.
#[inline(always)]
pub(in crate::num) fn narrow_relu(from: &[f32], to: &mut [f16]) -> usize {
    let n = from.len().min(to.len()) / 8;
    if n == 0 {
        return 0;
    }
    // SAFETY: 8 n elements lie in both slices.
    unsafe {
        asm_all!(
            "vmov.i32 q3, #0",
            "dls lr, {n}",
            "2:",
            "vld20.32 {{q0, q1}}, [{from}]",
            "vld21.32 {{q0, q1}}, [{from}]!",
            "vcvtb.f16.f32 q2, q0",
            "vcvtt.f16.f32 q2, q1",
            "vmax.s16 q2, q2, q3",
            "vstrh.16 q2, [{to}], #16",
            "le lr, 2b",
            n = in(reg) n,
            from = inout(reg) from.as_ptr() => _,
            to = inout(reg) to.as_mut_ptr() => _,
            out("lr") _,
        );
    }
    8 * n
}

/// [`crate::num::fused::accumulate`]: 11 instructions for eight elements.
#[inline(always)]
pub(in crate::num) fn accumulate(from: &[f32], to: &mut [f16]) -> usize {
    let n = from.len().min(to.len()) / 8;
    if n == 0 {
        return 0;
    }
    // SAFETY: 8 n elements lie in both slices.
    unsafe {
        asm_all!(
            "dls lr, {n}",
            "2:",
            "vld20.32 {{q0, q1}}, [{from}]",
            "vld21.32 {{q0, q1}}, [{from}]!",
            "vldrh.u16 q2, [{to}]",
            "vcvtb.f32.f16 q3, q2",
            "vcvtt.f32.f16 q4, q2",
            "vadd.f32 q0, q0, q3",
            "vadd.f32 q1, q1, q4",
            "vcvtb.f16.f32 q2, q0",
            "vcvtt.f16.f32 q2, q1",
            "vstrh.16 q2, [{to}], #16",
            "le lr, 2b",
            n = in(reg) n,
            from = inout(reg) from.as_ptr() => _,
            to = inout(reg) to.as_mut_ptr() => _,
            out("lr") _,
        );
    }
    8 * n
}

/// [`crate::num::fused::add_scaled`]: 14 instructions for eight elements.
#[inline(always)]
pub(in crate::num) fn add_scaled(scale: f32, from: &[f16], to: &mut [f16]) -> usize {
    let n = from.len().min(to.len()) / 8;
    if n == 0 {
        return 0;
    }
    // SAFETY: 8 n elements lie in both slices.
    unsafe {
        asm_all!(
            "dls lr, {n}",
            "2:",
            "vldrh.u16 q0, [{from}], #16",
            "vldrh.u16 q1, [{to}]",
            "vcvtb.f32.f16 q2, q0",
            "vcvtt.f32.f16 q3, q0",
            "vmul.f32 q2, q2, {scale}",
            "vmul.f32 q3, q3, {scale}",
            "vcvtb.f32.f16 q4, q1",
            "vcvtt.f32.f16 q5, q1",
            "vadd.f32 q2, q2, q4",
            "vadd.f32 q3, q3, q5",
            "vcvtb.f16.f32 q1, q2",
            "vcvtt.f16.f32 q1, q3",
            "vstrh.16 q1, [{to}], #16",
            "le lr, 2b",
            n = in(reg) n,
            scale = in(reg) scale.to_bits(),
            from = inout(reg) from.as_ptr() => _,
            to = inout(reg) to.as_mut_ptr() => _,
            out("lr") _,
        );
    }
    8 * n
}

/// [`crate::num::fused::add_eights`]: 6 instructions for eight elements.
#[inline(always)]
pub(in crate::num) fn add_eights(from: &[f16], sums: &mut [f32; 8]) -> usize {
    let n = from.len() / 8;
    if n == 0 {
        return 0;
    }
    // SAFETY: 8 n elements lie in the slice.
    unsafe {
        asm_all!(
            "vld20.32 {{q2, q3}}, [{sums}]",
            "vld21.32 {{q2, q3}}, [{sums}]",
            "dls lr, {n}",
            "2:",
            "vldrh.u16 q0, [{from}], #16",
            "vcvtb.f32.f16 q1, q0",
            "vcvtt.f32.f16 q4, q0",
            "vadd.f32 q2, q2, q1",
            "vadd.f32 q3, q3, q4",
            "le lr, 2b",
            "vst20.32 {{q2, q3}}, [{sums}]",
            "vst21.32 {{q2, q3}}, [{sums}]",
            n = in(reg) n,
            sums = in(reg) sums,
            from = inout(reg) from.as_ptr() => _,
            out("lr") _,
        );
    }
    8 * n
}

/// The loop of [`widen_alternate`]. `convert` selects the half of each word.
macro_rules! alternate {
    ($convert:literal, $from:ident, $to:ident, $n:ident) => {
        asm_all!(
            "dls lr, {n}",
            "2:",
            "vldrh.u16 q0, [{from}], #16",
            "vldrh.u16 q1, [{from}], #16",
            concat!($convert, " q0, q0"),
            concat!($convert, " q1, q1"),
            "vstrw.32 q0, [{to}], #16",
            "vstrw.32 q1, [{to}], #16",
            "le lr, 2b",
            n = in(reg) $n,
            from = inout(reg) $from.as_ptr() => _,
            to = inout(reg) $to.as_mut_ptr() => _,
            out("lr") _,
        )
    };
}

/// [`crate::num::fused::widen_alternate`]: 7 instructions for eight elements.
#[inline(always)]
pub(in crate::num) fn widen_alternate(from: &[f16], first: usize, to: &mut [f32]) -> usize {
    let n = (from.len() / 2).min(to.len()) / 8;
    if n == 0 {
        return 0;
    }
    // SAFETY: 8 n pairs lie in `from`, 8 n elements in `to`.
    unsafe {
        if first == 0 {
            alternate!("vcvtb.f32.f16", from, to, n);
        } else {
            alternate!("vcvtt.f32.f16", from, to, n);
        }
    }
    8 * n
}

/// [`crate::num::fused::round_interleaved`]: 9 instructions for four pairs. Returns how many pairs are done.
#[inline(always)]
pub(in crate::num) fn round_interleaved(even: &[f32], odd: &[f32], to: &mut [f32]) -> usize {
    let n = even.len().min(odd.len()).min(to.len() / 2) / 4;
    if n == 0 {
        return 0;
    }
    // SAFETY: 4 n elements lie in `even` and `odd`, twice as many in `to`.
    unsafe {
        asm_all!(
            "dls lr, {n}",
            "2:",
            "vldrw.u32 q0, [{even}], #16",
            "vldrw.u32 q1, [{odd}], #16",
            "vcvtb.f16.f32 q0, q0",
            "vcvtb.f16.f32 q1, q1",
            "vcvtb.f32.f16 q0, q0",
            "vcvtb.f32.f16 q1, q1",
            "vst20.32 {{q0, q1}}, [{to}]",
            "vst21.32 {{q0, q1}}, [{to}]!",
            "le lr, 2b",
            n = in(reg) n,
            even = inout(reg) even.as_ptr() => _,
            odd = inout(reg) odd.as_ptr() => _,
            to = inout(reg) to.as_mut_ptr() => _,
            out("lr") _,
        );
    }
    4 * n
}

/// The leading elements of `((code - black) - offset) * gain`, eleven instructions for four. Returns how many: none
/// where a number would be flushed, as where the black level is tiny.
#[inline(always)]
pub(in crate::num) fn correct(codes: &[u16], black: f32, [offset, gain]: [&[f16]; 2], to: &mut [f32]) -> usize {
    let n = codes.len().min(offset.len()).min(gain.len()).min(to.len()) / 4;
    // SAFETY: 4 n elements lie in all slices.
    let work = || unsafe {
        asm_all!(
            "dls lr, r5",
            "2:",
            "vldrh.u32 q0, [r0], #8",
            "vcvt.f32.u32 q0, q0",
            "vldrh.u32 q1, [r1], #8",
            "vsub.f32 q0, q0, r4",
            "vcvtb.f32.f16 q1, q1",
            "vldrh.u32 q2, [r2], #8",
            "vsub.f32 q0, q0, q1",
            "vcvtb.f32.f16 q2, q2",
            "vmul.f32 q0, q0, q2",
            "vstrw.32 q0, [r3], #16",
            "le lr, 2b",
            in("r5") n,
            in("r4") black.to_bits(),
            inout("r0") codes.as_ptr() => _,
            inout("r1") offset.as_ptr() => _,
            inout("r2") gain.as_ptr() => _,
            inout("r3") to.as_mut_ptr() => _,
            out("lr") _,
        );
    };
    if n > 0 && unflushed(work) { 4 * n } else { 0 }
}
