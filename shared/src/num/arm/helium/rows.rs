//! Rows of real transforms, four side by side: the steps of [`crate::fft`] before and after the complex transform of
//! half their length.

use super::fft::{join, last_to_rows, radix4_of_ones};
use super::{Four, rows_at, shift, unflushed};
use crate::fft::ROOT_TRIPLES;
use crate::num::f16;

/// Distance in the table between the roots `e^(-2 pi i k / n)` of neighbouring k, and the first of them, k = 1.
fn roots(n: usize) -> (usize, *const [f32; 2]) {
    let stride = (4 * ROOT_TRIPLES.len() / n).min(ROOT_TRIPLES.len() - 1);
    (stride * size_of_val(&ROOT_TRIPLES[0]), &ROOT_TRIPLES[stride][1])
}

/// Places of a transform that these loops can run over.
fn fits(len: usize) -> bool {
    len.is_power_of_two() && len >= 4 && len <= 2 * ROOT_TRIPLES.len()
}

/// Twice the real transforms of four rows, one behind the other in `from`, into four rows of halves. `data` is scratch.
/// Returns false where Helium flushed a number.
pub(crate) fn forward_rows(from: &[f32], data: &mut [Four], rows: &mut [f16]) -> bool {
    let half = data.len();
    let lens = [from.len(), rows.len()];
    assert!(fits(half) && lens == [8 * half, 4 * (2 * half + 2)], "rows of {lens:?} numbers");
    unflushed(|| {
        order(from, data);
        join(data.len(), data);
        untangle(data, rows);
    })
}

/// Copies the pairs of four rows, computes the butterflies of four neighbours, and writes each to the index with
/// reversed bits. 42 instructions for four pairs of each row.
#[inline(always)]
fn order(rows: &[f32], to: &mut [Four]) {
    let len = to.len();
    let from = rows_at(rows.as_ptr(), 2 * len * size_of::<f32>());
    // SAFETY: four pairs are read of each row and written to their places, for all pairs of a row.
    unsafe {
        asm_all!(
            "vldrw.u32 q7, [{from}]",
            "vsub.i32 q7, q7, {eight}",
            "dls lr, {n}",
            "2:",
            // Numbers i, i + n/2, i + n/4, i + 3n/4 lie side by side when their bits are reversed.
            "rbit {t}, {i}",
            "vldrw.u32 q0, [q7, #8]!",
            "add {t}, {t}, {to}",
            "vadd.i32 q7, q7, {quarter}",
            "vldrw.u32 q1, [q7]",
            "vadd.i32 q7, q7, {quarter}",
            "vldrw.u32 q2, [q7]",
            "vadd.i32 q7, q7, {quarter}",
            "vldrw.u32 q3, [q7]",
            "vadd.f32 q4, q0, q2",
            "vsub.f32 q0, q0, q2",
            "vadd.f32 q2, q1, q3",
            "vsub.f32 q1, q1, q3",
            "vadd.f32 q3, q4, q2",
            "vsub.f32 q4, q4, q2",
            "vstrw.32 q3, [{t}]",
            // Imaginary parts, on the way back.
            "vldrw.u32 q2, [q7, #4]",
            "vsub.i32 q7, q7, {quarter}",
            "vstrw.32 q4, [{t}, #64]",
            "vldrw.u32 q3, [q7, #4]",
            "vsub.i32 q7, q7, {quarter}",
            "vldrw.u32 q4, [q7, #4]",
            "vsub.i32 q7, q7, {quarter}",
            "vldrw.u32 q5, [q7, #4]",
            "vadd.f32 q6, q4, q2",
            "vsub.f32 q4, q4, q2",
            "vadd.f32 q2, q5, q3",
            "vsub.f32 q5, q5, q3",
            "vadd.f32 q3, q2, q6",
            "vsub.f32 q2, q2, q6",
            "vstrw.32 q3, [{t}, #16]",
            "vstrw.32 q2, [{t}, #80]",
            // The difference times -i.
            "vadd.f32 q3, q0, q4",
            "vsub.f32 q0, q0, q4",
            "vstrw.32 q3, [{t}, #32]",
            "vsub.f32 q2, q5, q1",
            "vstrw.32 q0, [{t}, #96]",
            "vadd.f32 q5, q5, q1",
            "vstrw.32 q2, [{t}, #48]",
            "vstrw.32 q5, [{t}, #112]",
            "add {i}, {i}, {one}",
            "le lr, 2b",
            t = out(reg) _,
            from = in(reg) &from,
            eight = in(reg) 8,
            quarter = in(reg) 2 * len * size_of::<f32>() / 4,
            i = inout(reg) 0 => _,
            one = in(reg) 1_u32 << shift(len),
            n = in(reg) len / 4,
            to = in(reg) to.as_mut_ptr(),
            out("lr") _,
        );
    }
}

/// The second half of a forward transform of [`crate::fft::RealFft`], narrowed into four rows. Number 0 holds those at
/// 0 and N/2, which are real. 29 instructions for two numbers.
#[inline(always)]
fn untangle(data: &[Four], rows: &mut [f16]) {
    let half = data.len();
    let (step, root) = roots(2 * half);
    let to = rows_at(rows.as_mut_ptr(), (2 * half + 2) * size_of::<f16>());
    // SAFETY: number 0 is read, then 1 to half - 1 from both ends, then the one in the middle; half + 1 pairs of each
    // row are written, the addresses being those of `rows`; as many roots lie in the table. The status before numbers
    // are narrowed is restored behind it.
    unsafe {
        asm_all!(
            "vldrw.u32 q7, [{to}]",
            "vadd.i32 q6, q7, {end}",
            // Number 0: (2 (re + im), 2 (re - im)).
            "vldrw.u32 q1, [{z}, #16]",
            "vldrw.u32 q0, [{z}], #32",
            "vadd.f32 q2, q0, q1",
            "vsub.f32 q3, q0, q1",
            "vadd.f32 q2, q2, q2",
            "vadd.f32 q3, q3, q3",
            "vmrs {t}, fpscr",
            "vmov.i32 q0, #0",
            "vmov.i32 q1, #0",
            "vcvtb.f16.f32 q0, q2",
            "vcvtb.f16.f32 q1, q3",
            "vmsr fpscr, {t}",
            "vstrw.32 q0, [q7]",
            "vstrw.32 q1, [q6]",
            "dls lr, {n}",
            "2:",
            "vldrw.u32 q1, [{z}, #16]",
            "vldrw.u32 q3, [{m}, #16]",
            "vldrw.u32 q0, [{z}], #32",
            "vldrw.u32 q5, [{m}], #-32",
            "ldrd {t}, {u}, [{w}]",
            "add {w}, {w}, {step}",
            // even = z + conj m to q4, q2; odd = -i (z - conj m) to q1, q0
            "vadd.f32 q4, q0, q5",
            "vsub.f32 q2, q1, q3",
            "vadd.f32 q1, q1, q3",
            "vsub.f32 q0, q5, q0",
            // odd times the root to q3, q1
            "vmul.f32 q3, q1, {t}",
            "vmul.f32 q5, q0, {u}",
            "vmul.f32 q1, q1, {u}",
            "vmul.f32 q0, q0, {t}",
            "vsub.f32 q3, q3, q5",
            "vadd.f32 q1, q1, q0",
            // even + odd, conj(even - odd)
            "vadd.f32 q0, q4, q3",
            "vsub.f32 q4, q4, q3",
            "vadd.f32 q3, q2, q1",
            "vsub.f32 q1, q1, q2",
            "vmrs {t}, fpscr",
            "vcvtb.f16.f32 q0, q0",
            "vcvtb.f16.f32 q4, q4",
            "vcvtt.f16.f32 q0, q3",
            "vcvtt.f16.f32 q4, q1",
            "vmsr fpscr, {t}",
            "vstrw.32 q0, [q7, #4]!",
            "vstrw.32 q4, [q6, #-4]!",
            "le lr, 2b",
            // The middle: (2 re, -2 im).
            "vldrw.u32 q0, [{z}]",
            "vldrw.u32 q1, [{z}, #16]",
            "vadd.f32 q0, q0, q0",
            "vadd.f32 q1, q1, q1",
            "vneg.f32 q1, q1",
            "vmrs {t}, fpscr",
            "vcvtb.f16.f32 q0, q0",
            "vcvtt.f16.f32 q0, q1",
            "vmsr fpscr, {t}",
            "vstrw.32 q0, [q7, #4]",
            t = out(reg) _,
            u = out(reg) _,
            n = in(reg) half / 2 - 1,
            end = in(reg) 2 * half * size_of::<f16>(),
            to = in(reg) &to,
            z = inout(reg) data.as_ptr() => _,
            m = inout(reg) data.as_ptr().add(half - 1) => _,
            w = inout(reg) root => _,
            step = in(reg) step,
            out("lr") _,
        );
    }
}

/// Inverse real transforms of four rows of halves one behind the other, scaled, into four rows of numbers. `data` is
/// scratch. Returns false where Helium flushed a number, or where the rows are too short for these loops.
pub(crate) fn inverse_rows(from: &[f16], data: &mut [Four], scale: f32, rows: &mut [f32]) -> bool {
    let half = data.len();
    assert!(fits(half) && from.len() == 4 * (2 * half + 2), "rows of {} halves", from.len());
    half >= 16
        && unflushed(|| {
            tangle(from, data);
            radix4_of_ones(data.as_chunks_mut().0);
            join(half / 4, data);
            last_to_rows(data, scale, rows);
        })
}

/// The first half of an inverse transform of [`crate::fft::RealFft`], four lanes. 33 instructions for two numbers.
#[inline(always)]
fn tangle(from: &[f16], to: &mut [Four]) {
    let half = to.len();
    let (step, root) = roots(2 * half);
    let rows = rows_at(from.as_ptr(), (2 * half + 2) * size_of::<f16>());
    // SAFETY: numbers 0 to half of each row are read, from both ends, and `to` has a place for each; as many roots lie
    // in the table.
    unsafe {
        asm_all!(
            "vldrw.u32 q6, [{rows}]",
            "vadd.i32 q7, q6, {end}",
            // Numbers 0 and N/2: (first - last, first + last).
            "vldrw.u32 q0, [q6]",
            "vldrw.u32 q1, [q7]",
            "vcvtb.f32.f16 q0, q0",
            "vcvtb.f32.f16 q1, q1",
            "vsub.f32 q2, q0, q1",
            "vadd.f32 q3, q0, q1",
            "vstrw.32 q2, [{to}]",
            "vstrw.32 q3, [{to}, #16]",
            // The middle, in place 1: (-2 im, 2 re).
            "vadd.i32 q2, q6, {middle}",
            "vldrw.u32 q0, [q2]",
            "vcvtb.f32.f16 q1, q0",
            "vcvtt.f32.f16 q0, q0",
            "vadd.f32 q0, q0, q0",
            "vneg.f32 q0, q0",
            "vadd.f32 q1, q1, q1",
            "vstrw.32 q0, [{to}, #32]",
            "vstrw.32 q1, [{to}, #48]",
            "dls lr, {n}",
            "2:",
            "vldrw.u32 q0, [q6, #4]!",
            "vldrw.u32 q1, [q7, #-4]!",
            "vcvtb.f32.f16 q2, q0",
            "vcvtt.f32.f16 q3, q0",
            "vcvtb.f32.f16 q4, q1",
            "vcvtt.f32.f16 q5, q1",
            "ldrd {t}, {u}, [{w}]",
            "add {w}, {w}, {step}",
            // even to q0, q1; (x - conj m) to q2, q3
            "vadd.f32 q0, q2, q4",
            "vsub.f32 q1, q3, q5",
            "vsub.f32 q2, q2, q4",
            "vadd.f32 q3, q3, q5",
            // times the conjugate root to q4, q5
            "vmul.f32 q4, q2, {t}",
            "vmul.f32 q5, q3, {u}",
            "vadd.f32 q4, q4, q5",
            "vmul.f32 q5, q3, {t}",
            "vmul.f32 q2, q2, {u}",
            "vsub.f32 q5, q5, q2",
            // even + i odd, conj(even - i odd), imaginary part first
            "vadd.f32 q2, q1, q4",
            "vsub.f32 q3, q0, q5",
            "vsub.f32 q4, q4, q1",
            "vadd.f32 q0, q0, q5",
            "rbit {t}, {k}",
            "add {t}, {t}, {to}",
            "vstrw.32 q2, [{t}]",
            "vstrw.32 q3, [{t}, #16]",
            // The place of half - k.
            "rsb {u}, {k}, #0x08000000",
            "rbit {u}, {u}",
            "add {u}, {u}, {to}",
            "vstrw.32 q4, [{u}]",
            "vstrw.32 q0, [{u}, #16]",
            "add {k}, {k}, {one}",
            "le lr, 2b",
            t = out(reg) _,
            u = out(reg) _,
            n = in(reg) half / 2 - 1,
            middle = in(reg) half * size_of::<f16>(),
            end = in(reg) 2 * half * size_of::<f16>(),
            rows = in(reg) &rows,
            w = inout(reg) root => _,
            step = in(reg) step,
            k = inout(reg) 1_u32 << shift(half) => _,
            one = in(reg) 1_u32 << shift(half),
            to = in(reg) to.as_mut_ptr(),
            out("lr") _,
        );
    }
}
