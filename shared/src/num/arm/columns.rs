//! Columns of pairs of halves, such as complex numbers, a stride apart: see [`crate::num::pairs`].
//!
//! Indices are shifted to the left, so that reversing the bits gives the offset of the element in bytes. Pairs i and i
//! + n/2 are neighbours when the bits are reversed, and i + n/4 and i + 3n/4 follow them.

use crate::num::f16;
use crate::num::pairs::{Parts, check};

/// Shift to the left of an index below `len`, after which `rbit` gives the offset of the element in bytes.
pub(super) const fn shift(len: usize) -> u32 {
    (u32::BITS - size_of::<[f32; 2]>().trailing_zeros()).saturating_sub(len.trailing_zeros())
}

/// Widens `to.len()` pairs, each to the index with reversed bits. 22 instructions for four.
#[inline(always)]
pub(in crate::num) fn gather_pairs(from: &[f16], stride: usize, to: &mut [[f32; 2]]) {
    let len = to.len();
    assert!(len.is_power_of_two() && len >= 4, "{len} places");
    check(from.len(), stride, len);
    // SAFETY: the pairs and the elements exist; only `from` need not be aligned to words.
    unsafe {
        asm_low!(
            "2:",
            "ldr {t}, [{p}]",
            "ldr {u}, [{q}]",
            "vmov s0, s1, {t}, {u}",
            "ldr {t}, [{p}, {quarter}]",
            "ldr {u}, [{q}, {quarter}]",
            "vmov s2, s3, {t}, {u}",
            "add {p}, {p}, {stride}",
            "add {q}, {q}, {stride}",
            "rbit {t}, {i}",
            widen_eight!("s0" "s1" "s2" "s3" => "s4" "s5" "s6" "s7" "s8" "s9" "s10" "s11"),
            "add {t}, {t}, {to}",
            "vstmia {t}, {{s4-s11}}",
            "add {i}, {i}, {one}",
            // A quarter of the places, shifted.
            "cmp {i}, #0x08000000",
            "bne 2b",
            t = out(reg) _,
            u = out(reg) _,
            p = inout(reg) from.as_ptr() => _,
            q = inout(reg) from.as_ptr().add(len / 2 * stride) => _,
            quarter = in(reg) len / 4 * stride * size_of::<f16>(),
            stride = in(reg) stride * size_of::<f16>(),
            i = inout(reg) 0 => _,
            one = in(reg) 1_u32 << shift(len),
            to = in(reg) to.as_mut_ptr(),
        );
    }
}

/// Adds the products of `to.len()` pairs of k and x, each to the index with reversed bits, imaginary part first. 31
/// instructions for two. All products are exact.
#[inline(always)]
pub(in crate::num) fn add_products(k: &[f16], x: &[f16], stride: usize, to: &mut [[f32; 2]]) {
    let len = to.len();
    assert!(len.is_power_of_two() && len >= 2, "{len} places");
    check(k.len(), stride, len);
    check(x.len(), stride, len);
    // SAFETY: the pairs and the elements exist; only `k` and `x` need not be aligned to words.
    unsafe {
        asm_low!(
            "2:",
            "ldr {t}, [{k}]",
            "ldr {u}, [{k}, {far}]",
            "vmov s0, s1, {t}, {u}",
            "ldr {t}, [{x}]",
            "ldr {u}, [{x}, {far}]",
            "vmov s2, s3, {t}, {u}",
            "add {k}, {k}, {stride}",
            "add {x}, {x}, {stride}",
            "rbit {t}, {i}",
            "add {t}, {t}, {to}",
            "vldmia {t}, {{s4-s7}}",
            widen_eight!("s0" "s1" "s2" "s3" => "s8" "s9" "s10" "s11" "s12" "s13" "s14" "s15"),
            "vfma.f32 s4, s8, s13",
            "vfma.f32 s5, s8, s12",
            "vfma.f32 s6, s10, s15",
            "vfma.f32 s7, s10, s14",
            "vfma.f32 s4, s9, s12",
            "vfms.f32 s5, s9, s13",
            "vfma.f32 s6, s11, s14",
            "vfms.f32 s7, s11, s15",
            "vstmia {t}, {{s4-s7}}",
            "add {i}, {i}, {one}",
            // Half the places, shifted.
            "cmp {i}, #0x10000000",
            "bne 2b",
            t = out(reg) _,
            u = out(reg) _,
            k = inout(reg) k.as_ptr() => _,
            x = inout(reg) x.as_ptr() => _,
            far = in(reg) len / 2 * stride * size_of::<f16>(),
            stride = in(reg) stride * size_of::<f16>(),
            i = inout(reg) 0 => _,
            one = in(reg) 1_u32 << shift(len),
            to = in(reg) to.as_mut_ptr(),
        );
    }
}

/// The loop of [`scatter_pairs`]: instructions that come first, and the half of the word that each number goes to.
macro_rules! scatter {
    (
        $scaled:expr, $first:literal $second:literal,
        $from:ident, $to:ident, $stride:ident, $n:ident $(, $scale:ident)?
    ) => {
        asm_all!(
            "2:",
            "vldmia {from}!, {{s0-s7}}",
            $scaled,
            concat!($first, ".f16.f32 s8, s0"),
            concat!($second, ".f16.f32 s8, s1"),
            concat!($first, ".f16.f32 s9, s2"),
            concat!($second, ".f16.f32 s9, s3"),
            concat!($first, ".f16.f32 s10, s4"),
            concat!($second, ".f16.f32 s10, s5"),
            concat!($first, ".f16.f32 s11, s6"),
            concat!($second, ".f16.f32 s11, s7"),
            "vmov {t}, {u}, s8, s9",
            "str {t}, [{to}]",
            "str {u}, [{to}, {stride}]",
            "add {to}, {to}, {stride}, lsl #1",
            "vmov {t}, {u}, s10, s11",
            "str {t}, [{to}]",
            "str {u}, [{to}, {stride}]",
            "add {to}, {to}, {stride}, lsl #1",
            "subs {n}, #1",
            "bne 2b",
            t = out(reg) _,
            u = out(reg) _,
            $(scale = in(reg) $scale.to_bits(),)?
            from = inout(reg) $from.as_ptr() => _,
            to = inout(reg) $to.as_mut_ptr() => _,
            stride = in(reg) $stride * size_of::<f16>(),
            n = inout(reg) $n => _,
        )
    };
}

/// Narrows pairs, and returns the number of pairs done, a multiple of four. 19 instructions for four, 28 with scaling.
#[inline(always)]
pub(in crate::num) fn scatter_pairs(from: &[[f32; 2]], parts: Parts, to: &mut [f16], stride: usize) -> usize {
    check(to.len(), stride, from.len());
    let n = from.len() / 4;
    if n == 0 {
        return 0;
    }
    // SAFETY: the pairs and their destinations exist; only `to` need not be aligned to words.
    unsafe {
        match parts {
            Parts::Scaled(scale) => scatter!(
                concat!(
                    "vmov s16, {scale}\n",
                    "vmul.f32 s0, s0, s16\n",
                    "vmul.f32 s1, s1, s16\n",
                    "vmul.f32 s2, s2, s16\n",
                    "vmul.f32 s3, s3, s16\n",
                    "vmul.f32 s4, s4, s16\n",
                    "vmul.f32 s5, s5, s16\n",
                    "vmul.f32 s6, s6, s16\n",
                    "vmul.f32 s7, s7, s16\n",
                ),
                "vcvtb" "vcvtt", from, to, stride, n, scale
            ),
            Parts::Exchanged => scatter!("", "vcvtt" "vcvtb", from, to, stride, n),
        }
    }
    4 * n
}
