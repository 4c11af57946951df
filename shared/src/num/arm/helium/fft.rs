//! The complex transform of [`crate::fft`] for four columns side by side: the scalar algorithm, in each lane.
//!
//! A product is rounded before it is added: products and sums are instructions of their own. Eight registers hold four
//! complex numbers of four lanes and nothing else, so real parts are finished before imaginary parts are loaded.

use super::bounds::check;
use super::{Four, asm_push, rows_at};
use crate::fft::ROOT_TRIPLES;
use crate::num::f16;

/// cos 45 degrees as the table of roots has it.
const DIAGONAL: f32 = ROOT_TRIPLES[128][1][0];

/// Bytes of a complex number of four lanes.
const SIZE: usize = size_of::<Four>();

/// Transforms numbers in bit-reversed order into natural order. The length is a power of two from 4 to 1024.
pub(super) fn transform(data: &mut [Four]) {
    radix4_of_ones(data.as_chunks_mut().0);
    join(data.len(), data);
}

/// Joins transforms of four numbers into transforms of `len`. So the routine that loads the numbers does the first
/// pass. Where there are 16 numbers at least, the routine that stores them can do the last pass; `len` is then a
/// quarter of the length.
///
/// It is not inlined, as its loops are long and five routines use it.
#[inline(never)]
pub(super) fn join(len: usize, data: &mut [Four]) {
    let mut quarter = if len.trailing_zeros().is_multiple_of(2) {
        4
    } else {
        radix2_of_eighths(data.as_chunks_mut().0);
        8
    };
    while quarter < len {
        radix4(data, quarter);
        quarter *= 4;
    }
}

/// The rest of a butterfly: b0 and b1 are sum and difference of numbers 0 and 1, s and d those of numbers 2 and 3.
macro_rules! real_parts {
    ($a0:literal $c1:literal $s:literal $b0:literal, $p0:literal $p2:literal) => {
        concat!(
            op!("vadd.f32" $b0 $a0 $c1),
            op!("vsub.f32" $a0 $a0 $c1),
            op!("vadd.f32" $c1 $b0 $s),
            op!("vsub.f32" $b0 $b0 $s),
            op!("vstrw.32" $c1 $p0),
            op!("vstrw.32" $b0 $p2),
        )
    };
}

/// Butterflies of four neighbours; 34 instructions for four numbers of four lanes.
#[inline(always)]
pub(super) fn radix4_of_ones(data: &mut [[Four; 4]]) {
    if data.is_empty() {
        return;
    }
    // SAFETY: reads and writes the elements of `data` one after the other.
    unsafe {
        asm_all!(
            "dls lr, {n}",
            "2:",
            "vldrw.u32 q1, [{p}, #64]",
            "vldrw.u32 q3, [{p}, #96]",
            "vadd.f32 q4, q1, q3",
            "vsub.f32 q1, q1, q3",
            "vldrw.u32 q0, [{p}]",
            "vldrw.u32 q2, [{p}, #32]",
            real_parts!("q0" "q2" "q4" "q3", "[{p}]" "[{p}, #64]"),
            // q0: b1 real, q1: d real.
            "vldrw.u32 q2, [{p}, #80]",
            "vldrw.u32 q3, [{p}, #112]",
            "vadd.f32 q4, q2, q3",
            "vsub.f32 q2, q2, q3",
            "vldrw.u32 q3, [{p}, #16]",
            "vldrw.u32 q5, [{p}, #48]",
            real_parts!("q3" "q5" "q4" "q6", "[{p}, #16]" "[{p}, #80]"),
            // q3: b1 imaginary, q2: d imaginary. The difference times -i.
            "vadd.f32 q4, q0, q2",
            "vsub.f32 q5, q3, q1",
            "vstrw.32 q4, [{p}, #32]",
            "vsub.f32 q0, q0, q2",
            "vstrw.32 q5, [{p}, #48]",
            "vadd.f32 q3, q3, q1",
            "vstrw.32 q0, [{p}, #96]",
            "vstrw.32 q3, [{p}, #112]",
            "adds {p}, #128",
            "le lr, 2b",
            n = in(reg) data.len(),
            p = inout(reg) data.as_mut_ptr() => _,
            out("lr") _,
        );
    }
}

/// Loads or stores a complex number of four lanes: its two registers, and its offset in the block, bytes.
macro_rules! number {
    ($name:literal $re:literal $im:literal, $at:literal) => {
        concat!($name, " ", $re, ", [{p}, #", $at, "]\n", $name, " ", $im, ", [{p}, #", $at, "+16]\n")
    };
}

/// Sum and difference of the numbers in q0, q1 and q2, q3, stored at offsets `e` and `o`; `plus`, `minus`: how the
/// imaginary parts are added.
macro_rules! sum_and_difference {
    ($e:literal $o:literal, $plus:literal $minus:literal) => {
        concat!(
            "vadd.f32 q4, q0, q2\n",
            $plus,
            " q5, q1, q3\n",
            "vsub.f32 q0, q0, q2\n",
            $minus,
            " q1, q1, q3\n",
            number!("vstrw.32" "q4" "q5", $e),
            number!("vstrw.32" "q0" "q1", $o),
        )
    };
}

/// Joins the numbers at offsets `e` and `o` where the root is a plain sign; `or`, `oi`: where the parts of the second
/// are loaded to.
macro_rules! join {
    ($e:literal $o:literal, $or:literal $oi:literal, $plus:literal $minus:literal) => {
        concat!(
            number!("vldrw.u32" "q0" "q1", $e),
            number!("vldrw.u32" $or $oi, $o),
            sum_and_difference!($e $o, $plus $minus),
        )
    };
}

/// The same where the second number is first multiplied: `product` multiplies q2, q3 in place.
macro_rules! join_product {
    ($e:literal $o:literal, $product:expr) => {
        concat!(
            number!("vldrw.u32" "q2" "q3", $o),
            $product,
            number!("vldrw.u32" "q0" "q1", $e),
            sum_and_difference!($e $o, "vadd.f32" "vsub.f32"),
        )
    };
}

/// Joins transforms of four numbers by twos: what makes a butterfly of eight of two of four. 58 instructions for eight
/// numbers of four lanes.
#[inline(always)]
fn radix2_of_eighths(data: &mut [[Four; 8]]) {
    if data.is_empty() {
        return;
    }
    // SAFETY: reads and writes the elements of `data` one after the other.
    unsafe {
        asm_all!(
            "dls lr, {n}",
            "2:",
            join!("0" "128", "q2" "q3", "vadd.f32" "vsub.f32"),
            // Times (d, -d).
            join_product!("32" "160", concat!(
                "vmul.f32 q4, q2, {d}\n",
                "vmul.f32 q5, q3, {d}\n",
                "vadd.f32 q2, q4, q5\n",
                "vsub.f32 q3, q5, q4\n",
            )),
            // Times -i: the parts change places, and the imaginary one its sign.
            join!("64" "192", "q3" "q2", "vsub.f32" "vadd.f32"),
            // Times (-d, -d).
            join_product!("96" "224", concat!(
                "vmul.f32 q4, q2, {minus}\n",
                "vmul.f32 q5, q3, {d}\n",
                "vadd.f32 q2, q5, q4\n",
                "vsub.f32 q3, q4, q5\n",
            )),
            "add {p}, {p}, #256",
            "le lr, 2b",
            n = in(reg) data.len(),
            p = inout(reg) data.as_mut_ptr() => _,
            d = in(reg) DIAGONAL.to_bits(),
            minus = in(reg) (-DIAGONAL).to_bits(),
            out("lr") _,
        );
    }
}

/// Numbers 1, 2 and 3 of a butterfly times the next roots: real and imaginary part of the sum of numbers 2 and 3 to q3,
/// q5, of their difference to q2, q0, of number 1 to q6, q1. The arguments are the addresses of the parts.
macro_rules! turned {
    ($a1r:literal $a1i:literal, $a2r:literal $a2i:literal, $a3r:literal $a3i:literal) => {
        concat!(
            "add r8, r8, r9\n",
            "ldm r8, {{r0-r5}}\n",
            // c2 = a2 w1 to q2, q0.
            "vldrw.u32 q0, ",
            $a2r,
            "\n",
            "vldrw.u32 q1, ",
            $a2i,
            "\n",
            "vmul.f32 q2, q0, r2\n",
            "vmul.f32 q3, q1, r3\n",
            "vmul.f32 q0, q0, r3\n",
            "vmul.f32 q1, q1, r2\n",
            "vsub.f32 q2, q2, q3\n",
            "vadd.f32 q0, q0, q1\n",
            // c3 = a3 w3 to q4, q1.
            "vldrw.u32 q1, ",
            $a3r,
            "\n",
            "vldrw.u32 q3, ",
            $a3i,
            "\n",
            "vmul.f32 q4, q1, r4\n",
            "vmul.f32 q5, q3, r5\n",
            "vmul.f32 q1, q1, r5\n",
            "vmul.f32 q3, q3, r4\n",
            "vsub.f32 q4, q4, q5\n",
            "vadd.f32 q1, q1, q3\n",
            "vadd.f32 q3, q2, q4\n",
            "vsub.f32 q2, q2, q4\n",
            "vadd.f32 q5, q0, q1\n",
            "vsub.f32 q0, q0, q1\n",
            // c1 = a1 w2 to q6, q1.
            "vldrw.u32 q1, ",
            $a1r,
            "\n",
            "vldrw.u32 q4, ",
            $a1i,
            "\n",
            "vmul.f32 q6, q1, r0\n",
            "vmul.f32 q7, q4, r1\n",
            "vmul.f32 q1, q1, r1\n",
            "vmul.f32 q4, q4, r0\n",
            "vsub.f32 q6, q6, q7\n",
            "vadd.f32 q1, q1, q4\n",
        )
    };
}

/// Joins transforms of `quarter` numbers by fours; 52 instructions for a butterfly of four lanes.
#[inline(always)]
fn radix4(data: &mut [Four], quarter: usize) {
    let blocks = data.len() / (4 * quarter);
    if blocks == 0 || quarter < 2 || quarter > ROOT_TRIPLES.len() {
        return;
    }
    let skip = 3 * quarter * SIZE;
    // SAFETY: reads and writes each number of each block once; the table is walked in `quarter` steps. The pointers
    // come to a block by the three quarters that lie between; the first and the third run another 16 bytes behind. r6
    // belongs to the compiler and is restored.
    unsafe {
        let p = data.as_mut_ptr().wrapping_byte_sub(skip);
        asm_push!(
            "push {{r6}}",
            "mov r6, r0",
            "push {{r2-r5}}",
            "3:",
            "ldm sp, {{r0-r3}}",
            "add r10, r10, r0",
            "add r11, r11, r0",
            "add r12, r12, r0",
            "add r6, r6, r0",
            "mov r8, r1",
            "dls lr, r2",
            // Nothing below changes the condition.
            "subs r3, #1",
            "str r3, [sp, #12]",
            // The first roots are 1.
            "vldrw.u32 q0, [r12, #16]!",
            "vldrw.u32 q3, [r6]",
            "vadd.f32 q4, q0, q3",
            "vsub.f32 q1, q0, q3",
            "vldrw.u32 q0, [r10, #16]!",
            "vldrw.u32 q2, [r11]",
            real_parts!("q0" "q2" "q4" "q3", "[r10]" "[r12]"),
            "vldrw.u32 q2, [r12, #16]",
            "vldrw.u32 q3, [r6, #16]",
            "vadd.f32 q4, q2, q3",
            "vsub.f32 q2, q2, q3",
            "vldrw.u32 q3, [r10, #16]",
            "vldrw.u32 q5, [r11, #16]",
            real_parts!("q3" "q5" "q4" "q6", "[r10, #16]!" "[r12, #16]!"),
            "vadd.f32 q4, q0, q2",
            "vsub.f32 q5, q3, q1",
            "vsub.f32 q0, q0, q2",
            "vadd.f32 q3, q3, q1",
            "vstrw.32 q5, [r11, #16]",
            "vstrw.32 q4, [r11], #32",
            "vstrw.32 q3, [r6, #16]",
            "vstrw.32 q0, [r6], #32",
            "2:",
            turned!("[r11]" "[r11, #16]", "[r12, #16]!" "[r12, #16]", "[r6]" "[r6, #16]"),
            "vldrw.u32 q4, [r10, #16]!",
            real_parts!("q4" "q6" "q3" "q7", "[r10]" "[r12]"),
            // q4: b1 real.
            "vldrw.u32 q3, [r10, #16]",
            real_parts!("q3" "q1" "q5" "q6", "[r10, #16]!" "[r12, #16]!"),
            // q3: b1 imaginary.
            "vadd.f32 q5, q4, q0",
            "vsub.f32 q6, q3, q2",
            "vsub.f32 q4, q4, q0",
            "vadd.f32 q3, q3, q2",
            "vstrw.32 q6, [r11, #16]",
            "vstrw.32 q5, [r11], #32",
            "vstrw.32 q3, [r6, #16]",
            "vstrw.32 q4, [r6], #32",
            "le lr, 2b",
            "bne 3b",
            "add sp, sp, #16",
            "pop {{r6}}",
            inout("r0") p.wrapping_add(3 * quarter) => _,
            inout("r2") skip => _,
            inout("r3") ROOT_TRIPLES.as_ptr() => _,
            inout("r4") quarter - 1 => _,
            inout("r5") blocks => _,
            in("r9") size_of_val(&ROOT_TRIPLES) / quarter,
            inout("r10") p.wrapping_byte_sub(SIZE / 2) => _,
            inout("r11") p.wrapping_add(quarter) => _,
            inout("r12") p.wrapping_add(2 * quarter).wrapping_byte_sub(SIZE / 2) => _,
            out("r1") _, out("r8") _, out("lr") _,
        );
    }
}

/// The same where the roots are 1: the first butterfly of a pass.
macro_rules! not_turned {
    () => {
        concat!(
            "vldrw.u32 q0, [r12], #16\n",
            "vldrw.u32 q1, [r6], #16\n",
            "vadd.f32 q3, q0, q1\n",
            "vsub.f32 q2, q0, q1\n",
            "vldrw.u32 q4, [r12], #16\n",
            "vldrw.u32 q1, [r6], #16\n",
            "vadd.f32 q5, q4, q1\n",
            "vsub.f32 q0, q4, q1\n",
            "vldrw.u32 q6, [r11], #16\n",
            "vldrw.u32 q1, [r11], #16\n",
        )
    };
}

/// The rest of a butterfly whose numbers go to four rows. The stack holds the scale, the bytes of
/// a row's quarter and of its half, and the four addresses.
macro_rules! to_rows {
    () => {
        concat!(
            "ldm sp, {{r0-r2}}\n",
            "vldrw.u32 q4, [r10], #16\n",
            "vadd.f32 q7, q4, q6\n",
            "vsub.f32 q4, q4, q6\n",
            "vadd.f32 q6, q7, q3\n",
            "vsub.f32 q7, q7, q3\n",
            "vldrw.u32 q3, [sp, #12]\n",
            "vmul.f32 q6, q6, r0\n",
            "vmul.f32 q7, q7, r0\n",
            "vstrw.32 q6, [q3, #12]\n",
            "vadd.i32 q3, q3, r2\n",
            "vldrw.u32 q6, [r10], #16\n",
            "vstrw.32 q7, [q3, #12]\n",
            "vadd.f32 q7, q6, q1\n",
            "vsub.f32 q6, q6, q1\n",
            "vadd.f32 q1, q7, q5\n",
            "vsub.f32 q7, q7, q5\n",
            "vmul.f32 q1, q1, r0\n",
            "vmul.f32 q7, q7, r0\n",
            "vadd.f32 q5, q4, q0\n",
            "vstrw.32 q7, [q3, #8]\n",
            "vsub.f32 q4, q4, q0\n",
            "vadd.i32 q3, q3, r1\n",
            "vmul.f32 q4, q4, r0\n",
            "vsub.f32 q7, q6, q2\n",
            "vstrw.32 q4, [q3, #12]\n",
            "vadd.f32 q6, q6, q2\n",
            "vmul.f32 q5, q5, r0\n",
            "vmul.f32 q6, q6, r0\n",
            "vstrw.32 q6, [q3, #8]\n",
            "vsub.i32 q3, q3, r2\n",
            "vmul.f32 q7, q7, r0\n",
            "vstrw.32 q5, [q3, #12]\n",
            "vstrw.32 q7, [q3, #8]\n",
            "vsub.i32 q3, q3, r1\n",
            "vstrw.32 q1, [q3, #8]!\n",
            "vstrw.32 q3, [sp, #12]\n",
        )
    };
}

/// The last pass of a transform of pairs, imaginary part first, which it scales and puts into four rows, the second
/// number first; 67 instructions for a butterfly of four lanes. Not for less than 16 numbers.
#[inline(always)]
pub(super) fn last_to_rows(data: &[Four], scale: f32, rows: &mut [f32]) {
    let quarter = data.len() / 4;
    assert!((4..=ROOT_TRIPLES.len()).contains(&quarter) && rows.len() == 8 * data.len(), "{quarter} butterflies");
    // They run a pair behind.
    let to = rows_at(rows.as_mut_ptr(), 2 * data.len() * size_of::<f32>()).map(|row| row.wrapping_sub(8));
    // SAFETY: reads each number once, and writes it to its place in each of the four rows; the table is walked in
    // `quarter` steps. r6 belongs to the compiler and is restored.
    unsafe {
        let p = data.as_ptr();
        asm_push!(
            "push {{r6}}",
            "mov r6, r0",
            "vldrw.u32 q0, [r2]",
            "vpush {{d0-d1}}",
            "lsl r4, r1, #3",
            "lsl r5, r1, #4",
            "push {{r3-r5}}",
            "sub lr, r1, #1",
            not_turned!(),
            to_rows!(),
            "dls lr, lr",
            "2:",
            turned!("[r11], #16" "[r11], #16", "[r12], #16" "[r12], #16", "[r6], #16" "[r6], #16"),
            to_rows!(),
            "le lr, 2b",
            "add sp, sp, #28",
            "pop {{r6}}",
            inout("r0") p.add(3 * quarter) => _,
            inout("r1") quarter => _,
            inout("r2") &to => _,
            inout("r3") scale.to_bits() => _,
            inout("r8") ROOT_TRIPLES.as_ptr() => _,
            in("r9") size_of_val(&ROOT_TRIPLES) / quarter,
            inout("r10") p => _,
            inout("r11") p.add(quarter) => _,
            inout("r12") p.add(2 * quarter) => _,
            out("r4") _, out("r5") _, out("lr") _,
        );
    }
}

/// The rest of a butterfly whose numbers go to columns of halves, scaled. The stack holds where the first goes, the
/// distance to the second, that to the next butterfly's first, and the scale. No register is left for both parts of
/// number 0, so its second one is loaded twice.
macro_rules! to_columns {
    () => {
        concat!(
            "ldm sp, {{r0-r3}}\n",
            "vldrw.u32 q4, [r10], #16\n",
            "vadd.f32 q7, q4, q6\n",
            "vsub.f32 q4, q4, q6\n",
            "vadd.f32 q6, q7, q3\n",
            "vsub.f32 q7, q7, q3\n",
            "vldrw.u32 q3, [r10]\n",
            "vmul.f32 q6, q6, r3\n",
            "vadd.f32 q3, q3, q1\n",
            "vmul.f32 q7, q7, r3\n",
            "vadd.f32 q3, q3, q5\n",
            "vcvtb.f16.f32 q6, q6\n",
            "vmul.f32 q3, q3, r3\n",
            "vcvtb.f16.f32 q7, q7\n",
            "vcvtt.f16.f32 q6, q3\n",
            "vldrw.u32 q3, [r10], #16\n",
            "add r4, r0, r1\n",
            "vstrh.16 q6, [r0]\n",
            "vadd.f32 q6, q3, q1\n",
            "vsub.f32 q3, q3, q1\n",
            "vsub.f32 q6, q6, q5\n",
            "vadd.f32 q5, q4, q0\n",
            "vmul.f32 q6, q6, r3\n",
            "vsub.f32 q4, q4, q0\n",
            "vcvtt.f16.f32 q7, q6\n",
            "add r5, r4, r1\n",
            "vsub.f32 q6, q3, q2\n",
            "vstrh.16 q7, [r5]\n",
            "vadd.f32 q3, q3, q2\n",
            "vmul.f32 q5, q5, r3\n",
            "vmul.f32 q4, q4, r3\n",
            "vcvtb.f16.f32 q5, q5\n",
            "vmul.f32 q6, q6, r3\n",
            "vcvtb.f16.f32 q4, q4\n",
            "vmul.f32 q3, q3, r3\n",
            "vcvtt.f16.f32 q5, q6\n",
            "add r5, r5, r1\n",
            "vcvtt.f16.f32 q4, q3\n",
            "vstrh.16 q5, [r4]\n",
            "add r0, r0, r2\n",
            "vstrh.16 q4, [r5]\n",
            "str r0, [sp]\n",
        )
    };
}

/// The last pass of a transform, whose numbers are scaled and narrowed into `columns[i * stride..][..8]`; 73
/// instructions for a butterfly of four lanes. Not for less than 16 numbers.
#[inline(always)]
pub(super) fn last_to_columns(data: &[Four], scale: f32, columns: &mut [f16], stride: usize) {
    let quarter = data.len() / 4;
    assert!((4..=ROOT_TRIPLES.len()).contains(&quarter), "{quarter} butterflies");
    check(columns.len(), stride, data.len());
    let stride = stride * size_of::<f16>();
    // SAFETY: reads each number, and writes it to its place in the columns; the table is walked in `quarter` steps. r6
    // belongs to the compiler and is restored.
    unsafe {
        let p = data.as_ptr();
        asm_push!(
            "push {{r6}}",
            "mov r6, r0",
            "push {{r2-r5}}",
            not_turned!(),
            to_columns!(),
            "dls lr, lr",
            "2:",
            turned!("[r11], #16" "[r11], #16", "[r12], #16" "[r12], #16", "[r6], #16" "[r6], #16"),
            to_columns!(),
            "le lr, 2b",
            "add sp, sp, #16",
            "pop {{r6}}",
            inout("r0") p.add(3 * quarter) => _,
            inout("r2") columns.as_mut_ptr() => _,
            inout("r3") quarter * stride => _,
            inout("r4") stride => _,
            inout("r5") scale.to_bits() => _,
            inout("r8") ROOT_TRIPLES.as_ptr() => _,
            in("r9") size_of_val(&ROOT_TRIPLES) / quarter,
            inout("r10") p => _,
            inout("r11") p.add(quarter) => _,
            inout("r12") p.add(2 * quarter) => _,
            inout("lr") quarter - 1 => _,
            out("r1") _,
        );
    }
}
