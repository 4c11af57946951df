//! The inner loops of the 3x3 convolution. All sums are multiples of 2^-48, as products of halves are: nothing is
//! flushed.

use super::super::Rows;
use super::asm_push;

/// Columns of a block of four output channels: a register of sums each.
const COLUMNS: usize = 6;

/// One tap: the weights of four output channels in `q`, times one input each for six columns.
macro_rules! tap {
    ($q:literal: $x0:literal $x1:literal $x2:literal $x3:literal $x4:literal $x5:literal) => {
        concat!(
            "vldrw.u32 ",
            $q,
            ", [r11], #16\n",
            "vfma.f32 q0, ",
            $q,
            ", ",
            $x0,
            "\n",
            "vfma.f32 q1, ",
            $q,
            ", ",
            $x1,
            "\n",
            "vfma.f32 q2, ",
            $q,
            ", ",
            $x2,
            "\n",
            "vfma.f32 q3, ",
            $q,
            ", ",
            $x3,
            "\n",
            "vfma.f32 q4, ",
            $q,
            ", ",
            $x4,
            "\n",
            "vfma.f32 q5, ",
            $q,
            ", ",
            $x5,
            "\n",
        )
    };
}

/// One kernel row: eight inputs in general registers.
macro_rules! kernel_row {
    () => {
        concat!(
            "ldm r10, {{r0-r5, r8, r9}}\n",
            tap!("q6": "r0" "r1" "r2" "r3" "r4" "r5"),
            tap!("q7": "r1" "r2" "r3" "r4" "r5" "r8"),
            tap!("q6": "r2" "r3" "r4" "r5" "r8" "r9"),
        )
    };
}

/// One row of four output channels, a block of four channels by six columns at a time: 70 instructions an input channel
/// for 216 products.
///
/// `sums` (4, `distance`): each starts at its bias and runs over (channel, ky, kx) in this order. All products must be
/// exact.
#[inline(always)]
pub(crate) fn correlate4(rows: Rows<'_>, cols: usize, bias: [f32; 4], sums: &mut [f32], distance: usize) {
    let channels = rows.check(4, distance, sums.len());
    if distance < COLUMNS {
        return;
    }
    for first in (0..cols.min(distance)).step_by(COLUMNS) {
        // The last block ends where the row does; what it shares with the one before comes out the same.
        block4(rows, channels, &bias, first.min(distance - COLUMNS), sums, distance);
    }
}

/// The columns from `first` on.
#[inline(always)]
fn block4(rows: Rows<'_>, channels: usize, bias: &[f32; 4], first: usize, sums: &mut [f32], distance: usize) {
    let size = size_of::<f32>();
    let sums = sums[first..].as_mut_ptr();
    let sums = [0, 1, 2, 3].map(|o| sums.wrapping_add(o * distance));
    // SAFETY: six columns from `first` on lie within `distance`; a block reads two columns more, which the pitch has;
    // as many channels are there as weights. r6 belongs to the compiler and is restored.
    unsafe {
        asm_push!(
            "push {{r3, r6}}",
            "mov r6, r2",
            "vldrw.u32 q0, [r0]",
            "vmov q1, q0",
            "vmov q2, q0",
            "vmov q3, q0",
            "vmov q4, q0",
            "vmov q5, q0",
            "dls lr, r1",
            "2:",
            kernel_row!(),
            "add r10, r10, r12",
            kernel_row!(),
            "add r10, r10, r12",
            kernel_row!(),
            "sub r10, r10, r6",
            "le lr, 2b",
            "pop {{r3, r6}}",
            // The four channels of a column go to four rows.
            "vldrw.u32 q6, [r3]",
            "vstrw.32 q0, [q6]",
            "vstrw.32 q1, [q6, #4]",
            "vstrw.32 q2, [q6, #8]",
            "vstrw.32 q3, [q6, #12]",
            "vstrw.32 q4, [q6, #16]",
            "vstrw.32 q5, [q6, #20]",
            inout("r0") bias => _,
            inout("r1") channels => _,
            // From the third row of a channel to the first of the next.
            inout("r2") (2 * channels - 1) * rows.pitch * size => _,
            inout("r3") &sums => _,
            inout("r10") rows.input[first..].as_ptr() => _,
            inout("r11") rows.weights.as_ptr() => _,
            in("r12") channels * rows.pitch * size,
            out("r4") _, out("r5") _, out("r8") _, out("r9") _, out("lr") _,
        );
    }
}

/// Columns of a block of a single output channel.
const WIDE: usize = 16;

/// One weight times the inputs `x` bytes from the row's pointer on, sixteen columns.
macro_rules! sixteen {
    ($w:literal: $x0:literal $x1:literal $x2:literal $x3:literal) => {
        concat!(
            "vldrw.u32 q4, [r10, #",
            $x0,
            "]\n",
            "vldrw.u32 q5, [r10, #",
            $x1,
            "]\n",
            "vfma.f32 q0, q4, ",
            $w,
            "\n",
            "vldrw.u32 q6, [r10, #",
            $x2,
            "]\n",
            "vfma.f32 q1, q5, ",
            $w,
            "\n",
            "vldrw.u32 q7, [r10, #",
            $x3,
            "]\n",
            "vfma.f32 q2, q6, ",
            $w,
            "\n",
            "vfma.f32 q3, q7, ",
            $w,
            "\n",
        )
    };
}

/// One kernel row of a single output channel.
macro_rules! single_row {
    ($w0:literal $w1:literal $w2:literal) => {
        concat!(
            sixteen!($w0: "0" "16" "32" "48"),
            sixteen!($w1: "4" "20" "36" "52"),
            sixteen!($w2: "8" "24" "40" "56"),
        )
    };
}

/// The same for one output channel, sixteen columns at a time: 77 instructions an input channel for 144 products.
#[inline(always)]
pub(crate) fn correlate1(rows: Rows<'_>, cols: usize, bias: f32, sums: &mut [f32], distance: usize) {
    let channels = rows.check(1, distance, sums.len());
    assert!(distance.is_multiple_of(WIDE), "rows of {distance}");
    let size = size_of::<f32>();
    for first in (0..cols.min(distance)).step_by(WIDE) {
        // SAFETY: as above; the blocks lie within `distance`, a multiple of their width. r6 and r7 belong to the
        // compiler and are restored.
        unsafe {
            asm_push!(
                "push {{r3, r6, r7}}",
                "mov r6, r12",
                "mov r7, r2",
                "vdup.32 q0, r0",
                "vdup.32 q1, r0",
                "vdup.32 q2, r0",
                "vdup.32 q3, r0",
                "dls lr, r1",
                "2:",
                "ldm r11!, {{r0-r5, r8, r9, r12}}",
                single_row!("r0" "r1" "r2"),
                "add r10, r10, r6",
                single_row!("r3" "r4" "r5"),
                "add r10, r10, r6",
                single_row!("r8" "r9" "r12"),
                "sub r10, r10, r7",
                "le lr, 2b",
                "pop {{r3, r6, r7}}",
                "vstrw.32 q0, [r3]",
                "vstrw.32 q1, [r3, #16]",
                "vstrw.32 q2, [r3, #32]",
                "vstrw.32 q3, [r3, #48]",
                inout("r0") bias.to_bits() => _,
                inout("r1") channels => _,
                inout("r2") (2 * channels - 1) * rows.pitch * size => _,
                inout("r3") sums[first..].as_mut_ptr() => _,
                inout("r10") rows.input[first..].as_ptr() => _,
                inout("r11") rows.weights.as_ptr() => _,
                inout("r12") channels * rows.pitch * size => _,
                out("r4") _, out("r5") _, out("r8") _, out("r9") _, out("lr") _,
            );
        }
    }
}
