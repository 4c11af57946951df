//! Division of halves by the scalar unit: no vector unit of a Cortex-M divides.

use crate::num::f16;

/// Divides by `divisor`, 28 instructions for eight elements. Returns the number of elements done: none where the slice
/// does not begin at a word.
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
            widen_eight!("s9" "s10" "s11" "s12" => "s0" "s1" "s2" "s3" "s4" "s5" "s6" "s7"),
            "vdiv.f32 s0, s0, s8",
            "vdiv.f32 s1, s1, s8",
            "vdiv.f32 s2, s2, s8",
            "vdiv.f32 s3, s3, s8",
            "vdiv.f32 s4, s4, s8",
            "vdiv.f32 s5, s5, s8",
            "vdiv.f32 s6, s6, s8",
            "vdiv.f32 s7, s7, s8",
            narrow_eight!("s9" "s10" "s11" "s12"),
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
