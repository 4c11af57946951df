//! The inner loop of the 3x3 convolution.

use super::Rows;

/// One output channel of one tap: four columns from input register `x` on, times weight register `w`.
macro_rules! tap {
    (
        $a:literal, $b:literal, $c:literal, $d:literal,
        $x0:literal, $x1:literal, $x2:literal, $x3:literal, $w:literal
    ) => {
        concat!(
            "vfma.f32 s",
            $a,
            ", s",
            $x0,
            ", s",
            $w,
            "\n",
            "vfma.f32 s",
            $b,
            ", s",
            $x1,
            ", s",
            $w,
            "\n",
            "vfma.f32 s",
            $c,
            ", s",
            $x2,
            ", s",
            $w,
            "\n",
            "vfma.f32 s",
            $d,
            ", s",
            $x3,
            ", s",
            $w
        )
    };
}

/// The four output channels of one tap.
macro_rules! taps {
    ($x0:literal, $x1:literal, $x2:literal, $x3:literal, $w0:literal, $w1:literal, $w2:literal, $w3:literal) => {
        concat!(
            tap!("0", "1", "2", "3", $x0, $x1, $x2, $x3, $w0),
            "\n",
            tap!("4", "5", "6", "7", $x0, $x1, $x2, $x3, $w1),
            "\n",
            tap!("8", "9", "10", "11", $x0, $x1, $x2, $x3, $w2),
            "\n",
            tap!("12", "13", "14", "15", $x0, $x1, $x2, $x3, $w3)
        )
    };
}

/// One kernel row: six inputs in s16-s21, weights in s22-s29, then s22-s25.
macro_rules! kernel_row {
    () => {
        concat!(
            "vldmia {row}, {{s16-s21}}\n",
            "vldmia {weights}!, {{s22-s29}}\n",
            taps!("16", "17", "18", "19", "22", "23", "24", "25"),
            "\n",
            taps!("17", "18", "19", "20", "26", "27", "28", "29"),
            "\n",
            "vldmia {weights}!, {{s22-s25}}\n",
            taps!("18", "19", "20", "21", "22", "23", "24", "25")
        )
    };
}

/// Columns of a block of four output channels, and of a block of one.
const COLUMNS: [usize; 2] = [4, 8];

/// One row of four output channels, a block of 4 by 4 at a time: 157 instructions an input channel for 144 products.
///
/// `sums` (4, `distance`): each starts at its bias and runs over (channel, ky, kx) in this order. All products must be
/// exact.
#[inline(always)]
pub(crate) fn correlate4(rows: Rows<'_>, cols: usize, bias: [f32; 4], sums: &mut [f32], distance: usize) {
    let channels = rows.check(4, distance, sums.len());
    let blocks = cols.min(distance).div_ceil(COLUMNS[0]);
    if blocks == 0 {
        return;
    }
    let bias = bias.map(|bias| [bias; 4]);
    // SAFETY: the blocks lie within `distance` columns, a multiple of their width; a block reads two columns more,
    // which the pitch has; as many channels are there as weights.
    unsafe {
        asm_all!(
            "3:",
            "vldmia {bias}, {{s0-s15}}",
            "2:",
            kernel_row!(),
            "add {row}, {row}, {stride}",
            kernel_row!(),
            "add {row}, {row}, {stride}",
            kernel_row!(),
            "sub {row}, {row}, {back}",
            "cmp {weights}, {end}",
            "bne 2b",
            // The weights' register serves as a pointer to the four rows of sums.
            "mov {weights}, {sums}",
            "vstmia {weights}, {{s0-s3}}",
            "add {weights}, {weights}, {distance}",
            "vstmia {weights}, {{s4-s7}}",
            "add {weights}, {weights}, {distance}",
            "vstmia {weights}, {{s8-s11}}",
            "add {weights}, {weights}, {distance}",
            "vstmia {weights}, {{s12-s15}}",
            "sub {weights}, {end}, {len}",
            "add {sums}, {sums}, #16",
            "sub {row}, {row}, {rewind}",
            "subs {blocks}, #1",
            "bne 3b",
            row = inout(reg) rows.input.as_ptr() => _,
            weights = inout(reg) rows.weights.as_ptr() => _,
            end = in(reg) rows.weights.as_ptr().add(36 * channels),
            len = in(reg) 36 * channels * size_of::<f32>(),
            sums = inout(reg) sums.as_mut_ptr() => _,
            distance = in(reg) distance * size_of::<f32>(),
            bias = in(reg) &bias,
            stride = in(reg) channels * rows.pitch * size_of::<f32>(),
            // From the third row of a channel to the first of the next.
            back = in(reg) (2 * channels - 1) * rows.pitch * size_of::<f32>(),
            // From behind the last channel to the next block.
            rewind = in(reg) (channels * rows.pitch - COLUMNS[0]) * size_of::<f32>(),
            blocks = inout(reg) blocks => _,
        );
    }
}

/// One column of inputs times its weight: eight sums.
macro_rules! eight {
    ($w:literal: $x0:literal $x1:literal $x2:literal $x3:literal $x4:literal $x5:literal $x6:literal $x7:literal) => {
        concat!(
            "vfma.f32 s0, s",
            $x0,
            ", s",
            $w,
            "\n",
            "vfma.f32 s1, s",
            $x1,
            ", s",
            $w,
            "\n",
            "vfma.f32 s2, s",
            $x2,
            ", s",
            $w,
            "\n",
            "vfma.f32 s3, s",
            $x3,
            ", s",
            $w,
            "\n",
            "vfma.f32 s4, s",
            $x4,
            ", s",
            $w,
            "\n",
            "vfma.f32 s5, s",
            $x5,
            ", s",
            $w,
            "\n",
            "vfma.f32 s6, s",
            $x6,
            ", s",
            $w,
            "\n",
            "vfma.f32 s7, s",
            $x7,
            ", s",
            $w,
            "\n",
        )
    };
}

/// One kernel row of a single output channel: ten inputs in s8-s17, three weights in s18-s20.
macro_rules! single_row {
    () => {
        concat!(
            "vldmia {row}, {{s8-s17}}\n",
            "vldmia {weights}!, {{s18-s20}}\n",
            eight!("18": "8" "9" "10" "11" "12" "13" "14" "15"),
            eight!("19": "9" "10" "11" "12" "13" "14" "15" "16"),
            eight!("20": "10" "11" "12" "13" "14" "15" "16" "17"),
        )
    };
}

/// The same for one output channel, eight columns at a time: 83 instructions an input channel for 72 products.
#[inline(always)]
pub(crate) fn correlate1(rows: Rows<'_>, cols: usize, bias: f32, sums: &mut [f32], distance: usize) {
    let channels = rows.check(1, distance, sums.len());
    let blocks = cols.min(distance).div_ceil(COLUMNS[1]);
    if blocks == 0 {
        return;
    }
    let bias = [bias; 8];
    // SAFETY: as above.
    unsafe {
        asm_all!(
            "3:",
            "vldmia {bias}, {{s0-s7}}",
            "2:",
            single_row!(),
            "add {row}, {row}, {stride}",
            single_row!(),
            "add {row}, {row}, {stride}",
            single_row!(),
            "sub {row}, {row}, {back}",
            "cmp {weights}, {end}",
            "bne 2b",
            "vstmia {sums}!, {{s0-s7}}",
            "sub {weights}, {end}, {len}",
            "sub {row}, {row}, {rewind}",
            "subs {blocks}, #1",
            "bne 3b",
            row = inout(reg) rows.input.as_ptr() => _,
            weights = inout(reg) rows.weights.as_ptr() => _,
            end = in(reg) rows.weights.as_ptr().add(9 * channels),
            len = in(reg) 9 * channels * size_of::<f32>(),
            sums = inout(reg) sums.as_mut_ptr() => _,
            bias = in(reg) &bias,
            stride = in(reg) channels * rows.pitch * size_of::<f32>(),
            back = in(reg) (2 * channels - 1) * rows.pitch * size_of::<f32>(),
            rewind = in(reg) (channels * rows.pitch - COLUMNS[1]) * size_of::<f32>(),
            blocks = inout(reg) blocks => _,
        );
    }
}
