//! Columns of pairs of halves, four side by side, and the transform between. Sixteen bytes hold the pairs of four columns: real parts
//! are the low halves of their words, imaginary parts the high ones.

use super::super::asm_all;
use super::{Four, shift, transform, unflushed};
use crate::num::f16;
use crate::num::pairs::Parts;

/// Whether `halves` hold `len` groups of four pairs a stride apart.
#[inline(always)]
fn check(halves: usize, stride: usize, len: usize) {
    assert!(stride >= 8 && halves + stride >= len * stride + 8, "{halves} halves are too few");
}

/// Widens the pairs at `from[i * stride..][..8]` to the places of `to` whose numbers have the bits of `i` reversed. 28 instructions for
/// four.
#[inline(always)]
pub(crate) fn gather_columns(from: &[f16], stride: usize, to: &mut [Four]) {
    let len = to.len();
    assert!(len.is_power_of_two() && len >= 4, "{len} places");
    check(from.len(), stride, len);
    let quarter = len / 4 * stride;
    // SAFETY: a quarter of the pairs lies behind each of the four addresses, and `to` has a place for each.
    unsafe {
        let from = from.as_ptr();
        asm_all!(
            "dls lr, {n}",
            "2:",
            // Numbers i, i + n/2, i + n/4, i + 3n/4 lie side by side when their bits are reversed.
            "rbit {t}, {i}",
            "vldrh.u16 q0, [{p0}]",
            "add {t}, {t}, {to}",
            "vldrh.u16 q1, [{p2}]",
            "vcvtb.f32.f16 q4, q0",
            "vldrh.u16 q2, [{p1}]",
            "vcvtt.f32.f16 q5, q0",
            "vldrh.u16 q3, [{p3}]",
            "vcvtb.f32.f16 q6, q1",
            "vstrw.32 q4, [{t}]",
            "vcvtt.f32.f16 q7, q1",
            "vstrw.32 q5, [{t}, #16]",
            "vcvtb.f32.f16 q4, q2",
            "vstrw.32 q6, [{t}, #32]",
            "vcvtt.f32.f16 q5, q2",
            "vstrw.32 q7, [{t}, #48]",
            "vcvtb.f32.f16 q6, q3",
            "vstrw.32 q4, [{t}, #64]",
            "vcvtt.f32.f16 q7, q3",
            "vstrw.32 q5, [{t}, #80]",
            "vstrw.32 q6, [{t}, #96]",
            "vstrw.32 q7, [{t}, #112]",
            "add {p0}, {p0}, {stride}",
            "add {p1}, {p1}, {stride}",
            "add {p2}, {p2}, {stride}",
            "add {p3}, {p3}, {stride}",
            "add {i}, {i}, {one}",
            "le lr, 2b",
            t = out(reg) _,
            n = in(reg) len / 4,
            p0 = inout(reg) from => _,
            p1 = inout(reg) from.add(quarter) => _,
            p2 = inout(reg) from.add(2 * quarter) => _,
            p3 = inout(reg) from.add(3 * quarter) => _,
            stride = in(reg) stride * size_of::<f16>(),
            i = inout(reg) 0 => _,
            one = in(reg) 1_u32 << shift(len),
            to = in(reg) to.as_mut_ptr(),
            out("lr") _,
        );
    }
}

/// Adds the products of two spectra, four columns of them, imaginary part first, to the places of `to` whose numbers have the bits of
/// `i` reversed. All products are exact, and sums multiples of 2^-48. 20 instructions a number.
#[inline(always)]
pub(crate) fn add_product_columns(k: &[f16], x: &[f16], stride: usize, to: &mut [Four]) {
    let len = to.len();
    assert!(len.is_power_of_two() && len >= 2, "{len} places");
    check(k.len(), stride, len);
    check(x.len(), stride, len);
    // SAFETY: the pairs and the places are there.
    unsafe {
        asm_all!(
            "dls lr, {n}",
            "2:",
            "rbit {t}, {i}",
            "vldrh.u16 q0, [{k}]",
            "add {t}, {t}, {to}",
            "vldrh.u16 q1, [{x}]",
            "vcvtb.f32.f16 q2, q0",
            "vldrw.u32 q6, [{t}]",
            "vcvtt.f32.f16 q3, q0",
            "vldrw.u32 q7, [{t}, #16]",
            "vcvtb.f32.f16 q4, q1",
            "vcvtt.f32.f16 q5, q1",
            "vfma.f32 q7, q2, q4",
            "vfma.f32 q6, q2, q5",
            "vfms.f32 q7, q3, q5",
            "vfma.f32 q6, q3, q4",
            "add {k}, {k}, {stride}",
            "vstrw.32 q7, [{t}, #16]",
            "add {x}, {x}, {stride}",
            "vstrw.32 q6, [{t}]",
            "add {i}, {i}, {one}",
            "le lr, 2b",
            t = out(reg) _,
            n = in(reg) len,
            k = inout(reg) k.as_ptr() => _,
            x = inout(reg) x.as_ptr() => _,
            stride = in(reg) stride * size_of::<f16>(),
            i = inout(reg) 0 => _,
            one = in(reg) 1_u32 << shift(len),
            to = in(reg) to.as_mut_ptr(),
            out("lr") _,
        );
    }
}

/// Transforms four columns in their places. False where Helium flushed a number.
pub(crate) fn transform_columns(data: &mut [Four]) -> bool {
    unflushed(|| transform(data))
}

/// The loop of [`scatter_columns`]: which half of the word each number goes to.
macro_rules! scatter {
    ($first:literal, $second:literal, $from:ident, $scale:ident, $to:ident, $stride:ident) => {
        asm_all!(
            "dls lr, {n}",
            "2:",
            "vldrw.u32 q0, [{from}], #16",
            "vldrw.u32 q1, [{from}], #16",
            "vmul.f32 q0, q0, {scale}",
            "vmul.f32 q1, q1, {scale}",
            concat!($first, ".f16.f32 q2, q0"),
            concat!($second, ".f16.f32 q2, q1"),
            "vstrh.16 q2, [{to}]",
            "add {to}, {to}, {stride}",
            "le lr, 2b",
            scale = in(reg) $scale.to_bits(),
            from = inout(reg) $from.as_ptr() => _,
            to = inout(reg) $to.as_mut_ptr() => _,
            stride = in(reg) $stride * size_of::<f16>(),
            n = in(reg) $from.len(),
            out("lr") _,
        )
    };
}

/// Scales by `scale`, a power of two, and narrows four columns into `to[i * stride..][..8]`; 9 instructions a number. A number that is
/// flushed here is far below the smallest half.
#[inline(always)]
pub(crate) fn scatter_columns(from: &[Four], scale: f32, parts: Parts, to: &mut [f16], stride: usize) {
    if from.is_empty() {
        return;
    }
    check(to.len(), stride, from.len());
    // SAFETY: the pairs and their places are there.
    unsafe {
        match parts {
            Parts::InOrder => scatter!("vcvtb", "vcvtt", from, scale, to, stride),
            Parts::Exchanged => scatter!("vcvtt", "vcvtb", from, scale, to, stride),
        }
    }
}
