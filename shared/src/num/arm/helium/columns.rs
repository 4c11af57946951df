//! Columns of pairs of halves, four side by side, and the transform between. Sixteen bytes hold the pairs of four
//! columns: real parts are the low halves of their words, imaginary parts the high ones.

use super::bounds::check;
use super::fft::{join, last_to_columns, transform};
use super::{Four, shift, unflushed};
use crate::num::f16;
use crate::num::pairs::Parts;

/// Transforms four columns, the pairs at `columns[i * stride..][..8]`, in place, scaled. `data` is scratch. Returns
/// false, and writes nothing, where Helium flushed a number.
///
/// Halves are multiples of 2^-24. A pass with the roots of n, none of whose parts but zero is below sin(2 pi / n),
/// rounds to multiples at most 2^24 / sin(2 pi / n) times finer. Up to 256 there are three such passes, which leaves
/// multiples of 2^-107: nothing can be flushed, and the last pass goes to the columns at once.
pub(crate) fn forward_columns(columns: &mut [f16], stride: usize, scale: f32, data: &mut [Four]) -> bool {
    let len = data.len();
    if (16..=256).contains(&len) {
        gather(columns, stride, data);
        join(len / 4, data);
        last_to_columns(data, scale, columns, stride);
        return true;
    }
    let exact = unflushed(|| {
        gather(columns, stride, data);
        join(len, data);
    });
    if exact {
        scatter_columns(data, Parts::Scaled(scale), columns, stride);
    }
    exact
}

/// Widens pairs, computes the butterflies of four neighbours, and writes each to the index with reversed bits. 45
/// instructions for four numbers.
#[inline(always)]
fn gather(from: &[f16], stride: usize, to: &mut [Four]) {
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
            "vldrh.u16 q2, [{p1}]",
            "rbit {t}, {i}",
            "vldrh.u16 q3, [{p3}]",
            "vcvtb.f32.f16 q4, q2",
            "vldrh.u16 q0, [{p0}]",
            "vcvtb.f32.f16 q5, q3",
            "vldrh.u16 q1, [{p2}]",
            "vadd.f32 q6, q4, q5",
            "add {t}, {t}, {to}",
            "vsub.f32 q4, q4, q5",
            "vcvtb.f32.f16 q5, q0",
            "vcvtb.f32.f16 q7, q1",
            "vadd.f32 q3, q5, q7",
            "vsub.f32 q5, q5, q7",
            "vadd.f32 q7, q3, q6",
            "vsub.f32 q3, q3, q6",
            "vstrw.32 q7, [{t}]",
            "vstrw.32 q3, [{t}, #64]",
            // Imaginary parts. No register was left for number 3.
            "vldrh.u16 q3, [{p3}]",
            "vcvtt.f32.f16 q2, q2",
            "vcvtt.f32.f16 q3, q3",
            "vcvtt.f32.f16 q0, q0",
            "vadd.f32 q6, q2, q3",
            "vcvtt.f32.f16 q1, q1",
            "vsub.f32 q2, q2, q3",
            "vadd.f32 q3, q0, q1",
            "vsub.f32 q0, q0, q1",
            "vadd.f32 q7, q3, q6",
            "vsub.f32 q3, q3, q6",
            "vstrw.32 q7, [{t}, #16]",
            "vstrw.32 q3, [{t}, #80]",
            // The difference times -i.
            "vadd.f32 q7, q5, q2",
            "vsub.f32 q5, q5, q2",
            "vstrw.32 q7, [{t}, #32]",
            "vsub.f32 q7, q0, q4",
            "vstrw.32 q5, [{t}, #96]",
            "vadd.f32 q0, q0, q4",
            "vstrw.32 q7, [{t}, #48]",
            "vstrw.32 q0, [{t}, #112]",
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

/// Adds the products of two spectra, four columns of them, imaginary part first, to the elements of `to` at the indices
/// with reversed bits. All products are exact, and sums are multiples of 2^-48. 36 instructions for two numbers.
#[inline(always)]
pub(crate) fn add_product_columns([k, x]: [&[f16]; 2], stride: usize, to: &mut [Four]) {
    let len = to.len();
    assert!(len.is_power_of_two() && len >= 2, "{len} places");
    check(k.len(), stride, len);
    check(x.len(), stride, len);
    let far = len / 2 * stride;
    // SAFETY: the pairs and the elements exist.
    unsafe {
        asm_all!(
            "dls lr, {n}",
            "2:",
            // Numbers i and i + n/2 lie side by side when their bits are reversed.
            "rbit {t}, {i}",
            "vldrh.u16 q0, [{k0}]",
            "add {t}, {t}, {to}",
            "vldrh.u16 q1, [{x0}]",
            "vcvtb.f32.f16 q2, q0",
            "vldrw.u32 q6, [{t}]",
            "vcvtt.f32.f16 q3, q0",
            "vldrw.u32 q7, [{t}, #16]",
            "vcvtb.f32.f16 q4, q1",
            "vcvtt.f32.f16 q5, q1",
            "vldrh.u16 q0, [{k1}]",
            "vfma.f32 q7, q2, q4",
            "vldrh.u16 q1, [{x1}]",
            "vfma.f32 q6, q2, q5",
            "add {k0}, {k0}, {stride}",
            "vfms.f32 q7, q3, q5",
            "add {x0}, {x0}, {stride}",
            "vfma.f32 q6, q3, q4",
            "vcvtb.f32.f16 q2, q0",
            "vstrw.32 q7, [{t}, #16]",
            "vcvtt.f32.f16 q3, q0",
            "vstrw.32 q6, [{t}]",
            "vcvtb.f32.f16 q4, q1",
            "vldrw.u32 q6, [{t}, #32]",
            "vcvtt.f32.f16 q5, q1",
            "vldrw.u32 q7, [{t}, #48]",
            "vfma.f32 q7, q2, q4",
            "add {k1}, {k1}, {stride}",
            "vfma.f32 q6, q2, q5",
            "add {x1}, {x1}, {stride}",
            "vfms.f32 q7, q3, q5",
            "add {i}, {i}, {one}",
            "vfma.f32 q6, q3, q4",
            "vstrw.32 q7, [{t}, #48]",
            "vstrw.32 q6, [{t}, #32]",
            "le lr, 2b",
            t = out(reg) _,
            n = in(reg) len / 2,
            k0 = inout(reg) k.as_ptr() => _,
            k1 = inout(reg) k.as_ptr().add(far) => _,
            x0 = inout(reg) x.as_ptr() => _,
            x1 = inout(reg) x.as_ptr().add(far) => _,
            stride = in(reg) stride * size_of::<f16>(),
            i = inout(reg) 0 => _,
            one = in(reg) 1_u32 << shift(len),
            to = in(reg) to.as_mut_ptr(),
            out("lr") _,
        )
    }
}

/// The product of the pairs at `k` and `x`, which step on behind it: imaginary and real part. Also uses q0, q1 and
/// `xr`.
macro_rules! product {
    ($im:literal $re:literal, $xr:literal, $step:literal) => {
        concat!(
            "vldrh.u16 q0, [{k}]\n",
            "vldrh.u16 q1, [{x}]\n",
            "vcvtb.f32.f16 ",
            $im,
            ", q0\n",
            "add {k}, {k}, ",
            $step,
            "\n",
            "vcvtb.f32.f16 ",
            $xr,
            ", q1\n",
            "add {x}, {x}, ",
            $step,
            "\n",
            "vcvtt.f32.f16 q0, q0\n",
            "vcvtt.f32.f16 q1, q1\n",
            "vmul.f32 ",
            $re,
            ", ",
            $im,
            ", ",
            $xr,
            "\n",
            "vmul.f32 ",
            $im,
            ", ",
            $im,
            ", q1\n",
            "vfms.f32 ",
            $re,
            ", q0, q1\n",
            "vfma.f32 ",
            $im,
            ", q0, ",
            $xr,
            "\n",
        )
    };
}

/// Computes the products of two spectra, four columns of them, imaginary part first, and the butterflies of four
/// neighbours, and writes each to the index with reversed bits. All products are exact, and sums are multiples of
/// 2^-48. 82 instructions for four numbers.
#[inline(always)]
fn multiply([k, x]: [&[f16]; 2], stride: usize, to: &mut [Four]) {
    let len = to.len();
    assert!(len.is_power_of_two() && len >= 4, "{len} places");
    check(k.len(), stride, len);
    check(x.len(), stride, len);
    let stride = stride * size_of::<f16>();
    let quarter = len / 4 * stride;
    // SAFETY: of numbers i + n/4, i + 3n/4, i, i + n/2 the pairs are read in this order; `to` has a place for each.
    unsafe {
        asm_all!(
            "dls lr, {n}",
            "2:",
            "rbit {t}, {i}",
            "add {i}, {i}, {one}",
            product!("q2" "q3", "q4", "{half}"),
            "add {t}, {t}, {to}",
            product!("q4" "q5", "q6", "{back}"),
            // Sum and difference; no register is left for more than the first part of the difference.
            "vadd.f32 q6, q2, q4",
            "vsub.f32 q2, q2, q4",
            "vstrw.32 q6, [{t}, #64]",
            "vadd.f32 q4, q3, q5",
            "vsub.f32 q3, q3, q5",
            "vstrw.32 q4, [{t}, #80]",
            "vstrw.32 q3, [{t}, #96]",
            product!("q3" "q4", "q5", "{half}"),
            product!("q5" "q6", "q7", "{next}"),
            "vadd.f32 q0, q3, q5",
            "vldrw.u32 q7, [{t}, #64]",
            "vsub.f32 q3, q3, q5",
            "vadd.f32 q1, q4, q6",
            "vsub.f32 q4, q4, q6",
            "vadd.f32 q5, q0, q7",
            "vsub.f32 q0, q0, q7",
            "vldrw.u32 q7, [{t}, #80]",
            "vstrw.32 q5, [{t}]",
            "vadd.f32 q6, q1, q7",
            "vstrw.32 q0, [{t}, #64]",
            "vsub.f32 q1, q1, q7",
            "vstrw.32 q6, [{t}, #16]",
            // The difference times -i.
            "vldrw.u32 q7, [{t}, #96]",
            "vstrw.32 q1, [{t}, #80]",
            "vadd.f32 q5, q3, q7",
            "vsub.f32 q3, q3, q7",
            "vstrw.32 q5, [{t}, #32]",
            "vsub.f32 q6, q4, q2",
            "vstrw.32 q3, [{t}, #96]",
            "vadd.f32 q4, q4, q2",
            "vstrw.32 q6, [{t}, #48]",
            "vstrw.32 q4, [{t}, #112]",
            "le lr, 2b",
            t = out(reg) _,
            n = in(reg) len / 4,
            k = inout(reg) k.as_ptr().byte_add(quarter) => _,
            x = inout(reg) x.as_ptr().byte_add(quarter) => _,
            half = in(reg) 2 * quarter,
            back = in(reg) -3 * (quarter as isize),
            next = in(reg) stride as isize - quarter as isize,
            i = inout(reg) 0 => _,
            one = in(reg) 1_u32 << shift(len),
            to = in(reg) to.as_mut_ptr(),
            out("lr") _,
        );
    }
}

/// Transforms the product of two spectra, four columns of them, imaginary part first, into `to`. Returns false
/// where Helium flushed a number.
pub(crate) fn transform_product_columns(product: [&[f16]; 2], stride: usize, to: &mut [Four]) -> bool {
    unflushed(|| {
        multiply(product, stride, to);
        join(to.len(), to);
    })
}

/// Transforms four columns in place. Returns false where Helium flushed a number.
pub(crate) fn transform_columns(data: &mut [Four]) -> bool {
    unflushed(|| transform(data))
}

/// The loop of [`scatter_columns`]: what is done first with numbers in two and in one, and which half of the word each
/// part goes to.
macro_rules! scatter {
    (
        $two:literal, $one:literal, $first:literal $second:literal,
        $from:ident, $to:ident, $stride:ident $(, $scale:ident)?
    ) => {
        asm_all!(
            "wls lr, {n}, 3f",
            "2:",
            "vldrw.u32 q0, [{from}], #16",
            "vldrw.u32 q1, [{from}], #16",
            "vldrw.u32 q2, [{from}], #16",
            "vldrw.u32 q3, [{from}], #16",
            $two,
            $one,
            concat!($first, ".f16.f32 q4, q0"),
            concat!($second, ".f16.f32 q4, q1"),
            concat!($first, ".f16.f32 q5, q2"),
            "vstrh.16 q4, [{to}]",
            concat!($second, ".f16.f32 q5, q3"),
            "add {to}, {to}, {stride}",
            "vstrh.16 q5, [{to}]",
            "add {to}, {to}, {stride}",
            "le lr, 2b",
            "3:",
            // An odd number is left.
            "wls lr, {odd}, 4f",
            "vldrw.u32 q0, [{from}], #16",
            "vldrw.u32 q1, [{from}], #16",
            $one,
            concat!($first, ".f16.f32 q4, q0"),
            concat!($second, ".f16.f32 q4, q1"),
            "vstrh.16 q4, [{to}]",
            "4:",
            $(scale = in(reg) $scale.to_bits(),)?
            from = inout(reg) $from.as_ptr() => _,
            to = inout(reg) $to.as_mut_ptr() => _,
            stride = in(reg) $stride * size_of::<f16>(),
            n = in(reg) $from.len() / 2,
            odd = in(reg) $from.len() % 2,
            out("lr") _,
        )
    };
}

/// Narrows four columns into `to[i * stride..][..8]`; 13 instructions for two numbers, 17 where they are scaled. A
/// number that is flushed here is far below the smallest half.
#[inline(always)]
pub(crate) fn scatter_columns(from: &[Four], parts: Parts, to: &mut [f16], stride: usize) {
    if from.is_empty() {
        return;
    }
    check(to.len(), stride, from.len());
    // SAFETY: the pairs and their destinations exist.
    unsafe {
        match parts {
            Parts::Scaled(scale) => scatter!(
                "vmul.f32 q2, q2, {scale}\nvmul.f32 q3, q3, {scale}",
                "vmul.f32 q0, q0, {scale}\nvmul.f32 q1, q1, {scale}",
                "vcvtb" "vcvtt", from, to, stride, scale
            ),
            Parts::Exchanged => scatter!("", "", "vcvtt" "vcvtb", from, to, stride),
        }
    }
}
