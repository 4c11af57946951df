//! Maxima and counts over whole slices. Numbers are compared as integers, so that Helium flushes nothing: with the bits
//! below the sign of negative ones inverted, floating-point numbers are in the order of integers with a sign.

use crate::num::f16;

/// Adds the number of codes at or above `least` to `count`: four instructions for eight. Returns the number of codes
/// that are done.
#[inline(always)]
pub(in crate::num) fn count_from(least: u16, codes: &[u16], count: &mut u32) -> usize {
    let n = codes.len() / 8;
    if n > 0 {
        // SAFETY: 8 n codes lie in the slice.
        unsafe {
            asm_all!(
                "vmov.i16 q1, #1",
                "dls lr, r4",
                "2:",
                "vldrh.u16 q0, [r0], #16",
                "vpt.u16 cs, q0, r1",
                "vaddvat.u16 r2, q1",
                "le lr, 2b",
                in("r1") u32::from(least),
                in("r4") n,
                inout("r0") codes.as_ptr() => _,
                inout("r2") *count,
                out("lr") _,
            );
        }
    }
    8 * n
}

/// Where floating-point numbers begin in the order of integers; the same function takes a key back to its bits.
#[inline(always)]
const fn key(bits: i32) -> i32 {
    bits ^ ((bits >> 31) & i32::MAX)
}

/// Raises `max` to the largest of some numbers, none of them NaN: six instructions for four. Negative zero is below
/// zero. Returns how many are done.
#[inline(always)]
pub(in crate::num) fn largest(numbers: &[f32], max: &mut f32) -> usize {
    let n = numbers.len() / 4;
    let mut most = key(max.to_bits() as i32);
    if n > 0 {
        // SAFETY: 4 n numbers lie in the slice.
        unsafe {
            asm_all!(
                "vmvn.i32 q2, #0x80000000",
                "dls lr, r4",
                "2:",
                "vldrw.u32 q0, [r0], #16",
                "vshr.s32 q1, q0, #31",
                "vand q1, q1, q2",
                "veor q0, q0, q1",
                "vmaxv.s32 r2, q0",
                "le lr, 2b",
                in("r4") n,
                inout("r0") numbers.as_ptr() => _,
                inout("r2") most,
                out("lr") _,
            );
        }
    }
    *max = f32::from_bits(key(most) as u32);
    4 * n
}

/// Largest half and largest magnitude of some halves, the latter as bits: eight instructions for eight. A half that is
/// not finite has a magnitude from `0x7c00` on. Returns how many are done, eight at least, or `None`.
#[inline(always)]
pub(in crate::num) fn extreme_halves(values: &[f16]) -> Option<(usize, f16, u16)> {
    let n = values.len() / 8;
    if n == 0 {
        return None;
    }
    let (mut most, mut magnitude) = (i32::from(i16::MIN), 0_u32);
    // SAFETY: 8 n halves lie in the slice.
    unsafe {
        asm_all!(
            "vmvn.i16 q2, #0x8000",
            "dls lr, r4",
            "2:",
            "vldrh.u16 q0, [r0], #16",
            "vshr.s16 q1, q0, #15",
            "vand q1, q1, q2",
            "veor q1, q1, q0",
            "vmaxv.s16 r2, q1",
            "vand q0, q0, q2",
            "vmaxv.u16 r3, q0",
            "le lr, 2b",
            in("r4") n,
            inout("r0") values.as_ptr() => _,
            inout("r2") most,
            inout("r3") magnitude,
            out("lr") _,
        );
    }
    Some((8 * n, f16::from_bits(key(most) as u16), magnitude as u16))
}
