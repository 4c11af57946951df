//! Loops at loads and stores of the integer convolution with features of 16 bits, and its attention. Each routine
//! returns the number of elements that it has done.

use super::asm_push;
use crate::num::f16;

/// `to = saturate(max(rescale(sum), least))`: six instructions for four sums.
#[inline(always)]
pub(crate) fn rescale_row(sums: &[i32], multiplier: i32, least: i32, to: &mut [i16]) -> usize {
    let n = sums.len().min(to.len()) / 4;
    if n > 0 {
        // SAFETY: 4 n elements lie in both slices.
        unsafe {
            asm_push!(
                "vdup.32 q2, r2",
                "vdup.32 q3, r3",
                "dls lr, r4",
                "2:",
                "vldrw.u32 q0, [r0], #16",
                "vrmulh.s32 q0, q0, q2",
                "vmax.s32 q0, q0, q3",
                "vqmovnb.s32 q0, q0",
                "vstrh.32 q0, [r1], #8",
                "le lr, 2b",
                inout("r0") sums.as_ptr() => _,
                inout("r1") to.as_mut_ptr() => _,
                in("r2") multiplier,
                in("r3") least,
                in("r4") n,
                out("lr") _,
            );
        }
    }
    4 * n
}

/// `to = saturate(to + max(rescale(sum), least))`: eight instructions for four sums.
#[inline(always)]
pub(crate) fn accumulate_row(sums: &[i32], multiplier: i32, least: i32, to: &mut [i16]) -> usize {
    let n = sums.len().min(to.len()) / 4;
    if n > 0 {
        // SAFETY: 4 n elements lie in both slices.
        unsafe {
            asm_push!(
                "vdup.32 q2, r2",
                "vdup.32 q3, r3",
                "dls lr, r4",
                "2:",
                "vldrw.u32 q0, [r0], #16",
                "vrmulh.s32 q0, q0, q2",
                "vldrh.s32 q1, [r1]",
                "vmax.s32 q0, q0, q3",
                "vadd.i32 q0, q0, q1",
                "vqmovnb.s32 q0, q0",
                "vstrh.32 q0, [r1], #8",
                "le lr, 2b",
                inout("r0") sums.as_ptr() => _,
                inout("r1") to.as_mut_ptr() => _,
                in("r2") multiplier,
                in("r3") least,
                in("r4") n,
                out("lr") _,
            );
        }
    }
    4 * n
}

/// Halfwords from a column to the next in rows of groups, and to the next but one.
const COLUMN: usize = 8;

/// Writes each number into the first place of the next group of eight: four instructions for eight numbers.
#[inline(always)]
pub(crate) fn spread(from: &[i16], to: &mut [i16]) -> usize {
    static PLACES: [u16; 8] = [0, 8, 16, 24, 32, 40, 48, 56];
    let n = from.len().min(to.len() / COLUMN) / 8;
    if n > 0 {
        // SAFETY: 8 n numbers lie in `from`, 8 n groups in `to`.
        unsafe {
            asm_push!(
                "vldrh.u16 q1, [r2]",
                "dls lr, r4",
                "2:",
                "vldrh.u16 q0, [r0], #16",
                "vstrh.16 q0, [r1, q1, uxtw #1]",
                "add r1, r1, #128",
                "le lr, 2b",
                inout("r0") from.as_ptr() => _,
                inout("r1") to.as_mut_ptr() => _,
                in("r2") PLACES.as_ptr(),
                in("r4") n,
                out("lr") _,
            );
        }
    }
    8 * n
}

/// Writes `saturate(floor(x scale / 2^15 + 1/2))` of every other half, from the first (or, with `odd`, from the second)
/// on, into the first place of the next group of eight: eight instructions for four numbers. Products are multiples of
/// 2^-24, so that nothing is flushed.
#[inline(always)]
pub(crate) fn spread_halves(from: &[f16], odd: bool, scale: f32, to: &mut [i16]) -> usize {
    static PLACES: [u32; 4] = [0, 8, 16, 24];
    macro_rules! run {
        ($widen:literal, $n:expr) => {
            asm_push!(
                "vldrw.u32 q2, [r3]",
                "dls lr, r4",
                "2:",
                "vldrh.u16 q0, [r0], #16",
                concat!($widen, " q0, q0"),
                "vmul.f32 q0, q0, r2",
                "vcvt.s32.f32 q0, q0",
                "vqrshrnb.s32 q0, q0, #15",
                "vstrh.32 q0, [r1, q2, uxtw #1]",
                "add r1, r1, #64",
                "le lr, 2b",
                inout("r0") from.as_ptr() => _,
                inout("r1") to.as_mut_ptr() => _,
                in("r2") scale.to_bits(),
                in("r3") PLACES.as_ptr(),
                in("r4") $n,
                out("lr") _,
            )
        };
    }
    let n = (from.len() / 2).min(to.len() / COLUMN) / 4;
    if n > 0 {
        // SAFETY: 8 n halves lie in `from`, 4 n groups in `to`.
        unsafe {
            if odd {
                run!("vcvtt.f32.f16", n);
            } else {
                run!("vcvtb.f32.f16", n);
            }
        }
    }
    4 * n
}

/// Writes `saturate(rescale(sum))` into the first place of every other group: six instructions for four sums.
#[inline(always)]
pub(crate) fn spread_rescaled(sums: &[i32], multiplier: i32, to: &mut [i16]) -> usize {
    static PLACES: [u32; 4] = [0, 16, 32, 48];
    let n = sums.len().min(to.len() / (2 * COLUMN)) / 4;
    if n > 0 {
        // SAFETY: 4 n sums lie in `sums`, 8 n groups in `to`.
        unsafe {
            asm_push!(
                "vldrw.u32 q1, [r3]",
                "vdup.32 q2, r2",
                "dls lr, r4",
                "2:",
                "vldrw.u32 q0, [r0], #16",
                "vrmulh.s32 q0, q0, q2",
                "vqmovnb.s32 q0, q0",
                "vstrh.32 q0, [r1, q1, uxtw #1]",
                "add r1, r1, #128",
                "le lr, 2b",
                inout("r0") sums.as_ptr() => _,
                inout("r1") to.as_mut_ptr() => _,
                in("r2") multiplier,
                in("r3") PLACES.as_ptr(),
                in("r4") n,
                out("lr") _,
            );
        }
    }
    4 * n
}

/// `g = saturate(g + floor(scale t / 2^15 + 1/2))` with a scale that is not negative: six instructions for eight
/// numbers.
#[inline(always)]
pub(crate) fn add_scaled(scale: i16, t: &[i16], g: &mut [i16]) -> usize {
    let n = t.len().min(g.len()) / 8;
    if n > 0 {
        // SAFETY: 8 n elements lie in both slices.
        unsafe {
            asm_push!(
                "dls lr, r4",
                "2:",
                "vldrh.u16 q0, [r0], #16",
                "vqrdmulh.s16 q0, q0, r2",
                "vldrh.u16 q1, [r1]",
                "vqadd.s16 q0, q0, q1",
                "vstrh.16 q0, [r1], #16",
                "le lr, 2b",
                inout("r0") t.as_ptr() => _,
                inout("r1") g.as_mut_ptr() => _,
                in("r2") i32::from(scale),
                in("r4") n,
                out("lr") _,
            );
        }
    }
    8 * n
}

/// Adds numbers to a sum, which must not overflow: three instructions for eight.
#[inline(always)]
pub(crate) fn add(from: &[i16], sum: &mut i32) -> usize {
    let n = from.len() / 8;
    if n > 0 {
        // SAFETY: 8 n elements lie in the slice.
        unsafe {
            asm_push!(
                "dls lr, r4",
                "2:",
                "vldrh.u16 q0, [r0], #16",
                "vaddva.s16 r2, q0",
                "le lr, 2b",
                inout("r0") from.as_ptr() => _,
                inout("r2") *sum,
                in("r4") n,
                out("lr") _,
            );
        }
    }
    8 * n
}
