//! Loops at loads and stores of the integer convolution with features of 8 bits, and its attention. Each routine
//! returns the number of elements that it has done.

use super::asm_push;

/// Bytes from a column to the next in rows of groups.
const COLUMN: usize = 16;
/// The largest and the smallest feature.
const MOST: i32 = i8::MAX as i32;
const LEAST: i32 = i8::MIN as i32;

/// `to = saturate(max(rescale(sum), least))`: six instructions for four sums.
#[inline(always)]
pub(crate) fn rescale_row(sums: &[i32], multiplier: i32, least: i32, to: &mut [i8]) -> usize {
    let n = sums.len().min(to.len()) / 4;
    if n > 0 {
        // SAFETY: 4 n elements lie in both slices.
        unsafe {
            asm_push!(
                "vdup.32 q2, r2",
                "vdup.32 q3, r3",
                "vdup.32 q4, r5",
                "dls lr, r4",
                "2:",
                "vldrw.u32 q0, [r0], #16",
                "vrmulh.s32 q0, q0, q2",
                "vmax.s32 q0, q0, q3",
                "vmin.s32 q0, q0, q4",
                "vstrb.32 q0, [r1], #4",
                "le lr, 2b",
                inout("r0") sums.as_ptr() => _,
                inout("r1") to.as_mut_ptr() => _,
                in("r2") multiplier,
                in("r3") least.max(LEAST),
                in("r4") n,
                in("r5") MOST,
                out("lr") _,
            );
        }
    }
    4 * n
}

/// `to = saturate(to + max(rescale(sum), least))`: nine instructions for four sums.
#[inline(always)]
pub(crate) fn accumulate_row(sums: &[i32], multiplier: i32, least: i32, to: &mut [i8]) -> usize {
    let n = sums.len().min(to.len()) / 4;
    if n > 0 {
        // SAFETY: 4 n elements lie in both slices.
        unsafe {
            asm_push!(
                "vdup.32 q2, r2",
                "vdup.32 q3, r3",
                "vdup.32 q4, r5",
                "vmvn.i32 q5, #127",
                "dls lr, r4",
                "2:",
                "vldrw.u32 q0, [r0], #16",
                "vrmulh.s32 q0, q0, q2",
                "vldrb.s32 q1, [r1]",
                "vmax.s32 q0, q0, q3",
                "vadd.i32 q0, q0, q1",
                "vmin.s32 q0, q0, q4",
                "vmax.s32 q0, q0, q5",
                "vstrb.32 q0, [r1], #4",
                "le lr, 2b",
                inout("r0") sums.as_ptr() => _,
                inout("r1") to.as_mut_ptr() => _,
                in("r2") multiplier,
                in("r3") least,
                in("r4") n,
                in("r5") MOST,
                out("lr") _,
            );
        }
    }
    4 * n
}

/// Writes each number into the first place of the next group of sixteen: four instructions for sixteen numbers.
#[inline(always)]
pub(crate) fn spread(from: &[i8], to: &mut [i8]) -> usize {
    static PLACES: [u8; 16] = [0, 16, 32, 48, 64, 80, 96, 112, 128, 144, 160, 176, 192, 208, 224, 240];
    let n = from.len().min(to.len() / COLUMN) / 16;
    if n > 0 {
        // SAFETY: 16 n numbers lie in `from`, 16 n groups in `to`.
        unsafe {
            asm_push!(
                "vldrb.u8 q1, [r2]",
                "dls lr, r4",
                "2:",
                "vldrb.u8 q0, [r0], #16",
                "vstrb.8 q0, [r1, q1]",
                "add r1, r1, #256",
                "le lr, 2b",
                inout("r0") from.as_ptr() => _,
                inout("r1") to.as_mut_ptr() => _,
                in("r2") PLACES.as_ptr(),
                in("r4") n,
                out("lr") _,
            );
        }
    }
    16 * n
}

/// Writes `saturate(rescale(sum))` into the first place of every other group: seven instructions for four sums.
#[inline(always)]
pub(crate) fn spread_rescaled(sums: &[i32], multiplier: i32, to: &mut [i8]) -> usize {
    static PLACES: [u32; 4] = [0, 32, 64, 96];
    let n = sums.len().min(to.len() / (2 * COLUMN)) / 4;
    if n > 0 {
        // SAFETY: 4 n sums lie in `sums`, 8 n groups in `to`.
        unsafe {
            asm_push!(
                "vldrw.u32 q1, [r3]",
                "vdup.32 q2, r2",
                "vdup.32 q3, r5",
                "vdup.32 q4, r8",
                "dls lr, r4",
                "2:",
                "vldrw.u32 q0, [r0], #16",
                "vrmulh.s32 q0, q0, q2",
                "vmax.s32 q0, q0, q3",
                "vmin.s32 q0, q0, q4",
                "vstrb.32 q0, [r1, q1]",
                "add r1, r1, #128",
                "le lr, 2b",
                inout("r0") sums.as_ptr() => _,
                inout("r1") to.as_mut_ptr() => _,
                in("r2") multiplier,
                in("r3") PLACES.as_ptr(),
                in("r4") n,
                in("r5") LEAST,
                in("r8") MOST,
                out("lr") _,
            );
        }
    }
    4 * n
}

/// `g = saturate(g + floor(scale t / 2^15 + 1/2))` with a scale that is not negative: seven instructions for eight
/// numbers.
#[inline(always)]
pub(crate) fn add_scaled(scale: i16, t: &[i8], g: &mut [i8]) -> usize {
    let n = t.len().min(g.len()) / 8;
    if n > 0 {
        // SAFETY: 8 n elements lie in both slices.
        unsafe {
            asm_push!(
                "dls lr, r4",
                "2:",
                "vldrb.s16 q0, [r0], #8",
                "vqrdmulh.s16 q0, q0, r2",
                "vldrb.s16 q1, [r1]",
                "vadd.i16 q0, q0, q1",
                "vqmovnb.s16 q0, q0",
                "vstrb.16 q0, [r1], #8",
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

/// Adds numbers to a sum, which must not overflow: three instructions for sixteen.
#[inline(always)]
pub(crate) fn add(from: &[i8], sum: &mut i32) -> usize {
    let n = from.len() / 16;
    if n > 0 {
        // SAFETY: 16 n elements lie in the slice.
        unsafe {
            asm_push!(
                "dls lr, r4",
                "2:",
                "vldrb.u8 q0, [r0], #16",
                "vaddva.s8 r2, q0",
                "le lr, 2b",
                inout("r0") from.as_ptr() => _,
                inout("r2") *sum,
                in("r4") n,
                out("lr") _,
            );
        }
    }
    16 * n
}
