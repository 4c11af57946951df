//! The routines of [`crate::num::fused`], eight elements at a time. Each returns the number of elements that it has
//! done. It does none where a slice of halves does not begin at a word.

use crate::num::f16;

/// Blocks of eight in `len` elements, if the halves begin at a word.
#[inline(always)]
fn blocks(halves: &[f16], len: usize) -> usize {
    if halves.as_ptr().addr().is_multiple_of(4) { len.min(halves.len()) / 8 } else { 0 }
}

/// [`crate::num::fused::narrow_relu`]: 18 instructions for eight elements; `usat16` takes two negative halves to zero.
#[inline(always)]
pub(in crate::num) fn narrow_relu(from: &[f32], to: &mut [f16]) -> usize {
    let n = blocks(to, from.len());
    if n == 0 {
        return 0;
    }
    // SAFETY: 8 n elements lie in both slices.
    unsafe {
        asm_low!(
            "2:",
            "vldmia {from}!, {{s0-s7}}",
            narrow_eight!("s8" "s9" "s10" "s11"),
            "vmov {t}, {u}, s8, s9",
            "usat16 {t}, #15, {t}",
            "usat16 {u}, #15, {u}",
            "strd {t}, {u}, [{to}], #8",
            "vmov {t}, {u}, s10, s11",
            "usat16 {t}, #15, {t}",
            "usat16 {u}, #15, {u}",
            "strd {t}, {u}, [{to}], #8",
            "subs {n}, #1",
            "bne 2b",
            t = out(reg) _,
            u = out(reg) _,
            from = inout(reg) from.as_ptr() => _,
            to = inout(reg) to.as_mut_ptr() => _,
            n = inout(reg) n => _,
        );
    }
    8 * n
}

/// [`crate::num::fused::accumulate`]: 29 instructions for eight elements.
#[inline(always)]
pub(in crate::num) fn accumulate(from: &[f32], to: &mut [f16]) -> usize {
    let n = blocks(to, from.len());
    if n == 0 {
        return 0;
    }
    // SAFETY: 8 n elements lie in both slices.
    unsafe {
        asm_all!(
            "2:",
            "vldmia {from}!, {{s0-s7}}",
            "vldmia {to}, {{s8-s11}}",
            widen_eight!("s8" "s9" "s10" "s11" => "s12" "s13" "s14" "s15" "s16" "s17" "s18" "s19"),
            "vadd.f32 s0, s0, s12",
            "vadd.f32 s1, s1, s13",
            "vadd.f32 s2, s2, s14",
            "vadd.f32 s3, s3, s15",
            "vadd.f32 s4, s4, s16",
            "vadd.f32 s5, s5, s17",
            "vadd.f32 s6, s6, s18",
            "vadd.f32 s7, s7, s19",
            narrow_eight!("s8" "s9" "s10" "s11"),
            "vstmia {to}!, {{s8-s11}}",
            "subs {n}, #1",
            "bne 2b",
            from = inout(reg) from.as_ptr() => _,
            to = inout(reg) to.as_mut_ptr() => _,
            n = inout(reg) n => _,
        );
    }
    8 * n
}

/// [`crate::num::fused::add_scaled`]: 37 instructions for eight elements.
#[inline(always)]
pub(in crate::num) fn add_scaled(scale: f32, from: &[f16], to: &mut [f16]) -> usize {
    let n = blocks(from, 8 * blocks(to, from.len()));
    if n == 0 {
        return 0;
    }
    // SAFETY: 8 n elements lie in both slices.
    unsafe {
        asm_all!(
            "vmov s28, {scale}",
            "2:",
            "vldmia {from}!, {{s16-s19}}",
            "vldmia {to}, {{s20-s23}}",
            widen_eight!("s20" "s21" "s22" "s23" => "s0" "s1" "s2" "s3" "s4" "s5" "s6" "s7"),
            widen_eight!("s16" "s17" "s18" "s19" => "s8" "s9" "s10" "s11" "s12" "s13" "s14" "s15"),
            "vmla.f32 s0, s8, s28",
            "vmla.f32 s1, s9, s28",
            "vmla.f32 s2, s10, s28",
            "vmla.f32 s3, s11, s28",
            "vmla.f32 s4, s12, s28",
            "vmla.f32 s5, s13, s28",
            "vmla.f32 s6, s14, s28",
            "vmla.f32 s7, s15, s28",
            narrow_eight!("s20" "s21" "s22" "s23"),
            "vstmia {to}!, {{s20-s23}}",
            "subs {n}, #1",
            "bne 2b",
            scale = in(reg) scale.to_bits(),
            from = inout(reg) from.as_ptr() => _,
            to = inout(reg) to.as_mut_ptr() => _,
            n = inout(reg) n => _,
        );
    }
    8 * n
}

/// [`crate::num::fused::add_eights`]: 19 instructions for eight elements.
#[inline(always)]
pub(in crate::num) fn add_eights(from: &[f16], sums: &mut [f32; 8]) -> usize {
    let n = blocks(from, from.len());
    if n == 0 {
        return 0;
    }
    // SAFETY: 8 n elements lie in the slice.
    unsafe {
        asm_all!(
            "vldmia {sums}, {{s0-s7}}",
            "2:",
            "vldmia {from}!, {{s8-s11}}",
            widen_eight!("s8" "s9" "s10" "s11" => "s12" "s13" "s14" "s15" "s16" "s17" "s18" "s19"),
            "vadd.f32 s0, s0, s12",
            "vadd.f32 s1, s1, s13",
            "vadd.f32 s2, s2, s14",
            "vadd.f32 s3, s3, s15",
            "vadd.f32 s4, s4, s16",
            "vadd.f32 s5, s5, s17",
            "vadd.f32 s6, s6, s18",
            "vadd.f32 s7, s7, s19",
            "subs {n}, #1",
            "bne 2b",
            "vstmia {sums}, {{s0-s7}}",
            sums = in(reg) sums,
            from = inout(reg) from.as_ptr() => _,
            n = inout(reg) n => _,
        );
    }
    8 * n
}

/// The loop of [`widen_alternate`]. `convert` selects the half of each word.
macro_rules! alternate {
    ($convert:literal, $from:ident, $to:ident, $n:ident) => {
        asm_all!(
            "2:",
            "vldmia {from}!, {{s0-s7}}",
            concat!($convert, " s8, s0"),
            concat!($convert, " s9, s1"),
            concat!($convert, " s10, s2"),
            concat!($convert, " s11, s3"),
            concat!($convert, " s12, s4"),
            concat!($convert, " s13, s5"),
            concat!($convert, " s14, s6"),
            concat!($convert, " s15, s7"),
            "vstmia {to}!, {{s8-s15}}",
            "subs {n}, #1",
            "bne 2b",
            from = inout(reg) $from.as_ptr() => _,
            to = inout(reg) $to.as_mut_ptr() => _,
            n = inout(reg) $n => _,
        )
    };
}

/// [`crate::num::fused::widen_alternate`]: 12 instructions for eight elements.
#[inline(always)]
pub(in crate::num) fn widen_alternate(from: &[f16], first: usize, to: &mut [f32]) -> usize {
    let n = blocks(from, from.len()) / 2;
    let n = n.min(to.len() / 8);
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

/// [`crate::num::fused::round_interleaved`]: 22 instructions for four pairs. Returns how many pairs are done.
#[inline(always)]
pub(in crate::num) fn round_interleaved(even: &[f32], odd: &[f32], to: &mut [f32]) -> usize {
    let n = even.len().min(odd.len()).min(to.len() / 2) / 4;
    if n == 0 {
        return 0;
    }
    // SAFETY: 4 n elements lie in `even` and `odd`, twice as many in `to`.
    unsafe {
        asm_low!(
            "2:",
            "vldmia {even}!, {{s0-s3}}",
            "vldmia {odd}!, {{s4-s7}}",
            "vcvtb.f16.f32 s8, s0",
            "vcvtb.f16.f32 s9, s4",
            "vcvtb.f16.f32 s10, s1",
            "vcvtb.f16.f32 s11, s5",
            "vcvtb.f16.f32 s12, s2",
            "vcvtb.f16.f32 s13, s6",
            "vcvtb.f16.f32 s14, s3",
            "vcvtb.f16.f32 s15, s7",
            "vcvtb.f32.f16 s8, s8",
            "vcvtb.f32.f16 s9, s9",
            "vcvtb.f32.f16 s10, s10",
            "vcvtb.f32.f16 s11, s11",
            "vcvtb.f32.f16 s12, s12",
            "vcvtb.f32.f16 s13, s13",
            "vcvtb.f32.f16 s14, s14",
            "vcvtb.f32.f16 s15, s15",
            "vstmia {to}!, {{s8-s15}}",
            "subs {n}, #1",
            "bne 2b",
            even = inout(reg) even.as_ptr() => _,
            odd = inout(reg) odd.as_ptr() => _,
            to = inout(reg) to.as_mut_ptr() => _,
            n = inout(reg) n => _,
        );
    }
    4 * n
}
