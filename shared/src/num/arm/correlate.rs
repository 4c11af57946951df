//! The inner loop of the 3x3 convolution.

use super::asm_all;

/// One output channel of one tap: four columns from input register `x` on, times weight register `w`.
macro_rules! tap {
    ($a:literal, $b:literal, $c:literal, $d:literal, $x0:literal, $x1:literal, $x2:literal, $x3:literal, $w:literal) => {
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

/// Columns of the block that [`correlate`] computes.
pub(crate) const COLUMNS: usize = 4;

/// A block of 4 output channels by 4 columns of a 3x3 correlation, 157 instructions for 144 products.
///
/// `input`: three rows of all channels from the block's first column on, `[3, channels, pitch]`; `weights`: `[channels, 3, 3, 4]`;
/// `sums`: the biases on the way in, the sums over (channel, ky, kx) in this order on the way out. All products must be exact.
#[inline(always)]
pub(crate) fn correlate(input: &[f32], pitch: usize, weights: &[f32], sums: &mut [[f32; COLUMNS]; 4]) {
    let channels = weights.len() / 36;
    if channels == 0 {
        return;
    }
    assert!(input.len() >= (3 * channels - 1) * pitch + 6, "{} numbers are too few", input.len());
    // SAFETY: the last row read begins at (3 * channels - 1) * pitch and is six long; 36 weights a channel are there.
    unsafe {
        asm_all!(
            "vldmia {sums}, {{s0-s15}}",
            "2:",
            kernel_row!(),
            "add {row}, {row}, {stride}",
            kernel_row!(),
            "add {row}, {row}, {stride}",
            kernel_row!(),
            "sub {row}, {row}, {back}",
            "subs {channels}, #1",
            "bne 2b",
            "vstmia {sums}, {{s0-s15}}",
            row = inout(reg) input.as_ptr() => _,
            weights = inout(reg) weights.as_ptr() => _,
            sums = in(reg) sums,
            stride = in(reg) channels * pitch * size_of::<f32>(),
            // From the third row of a channel to the first of the next.
            back = in(reg) (2 * channels - 1) * pitch * size_of::<f32>(),
            channels = inout(reg) channels => _,
        );
    }
}
