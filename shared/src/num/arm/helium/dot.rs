//! The inner loops of the integer convolution in `VMLADAVA`: eight products of 16 bits, added to a sum of 32. The sums
//! are in the eight core registers with even numbers, which it needs.

use super::super::groups::{Groups, blocks};
use super::asm_push;

/// Channels of a group.
const GROUP: usize = 8;

/// Four columns of two output channels, times the weights of a tap in q4 and q5.
macro_rules! eight {
    ($x0:literal $x1:literal $x2:literal $x3:literal) => {
        concat!(
            "vldrh.u16 q4, [r3], #16\n",
            concat!("vmladava.s16 r0, ", $x0, ", q4\n"),
            "vldrh.u16 q5, [r3], #16\n",
            concat!("vmladava.s16 r2, ", $x1, ", q4\n"),
            concat!("vmladava.s16 r4, ", $x2, ", q4\n"),
            concat!("vmladava.s16 r6, ", $x3, ", q4\n"),
            concat!("vmladava.s16 r8, ", $x0, ", q5\n"),
            concat!("vmladava.s16 r10, ", $x1, ", q5\n"),
            concat!("vmladava.s16 r12, ", $x2, ", q5\n"),
            concat!("vmladava.s16 lr, ", $x3, ", q5\n"),
        )
    };
}

/// A kernel row of a group for two output channels: six inputs, the last two in place of the first.
macro_rules! two_by_four {
    () => {
        concat!(
            "vldrh.u16 q0, [r1], #16\n",
            "vldrh.u16 q1, [r1], #16\n",
            "vldrh.u16 q2, [r1], #16\n",
            "vldrh.u16 q3, [r1], #16\n",
            eight!("q0" "q1" "q2" "q3"),
            "vldrh.u16 q0, [r1], #16\n",
            eight!("q1" "q2" "q3" "q0"),
            "vldrh.u16 q1, [r1], #16\n",
            eight!("q2" "q3" "q0" "q1"),
            "add r1, r1, r5\n",
        )
    };
}

/// An input, times the weights of the taps 2, 1 and 0 in q6, q5 and q4, for three columns.
macro_rules! three {
    ($x:literal: $two:literal $one:literal $zero:literal) => {
        concat!(
            concat!("vldrh.u16 ", $x, ", [r1], #16\n"),
            concat!("vmladava.s16 ", $two, ", ", $x, ", q6\n"),
            concat!("vmladava.s16 ", $one, ", ", $x, ", q5\n"),
            concat!("vmladava.s16 ", $zero, ", ", $x, ", q4\n"),
        )
    };
}

/// A kernel row of a group for one output channel: ten inputs.
macro_rules! one_by_eight {
    () => {
        concat!(
            "vldrh.u16 q4, [r3], #16\n",
            "vldrh.u16 q0, [r1], #16\n",
            "vmladava.s16 r0, q0, q4\n",
            "vldrh.u16 q5, [r3], #16\n",
            "vldrh.u16 q1, [r1], #16\n",
            "vmladava.s16 r0, q1, q5\n",
            "vmladava.s16 r2, q1, q4\n",
            "vldrh.u16 q6, [r3], #16\n",
            three!("q2": "r0" "r2" "r4"),
            three!("q3": "r2" "r4" "r6"),
            three!("q0": "r4" "r6" "r8"),
            three!("q1": "r6" "r8" "r10"),
            three!("q2": "r8" "r10" "r12"),
            three!("q3": "r10" "r12" "lr"),
            "vldrh.u16 q0, [r1], #16\n",
            "vmladava.s16 r12, q0, q6\n",
            "vmladava.s16 lr, q0, q5\n",
            "vldrh.u16 q1, [r1], #16\n",
            "vmladava.s16 lr, q1, q6\n",
            "add r1, r1, r5\n",
        )
    };
}

/// `asm!` of all blocks of a row. `$step` is repeated for every kernel row of each group. The second half of the sums
/// starts as `$start` says, and is stored as `$store` says with r9 behind the first half.
macro_rules! blocks_of_row {
    ($row:expr, $start:expr, $step:expr, $store:expr) => {
        asm_push!(
            "push {{r6, r7}}",
            "mov r7, r4",
            "vldmia r0, {{s26-s31}}",
            "3:",
            "vmov r0, s28",
            "mov r2, r0",
            "mov r4, r0",
            "mov r6, r0",
            $start,
            "mov r10, r8",
            "mov r12, r8",
            "mov lr, r8",
            "vmov r3, s29",
            "vmov r11, s30",
            "2:",
            $step,
            $step,
            $step,
            "subs r11, r11, #1",
            "bne 2b",
            "stm r9!, {{r0, r2, r4, r6}}",
            $store,
            "vmov r0, s31",
            "sub r1, r1, r0",
            "subs r7, r7, #1",
            "bne 3b",
            "pop {{r6, r7}}",
            inout("r0") $row.numbers.as_ptr() => _,
            inout("r1") $row.input => _,
            inout("r4") $row.count => _,
            inout("r5") $row.step => _,
            inout("r9") $row.sums => _,
            out("r2") _, out("r3") _, out("r8") _, out("r10") _, out("r11") _, out("r12") _, out("lr") _,
        )
    };
}

/// One row of two output channels, a block of two by four columns at a time: 113 instructions for eight input channels
/// and 576 products.
///
/// `sums` (2, `distance`): each starts at its bias. No sum may overflow.
#[inline(always)]
pub(crate) fn correlate_groups2(rows: Groups<'_>, cols: usize, bias: [i32; 2], sums: &mut [i32], distance: usize) {
    const COLUMNS: usize = 4;
    let groups = rows.check(GROUP, [2, COLUMNS], distance, sums.len());
    for (first, count) in blocks(cols, COLUMNS, distance) {
        if count == 0 {
            continue;
        }
        let row = Row::new(rows, groups, [first, count, COLUMNS], bias, sums, distance);
        // SAFETY: the blocks lie within `distance` columns, and read two columns more, which the pitch has; as many
        // groups are there as weights. r6 and r7 belong to the compiler and are restored.
        unsafe {
            blocks_of_row!(
                row,
                "vmov r8, s26",
                two_by_four!(),
                "vmov r0, s27\nadd r0, r0, r9\nstm r0, {{r8, r10, r12, lr}}"
            );
        }
    }
}

/// One row of one output channel, a block of eight columns at a time: 116 instructions for eight input channels and 576
/// products.
///
/// `sums` (`distance`): each starts at the bias. No sum may overflow.
#[inline(always)]
pub(crate) fn correlate_groups1(rows: Groups<'_>, cols: usize, bias: i32, sums: &mut [i32], distance: usize) {
    const COLUMNS: usize = 8;
    let groups = rows.check(GROUP, [1, COLUMNS], distance, sums.len());
    for (first, count) in blocks(cols, COLUMNS, distance) {
        if count == 0 {
            continue;
        }
        let row = Row::new(rows, groups, [first, count, COLUMNS], [bias; 2], sums, distance);
        // SAFETY: as in `correlate_groups2`.
        unsafe {
            blocks_of_row!(row, "mov r8, r0", one_by_eight!(), "stm r9!, {{r8, r10, r12, lr}}");
        }
    }
}

/// The operands of a row.
struct Row {
    /// Second bias, from the end of the first channel's sums to the second's, first bias, weights, groups, and from
    /// behind the last kernel row to the next block.
    numbers: [usize; 6],
    input: *const i16,
    /// From the last input of a kernel row to the first of the next.
    step: usize,
    sums: *mut i32,
    count: usize,
}

impl Row {
    /// `count` blocks of `columns` from column `first` on.
    #[inline(always)]
    fn new(
        rows: Groups<'_>,
        groups: usize,
        [first, count, columns]: [usize; 3],
        bias: [i32; 2],
        sums: &mut [i32],
        distance: usize,
    ) -> Self {
        let (word, vector) = (size_of::<u32>(), GROUP * size_of::<i16>());
        let numbers = [
            bias[1] as usize,
            (distance - columns) * word,
            bias[0] as usize,
            rows.weights.as_ptr().addr(),
            groups,
            (3 * groups * rows.pitch - columns) * vector,
        ];
        let input = rows.input[first * GROUP..].as_ptr();
        let step = (rows.pitch - columns - 2) * vector;
        Self { numbers, input, step, sums: sums[first..].as_mut_ptr(), count }
    }
}
