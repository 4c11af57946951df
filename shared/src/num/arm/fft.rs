//! The complex transform of [`crate::fft`]: the same butterflies in the same order, the data in registers from load to
//! store.
//!
//! A product of complex numbers takes four instructions; `vmla` and `vmls` round the product before they add it.
//! Negations go into the additions that follow, which changes no bit.

use crate::fft::ROOT_TRIPLES;

/// `(tr, ti) = (ar, ai) (wr, wi)`.
macro_rules! product {
    ($tr:literal $ti:literal = $ar:literal $ai:literal, $wr:literal $wi:literal) => {
        concat!(
            op!("vmul.f32" $tr $ar $wr),
            op!("vmul.f32" $ti $ar $wi),
            op!("vmls.f32" $tr $ai $wi),
            op!("vmla.f32" $ti $ai $wr),
        )
    };
}

/// The butterfly of four numbers in bit-reversed order, from `a` to `o`, which may be the same registers; `t`: eight
/// others.
macro_rules! butterfly {
    (
        $a0r:literal $a0i:literal $a1r:literal $a1i:literal $a2r:literal $a2i:literal $a3r:literal $a3i:literal,
        $o0r:literal $o0i:literal $o1r:literal $o1i:literal $o2r:literal $o2i:literal $o3r:literal $o3i:literal,
        $t0:literal $t1:literal $t2:literal $t3:literal $t4:literal $t5:literal $t6:literal $t7:literal
    ) => {
        concat!(
            op!("vadd.f32" $t0 $a0r $a1r),
            op!("vadd.f32" $t1 $a0i $a1i),
            op!("vsub.f32" $t2 $a0r $a1r),
            op!("vsub.f32" $t3 $a0i $a1i),
            op!("vadd.f32" $t4 $a2r $a3r),
            op!("vadd.f32" $t5 $a2i $a3i),
            op!("vsub.f32" $t6 $a2r $a3r),
            op!("vsub.f32" $t7 $a2i $a3i),
            op!("vadd.f32" $o0r $t0 $t4),
            op!("vadd.f32" $o0i $t1 $t5),
            op!("vsub.f32" $o2r $t0 $t4),
            op!("vsub.f32" $o2i $t1 $t5),
            // The difference times -i.
            op!("vadd.f32" $o1r $t2 $t7),
            op!("vsub.f32" $o1i $t3 $t6),
            op!("vsub.f32" $o3r $t2 $t7),
            op!("vadd.f32" $o3i $t3 $t6),
        )
    };
}

/// Transforms numbers (re, im) in bit-reversed order into natural order: [`crate::fft::Fft::process`] of one lane. The
/// length is a power of two from 4 to 1024.
pub(crate) fn transform(data: &mut [[f32; 2]]) {
    let mut quarter = if data.len().trailing_zeros().is_multiple_of(2) {
        first_radix4(data.as_chunks_mut().0);
        4
    } else {
        first_radix8(data.as_chunks_mut().0);
        8
    };
    while quarter < data.len() {
        radix4(data, quarter);
        quarter *= 4;
    }
}

/// 20 instructions for four numbers.
#[inline(always)]
fn first_radix4(data: &mut [[[f32; 2]; 4]]) {
    if data.is_empty() {
        return;
    }
    // SAFETY: reads and writes the elements of `data` one after the other.
    unsafe {
        asm_all!(
            "2:",
            "vldmia {p}, {{s0-s7}}",
            butterfly!(
                "s0" "s1" "s2" "s3" "s4" "s5" "s6" "s7",
                "s0" "s1" "s2" "s3" "s4" "s5" "s6" "s7",
                "s8" "s9" "s10" "s11" "s12" "s13" "s14" "s15"
            ),
            "vstmia {p}!, {{s0-s7}}",
            "subs {n}, #1",
            "bne 2b",
            p = inout(reg) data.as_mut_ptr() => _,
            n = inout(reg) data.len() => _,
        );
    }
}

/// cos 45 degrees as the table of roots has it; the sine has the same bits.
const DIAGONAL: f32 = ROOT_TRIPLES[128][1][0];
const _: () = assert!(DIAGONAL == -ROOT_TRIPLES[128][1][1]);

/// 61 instructions for eight numbers.
#[inline(always)]
fn first_radix8(data: &mut [[[f32; 2]; 8]]) {
    if data.is_empty() {
        return;
    }
    // SAFETY: reads and writes the elements of `data` one after the other.
    unsafe {
        asm_all!(
            "2:",
            "vldmia {p}, {{s0-s15}}",
            butterfly!(
                "s0" "s1" "s2" "s3" "s4" "s5" "s6" "s7",
                "s0" "s1" "s2" "s3" "s4" "s5" "s6" "s7",
                "s16" "s17" "s18" "s19" "s20" "s21" "s22" "s23"
            ),
            butterfly!(
                "s8" "s9" "s10" "s11" "s12" "s13" "s14" "s15",
                "s8" "s9" "s10" "s11" "s12" "s13" "s14" "s15",
                "s16" "s17" "s18" "s19" "s20" "s21" "s22" "s23"
            ),
            "vmov s16, {diagonal}",
            // Odd number 1 times (d, -d) to s18, s19.
            "vmul.f32 s18, s10, s16",
            "vmla.f32 s18, s11, s16",
            "vmul.f32 s19, s11, s16",
            "vmls.f32 s19, s10, s16",
            // Odd number 3 times (-d, -d) to s10, s11.
            "vmul.f32 s10, s15, s16",
            "vmls.f32 s10, s14, s16",
            "vnmul.f32 s11, s14, s16",
            "vmls.f32 s11, s15, s16",
            // Sums.
            "vadd.f32 s20, s0, s8",
            "vadd.f32 s21, s1, s9",
            "vadd.f32 s22, s2, s18",
            "vadd.f32 s23, s3, s19",
            "vadd.f32 s24, s4, s13",
            "vsub.f32 s25, s5, s12",
            "vadd.f32 s26, s6, s10",
            "vadd.f32 s27, s7, s11",
            "vstmia {p}!, {{s20-s27}}",
            // Differences.
            "vsub.f32 s0, s0, s8",
            "vsub.f32 s1, s1, s9",
            "vsub.f32 s2, s2, s18",
            "vsub.f32 s3, s3, s19",
            "vsub.f32 s4, s4, s13",
            "vadd.f32 s5, s5, s12",
            "vsub.f32 s6, s6, s10",
            "vsub.f32 s7, s7, s11",
            "vstmia {p}!, {{s0-s7}}",
            "subs {n}, #1",
            "bne 2b",
            p = inout(reg) data.as_mut_ptr() => _,
            n = inout(reg) data.len() => _,
            diagonal = in(reg) DIAGONAL.to_bits(),
        );
    }
}

/// The products of one butterfly: numbers 1, 2, 3 times the roots in s16-s21 to s22-s27.
macro_rules! turn {
    ($a1r:literal $a1i:literal $a2r:literal $a2i:literal $a3r:literal $a3i:literal) => {
        concat!(
            product!("s22" "s23" = $a1r $a1i, "s16" "s17"),
            product!("s24" "s25" = $a2r $a2i, "s18" "s19"),
            product!("s26" "s27" = $a3r $a3i, "s20" "s21"),
        )
    };
}

/// Loads two numbers of each quarter of a block: column 0 to s0-s1, s4-s5, s8-s9, s12-s13, column 1 to the registers
/// between.
macro_rules! load_columns {
    () => {
        concat!(
            "vldmia {p0}, {{s0-s3}}\n",
            "vldmia {p1}, {{s4-s7}}\n",
            "vldmia {p2}, {{s8-s11}}\n",
            "vldmia {p3}, {{s12-s15}}\n",
        )
    };
}

/// Stores what [`load_columns`] has loaded, and goes on to the next two columns.
macro_rules! store_columns {
    () => {
        concat!(
            "vstmia {p0}!, {{s0-s3}}\n",
            "vstmia {p1}!, {{s4-s7}}\n",
            "vstmia {p2}!, {{s8-s11}}\n",
            "vstmia {p3}!, {{s12-s15}}\n",
        )
    };
}

/// The butterfly of one column, its numbers 1, 2, 3 times the next roots.
macro_rules! turned_column {
    (
        $a0r:literal $a0i:literal $a1r:literal $a1i:literal $a2r:literal $a2i:literal $a3r:literal $a3i:literal
    ) => {
        concat!(
            "vldmia {w}, {{s16-s21}}\n",
            "add {w}, {w}, {step}\n",
            turn!($a1r $a1i $a2r $a2i $a3r $a3i),
            butterfly!(
                $a0r $a0i "s22" "s23" "s24" "s25" "s26" "s27",
                $a0r $a0i $a1r $a1i $a2r $a2i $a3r $a3i,
                "s16" "s17" "s18" "s19" "s20" "s21" "s28" "s29"
            ),
        )
    };
}

/// Joins transforms of `quarter` numbers by fours; 70 instructions for two butterflies.
#[inline(always)]
fn radix4(data: &mut [[f32; 2]], quarter: usize) {
    let blocks = data.len() / (4 * quarter);
    if blocks == 0 || quarter < 4 || quarter > ROOT_TRIPLES.len() {
        return;
    }
    let roots = ROOT_TRIPLES.as_ptr_range();
    let bytes = quarter * size_of::<[f32; 2]>();
    // SAFETY: each block is read and written once, two columns of four numbers at a time; `quarter` is an even power of
    // two, so that the table is walked from its second step to its end.
    unsafe {
        let p = data.as_mut_ptr();
        asm_all!(
            "3:",
            // The first two butterflies of a block; the roots of the very first are 1.
            "add {w}, {table}, {step}",
            load_columns!(),
            butterfly!(
                "s0" "s1" "s4" "s5" "s8" "s9" "s12" "s13",
                "s0" "s1" "s4" "s5" "s8" "s9" "s12" "s13",
                "s16" "s17" "s18" "s19" "s20" "s21" "s22" "s23"
            ),
            turned_column!("s2" "s3" "s6" "s7" "s10" "s11" "s14" "s15"),
            store_columns!(),
            "2:",
            load_columns!(),
            turned_column!("s0" "s1" "s4" "s5" "s8" "s9" "s12" "s13"),
            turned_column!("s2" "s3" "s6" "s7" "s10" "s11" "s14" "s15"),
            store_columns!(),
            "cmp {w}, {end}",
            "bne 2b",
            "add {p0}, {p0}, {skip}",
            "add {p1}, {p1}, {skip}",
            "add {p2}, {p2}, {skip}",
            "add {p3}, {p3}, {skip}",
            "subs {blocks}, #1",
            "bne 3b",
            p0 = inout(reg) p => _,
            p1 = inout(reg) p.add(quarter) => _,
            p2 = inout(reg) p.add(2 * quarter) => _,
            p3 = inout(reg) p.add(3 * quarter) => _,
            w = out(reg) _,
            table = in(reg) roots.start,
            step = in(reg) size_of_val(&ROOT_TRIPLES) / quarter,
            end = in(reg) roots.end,
            skip = in(reg) 3 * bytes,
            blocks = inout(reg) blocks => _,
        );
    }
}
