//! The inner loop of the integer convolution in `VMLADAVA`: eight products of 16 bits, added to a sum of 32.

use super::super::groups::{COLUMNS, Groups, blocks};
use super::asm_push;

/// Channels of a group.
const GROUP: usize = 8;

/// Three columns of two output channels, times the weights of a tap in q4 and q5.
macro_rules! six {
    ($x0:literal $x1:literal $x2:literal) => {
        concat!(
            "vldrh.u16 q4, [r11], #16\n",
            concat!("vmladava.s16 r0, ", $x0, ", q4\n"),
            "vldrh.u16 q5, [r11], #16\n",
            concat!("vmladava.s16 r2, ", $x1, ", q4\n"),
            concat!("vmladava.s16 r4, ", $x2, ", q4\n"),
            concat!("vmladava.s16 r6, ", $x0, ", q5\n"),
            concat!("vmladava.s16 r8, ", $x1, ", q5\n"),
            concat!("vmladava.s16 r10, ", $x2, ", q5\n"),
        )
    };
}

/// One kernel row: five inputs, the last one in place of the first.
macro_rules! kernel_row {
    () => {
        concat!(
            "vldrh.u16 q0, [r12]\n",
            "vldrh.u16 q1, [r12, #16]\n",
            "vldrh.u16 q2, [r12, #32]\n",
            six!("q0" "q1" "q2"),
            "vldrh.u16 q3, [r12, #48]\n",
            six!("q1" "q2" "q3"),
            "vldrh.u16 q0, [r12, #64]\n",
            six!("q2" "q3" "q0"),
        )
    };
}

/// One row of two output channels, a block of two by three columns at a time: 91 instructions for eight input channels
/// and 432 products.
///
/// `sums` (2, `distance`): each starts at its bias. No sum may overflow.
#[inline(always)]
pub(crate) fn correlate_groups(rows: Groups<'_>, cols: usize, bias: [i32; 2], sums: &mut [i32], distance: usize) {
    let groups = rows.check(GROUP, distance, sums.len());
    for (first, count) in blocks(cols, distance) {
        if count > 0 {
            run(rows, groups, first, count, bias, sums, distance);
        }
    }
}

/// `count` blocks from column `first` on.
#[inline(always)]
fn run(rows: Groups<'_>, groups: usize, first: usize, count: usize, bias: [i32; 2], sums: &mut [i32], distance: usize) {
    let (word, vector) = (size_of::<u32>(), GROUP * size_of::<i16>());
    let width = rows.pitch * vector;
    let numbers: [usize; 6] = [
        bias[0] as usize,
        bias[1] as usize,
        rows.weights.as_ptr().addr(),
        // From behind the last group to the next block.
        groups * width - COLUMNS * vector,
        groups,
        distance * word,
    ];
    // SAFETY: the blocks lie within `distance` columns, and read two columns more, which the pitch has; as many groups
    // are there as weights. r6 belongs to the compiler and is restored.
    unsafe {
        asm_push!(
            "push {{r5, r6}}",
            "vldmia r0, {{s24-s29}}",
            "3:",
            "vmov r0, s24",
            "mov r2, r0",
            "mov r4, r0",
            "vmov r6, s25",
            "mov r8, r6",
            "mov r10, r6",
            "vmov r11, s26",
            "vmov lr, s28",
            "dls lr, lr",
            "2:",
            kernel_row!(),
            "add r12, r12, r1",
            kernel_row!(),
            "add r12, r12, r1",
            kernel_row!(),
            "sub r12, r12, r3",
            "le lr, 2b",
            "str r0, [r5]",
            "str r2, [r5, #4]",
            "str r4, [r5, #8]",
            "vmov r0, s29",
            "add r0, r0, r5",
            "str r6, [r0]",
            "str r8, [r0, #4]",
            "str r10, [r0, #8]",
            "add r5, r5, #12",
            "vmov r0, s27",
            "sub r12, r12, r0",
            "subs r9, r9, #1",
            "bne 3b",
            "pop {{r5, r6}}",
            inout("r0") numbers.as_ptr() => _,
            inout("r1") groups * width => _,
            // From the third row of a group to the first of the next.
            inout("r3") (2 * groups - 1) * width => _,
            inout("r5") sums[first..].as_mut_ptr() => _,
            inout("r9") count => _,
            inout("r12") rows.input[first * GROUP..].as_ptr() => _,
            out("r2") _, out("r4") _, out("r8") _, out("r10") _, out("r11") _, out("lr") _,
        );
    }
}
