//! The logistic function of four numbers at a time, with the operations of [`crate::num::sigmoid`] in their order. No
//! vector unit of a Cortex-M divides: the scalar one does, in the same registers.
//!
//! Helium takes subnormal numbers for zero. An argument so small gives 1/2 either way, as its exponential is 1.

use super::asm_push;
use crate::num::{SATURATED, exp_is_e};
use core::f32::consts::{E, LN_2, LOG2_E};

/// Replaces the leading numbers by their logistic function: 42 instructions for four. Returns how many.
#[inline(always)]
pub(in crate::num) fn sigmoid(numbers: &mut [f32]) -> usize {
    let n = numbers.len() / 4;
    const { assert!(exp_is_e(1.0) && exp_is_e(1.0_f32.next_down()) && !exp_is_e(1.0_f32.next_up())) };
    if n > 0 {
        // SAFETY: 4 n elements lie in the slice.
        unsafe {
            asm_push!(
                "vdup.32 q7, r1",
                "vmov.f32 s24, #3.0",
                "vmov.f32 s25, #1.0",
                "dls lr, r12",
                "2:",
                "vldrw.u32 q0, [r0]",
                // |x|, at most the argument that saturates.
                "vmov q1, q7",
                "vminnma.f32 q1, q0",
                // Whole and fractional part of x / ln 2.
                "vmul.f32 q2, q1, r2",
                "vcvt.s32.f32 q3, q2",
                "vcvt.f32.s32 q4, q3",
                "vsub.f32 q2, q2, q4",
                "vmul.f32 q2, q2, r3",
                // The series.
                "vdiv.f32 s20, s8, s24",
                "vdiv.f32 s21, s9, s24",
                "vdiv.f32 s22, s10, s24",
                "vdiv.f32 s23, s11, s24",
                "vmul.f32 q4, q2, r4",
                "vadd.f32 q4, q4, r5",
                "vmul.f32 q4, q5, q4",
                "vadd.f32 q4, q4, r5",
                "vmul.f32 q5, q2, r8",
                "vmul.f32 q4, q5, q4",
                "vadd.f32 q4, q4, r5",
                "vmul.f32 q4, q2, q4",
                "vadd.f32 q4, q4, r5",
                "vshl.i32 q3, q3, #23",
                "vadd.i32 q4, q4, q3",
                // The two arguments whose exponential is e: their bits differ in the last place of an odd number.
                "vadd.i32 q5, q1, r9",
                "vshr.u32 q5, q5, #1",
                "vpt.i32 eq, q5, r10",
                "vdupt.32 q4, r11",
                "vadd.f32 q4, q4, r5",
                "vdiv.f32 s16, s25, s16",
                "vdiv.f32 s17, s25, s17",
                "vdiv.f32 s18, s25, s18",
                "vdiv.f32 s19, s25, s19",
                "vneg.f32 q5, q4",
                "vadd.f32 q5, q5, r5",
                "vpt.f32 lt, q0, zr",
                "vmovt q5, q4",
                "vstrw.32 q5, [r0], #16",
                "le lr, 2b",
                inout("r0") numbers.as_mut_ptr() => _,
                in("r1") SATURATED.to_bits(),
                in("r2") LOG2_E.to_bits(),
                in("r3") LN_2.to_bits(),
                in("r4") 0.25_f32.to_bits(),
                in("r5") 1.0_f32.to_bits(),
                in("r8") 0.5_f32.to_bits(),
                in("r9") 1,
                in("r10") (1.0_f32.to_bits() + 1) >> 1,
                in("r11") E.to_bits(),
                in("r12") n,
                out("lr") _,
            );
        }
    }
    4 * n
}
