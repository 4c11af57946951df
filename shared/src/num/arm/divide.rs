//! Division of halves: no vector unit of a Cortex-M divides.

use super::asm_low;
use crate::num::f16;

/// Divides by `divisor`, 28 instructions for eight. Returns how many are done: none where the slice does not begin at a word.
#[inline(always)]
pub(in crate::num) fn divide(values: &mut [f16], divisor: f32) -> usize {
    let n = values.len() / 8;
    if n == 0 || !values.as_ptr().addr().is_multiple_of(4) {
        return 0;
    }
    // SAFETY: 8 n elements lie in the slice.
    unsafe {
        asm_low!(
            "vmov s8, {divisor}",
            "2:",
            "vldmia {p}, {{s9-s12}}",
            "vcvtb.f32.f16 s0, s9",
            "vcvtt.f32.f16 s1, s9",
            "vcvtb.f32.f16 s2, s10",
            "vcvtt.f32.f16 s3, s10",
            "vcvtb.f32.f16 s4, s11",
            "vcvtt.f32.f16 s5, s11",
            "vcvtb.f32.f16 s6, s12",
            "vcvtt.f32.f16 s7, s12",
            "vdiv.f32 s0, s0, s8",
            "vdiv.f32 s1, s1, s8",
            "vdiv.f32 s2, s2, s8",
            "vdiv.f32 s3, s3, s8",
            "vdiv.f32 s4, s4, s8",
            "vdiv.f32 s5, s5, s8",
            "vdiv.f32 s6, s6, s8",
            "vdiv.f32 s7, s7, s8",
            "vcvtb.f16.f32 s9, s0",
            "vcvtt.f16.f32 s9, s1",
            "vcvtb.f16.f32 s10, s2",
            "vcvtt.f16.f32 s10, s3",
            "vcvtb.f16.f32 s11, s4",
            "vcvtt.f16.f32 s11, s5",
            "vcvtb.f16.f32 s12, s6",
            "vcvtt.f16.f32 s12, s7",
            "vstmia {p}!, {{s9-s12}}",
            "subs {n}, #1",
            "bne 2b",
            divisor = in(reg) divisor.to_bits(),
            p = inout(reg) values.as_mut_ptr() => _,
            n = inout(reg) n => _,
        );
    }
    8 * n
}
