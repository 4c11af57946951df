//! Rows of real transforms, of one lane: the steps of [`crate::fft`] before and after the complex transform of half
//! their length.

use super::columns::shift;
use crate::fft::ROOT_TRIPLES;
use crate::num::f16;

/// Distance in the table between the roots `e^(-2 pi i k / n)` of neighbouring k, and the first of them, k = 1.
fn roots(n: usize) -> (usize, *const [f32; 2]) {
    let stride = (4 * ROOT_TRIPLES.len() / n).min(ROOT_TRIPLES.len() - 1);
    (stride * size_of_val(&ROOT_TRIPLES[0]), &ROOT_TRIPLES[stride][1])
}

/// Lengths of a transform that these loops can run over.
fn fits(len: usize) -> bool {
    len.is_power_of_two() && len >= 4 && len <= 2 * ROOT_TRIPLES.len()
}

/// Copies the pairs of a row to the indices with reversed bits. 10 instructions for four.
pub(crate) fn order_row(row: &[f32], to: &mut [[f32; 2]]) {
    let (quarter, len) = (to.len() / 2, to.len());
    assert!(fits(len) && row.len() == 2 * len, "a row of {} numbers", row.len());
    // SAFETY: a quarter of the pairs lies behind each of the four addresses, and `to` has a place for each.
    unsafe {
        let from = row.as_ptr();
        asm_low!(
            "2:",
            "vldmia {p0}!, {{s0-s1}}",
            "vldmia {p2}!, {{s2-s3}}",
            "vldmia {p1}!, {{s4-s5}}",
            "vldmia {p3}!, {{s6-s7}}",
            "rbit {t}, {i}",
            "add {t}, {t}, {to}",
            "vstmia {t}, {{s0-s7}}",
            "add {i}, {i}, {one}",
            "cmp {i}, #0x08000000",
            "bne 2b",
            p0 = inout(reg) from => _,
            p1 = inout(reg) from.add(quarter) => _,
            p2 = inout(reg) from.add(2 * quarter) => _,
            p3 = inout(reg) from.add(3 * quarter) => _,
            t = out(reg) _,
            i = inout(reg) 0 => _,
            one = in(reg) 1_u32 << shift(len),
            to = in(reg) to.as_mut_ptr(),
        );
    }
}

/// The second half of a forward real transform, for the numbers k and N/2 - k from 1 to N/4 - 1; narrowed into `row`.
/// 25 instructions for two numbers.
pub(crate) fn untangle_row(data: &[[f32; 2]], row: &mut [f16]) {
    let half = data.len();
    assert!(fits(half) && row.len() == 2 * half + 2, "a row of {} halves", row.len());
    let (step, root) = roots(2 * half);
    // SAFETY: numbers 1 to half - 1 are read and written from both ends; as many roots lie in the table.
    unsafe {
        asm_low!(
            "2:",
            "vldmia {z}!, {{s0-s1}}",
            "vldmdb {m}!, {{s2-s3}}",
            "vldmia {w}, {{s4-s5}}",
            "add {w}, {w}, {step}",
            // even = z + conj m
            "vadd.f32 s6, s0, s2",
            "vsub.f32 s7, s1, s3",
            // odd = -i (z - conj m), times the root
            "vadd.f32 s8, s1, s3",
            "vsub.f32 s9, s2, s0",
            "vmul.f32 s10, s8, s4",
            "vmul.f32 s11, s8, s5",
            "vmls.f32 s10, s9, s5",
            "vmla.f32 s11, s9, s4",
            // even + odd, conj(even - odd)
            "vadd.f32 s0, s6, s10",
            "vadd.f32 s1, s7, s11",
            "vsub.f32 s2, s6, s10",
            "vsub.f32 s3, s11, s7",
            "vcvtb.f16.f32 s12, s0",
            "vcvtt.f16.f32 s12, s1",
            "vcvtb.f16.f32 s13, s2",
            "vcvtt.f16.f32 s13, s3",
            "vmov {t}, {u}, s12, s13",
            "str {t}, [{low}], #4",
            "str {u}, [{high}], #-4",
            "subs {n}, #1",
            "bne 2b",
            t = out(reg) _,
            u = out(reg) _,
            z = inout(reg) data.as_ptr().add(1) => _,
            m = inout(reg) data.as_ptr().add(half) => _,
            w = inout(reg) root => _,
            step = in(reg) step,
            low = inout(reg) row.as_mut_ptr().add(2) => _,
            high = inout(reg) row.as_mut_ptr().add(2 * half - 2) => _,
            n = inout(reg) half / 2 - 1 => _,
        );
    }
}

/// The first half of an inverse real transform: [`crate::fft::RealFft::tangle`] for k from 1 to N/4 - 1, from the
/// halves of `row` to the indices with reversed bits. 31 instructions for two numbers.
pub(crate) fn tangle_row(row: &[f16], to: &mut [[f32; 2]]) {
    let half = to.len();
    assert!(fits(half) && row.len() == 2 * half + 2, "a row of {} halves", row.len());
    let (step, root) = roots(2 * half);
    // SAFETY: numbers 1 to half - 1 are read from both ends, and `to` has a place for each; as many roots lie in the
    // table.
    unsafe {
        asm_low!(
            "2:",
            "ldr {t}, [{x}], #4",
            "ldr {u}, [{m}], #-4",
            "vmov s0, s1, {t}, {u}",
            "vcvtb.f32.f16 s2, s0",
            "vcvtt.f32.f16 s3, s0",
            "vcvtb.f32.f16 s4, s1",
            "vcvtt.f32.f16 s5, s1",
            "vldmia {w}, {{s0-s1}}",
            "add {w}, {w}, {step}",
            "vadd.f32 s6, s2, s4",
            "vsub.f32 s7, s3, s5",
            "vsub.f32 s8, s2, s4",
            "vadd.f32 s9, s3, s5",
            // odd = (x - conj m) times the conjugate root
            "vmul.f32 s10, s8, s0",
            "vmul.f32 s11, s9, s0",
            "vmla.f32 s10, s9, s1",
            "vmls.f32 s11, s8, s1",
            // even + i odd, conj(even - i odd), imaginary part first
            "vadd.f32 s12, s7, s10",
            "vsub.f32 s13, s6, s11",
            "vsub.f32 s14, s10, s7",
            "vadd.f32 s15, s6, s11",
            "rbit {t}, {k}",
            "add {t}, {t}, {to}",
            "vstmia {t}, {{s12-s13}}",
            // The place of half - k.
            "rsb {u}, {k}, #0x20000000",
            "rbit {u}, {u}",
            "add {u}, {u}, {to}",
            "vstmia {u}, {{s14-s15}}",
            "add {k}, {k}, {one}",
            "cmp {k}, #0x10000000",
            "bne 2b",
            t = out(reg) _,
            u = out(reg) _,
            x = inout(reg) row.as_ptr().add(2) => _,
            m = inout(reg) row.as_ptr().add(2 * half - 2) => _,
            w = inout(reg) root => _,
            step = in(reg) step,
            k = inout(reg) 1_u32 << shift(half) => _,
            one = in(reg) 1_u32 << shift(half),
            to = in(reg) to.as_mut_ptr(),
        );
    }
}

/// Writes pairs, scaled, the second number first. 12 instructions for four.
pub(crate) fn scale_row(from: &[[f32; 2]], scale: f32, to: &mut [f32]) {
    let n = from.len() / 4;
    assert!(fits(from.len()) && to.len() == 2 * from.len(), "a row of {} numbers", to.len());
    // SAFETY: goes through both slices once.
    unsafe {
        asm_all!(
            "vmov s16, {scale}",
            "2:",
            "vldmia {from}!, {{s0-s7}}",
            "vmul.f32 s9, s0, s16",
            "vmul.f32 s8, s1, s16",
            "vmul.f32 s11, s2, s16",
            "vmul.f32 s10, s3, s16",
            "vmul.f32 s13, s4, s16",
            "vmul.f32 s12, s5, s16",
            "vmul.f32 s15, s6, s16",
            "vmul.f32 s14, s7, s16",
            "vstmia {to}!, {{s8-s15}}",
            "subs {n}, #1",
            "bne 2b",
            from = inout(reg) from.as_ptr() => _,
            to = inout(reg) to.as_mut_ptr() => _,
            n = inout(reg) n => _,
            scale = in(reg) scale.to_bits(),
        );
    }
}
