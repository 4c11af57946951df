//! The inner loops of the integer convolution in `VMLADAVA`: eight products of 16 bits, or sixteen of 8, added to a sum
//! of
//! 32. The sums are in the eight core registers with even numbers, which it needs.

use super::super::groups::{Groups, blocks};
use super::asm_push;

/// Bytes of a vector: eight channels of 16 bits, or sixteen of 8.
const VECTOR: usize = 16;

/// Four columns of two output channels, times the weights of a tap in q4 and q5.
macro_rules! eight {
    ($mac:literal: $x0:literal $x1:literal $x2:literal $x3:literal) => {
        concat!(
            "vldrh.u16 q4, [r3], #16\n",
            concat!($mac, " r0, ", $x0, ", q4\n"),
            "vldrh.u16 q5, [r3], #16\n",
            concat!($mac, " r2, ", $x1, ", q4\n"),
            concat!($mac, " r4, ", $x2, ", q4\n"),
            concat!($mac, " r6, ", $x3, ", q4\n"),
            concat!($mac, " r8, ", $x0, ", q5\n"),
            concat!($mac, " r10, ", $x1, ", q5\n"),
            concat!($mac, " r12, ", $x2, ", q5\n"),
            concat!($mac, " lr, ", $x3, ", q5\n"),
        )
    };
}

/// A kernel row of a group for two output channels: six inputs, the last two in place of the first.
macro_rules! two_by_four {
    ($mac:literal) => {
        concat!(
            "vldrh.u16 q0, [r1], #16\n",
            "vldrh.u16 q1, [r1], #16\n",
            "vldrh.u16 q2, [r1], #16\n",
            "vldrh.u16 q3, [r1], #16\n",
            eight!($mac: "q0" "q1" "q2" "q3"),
            "vldrh.u16 q0, [r1], #16\n",
            eight!($mac: "q1" "q2" "q3" "q0"),
            "vldrh.u16 q1, [r1], #16\n",
            eight!($mac: "q2" "q3" "q0" "q1"),
            "add r1, r1, r5\n",
        )
    };
}

/// An input, times the weights of the taps 2, 1 and 0 in q6, q5 and q4, for three columns.
macro_rules! three {
    ($mac:literal: $x:literal: $two:literal $one:literal $zero:literal) => {
        concat!(
            concat!("vldrh.u16 ", $x, ", [r1], #16\n"),
            concat!($mac, " ", $two, ", ", $x, ", q6\n"),
            concat!($mac, " ", $one, ", ", $x, ", q5\n"),
            concat!($mac, " ", $zero, ", ", $x, ", q4\n"),
        )
    };
}

/// A kernel row of a group for one output channel: ten inputs.
macro_rules! one_by_eight {
    ($mac:literal) => {
        concat!(
            "vldrh.u16 q4, [r3], #16\n",
            "vldrh.u16 q0, [r1], #16\n",
            concat!($mac, " r0, q0, q4\n"),
            "vldrh.u16 q5, [r3], #16\n",
            "vldrh.u16 q1, [r1], #16\n",
            concat!($mac, " r0, q1, q5\n"),
            concat!($mac, " r2, q1, q4\n"),
            "vldrh.u16 q6, [r3], #16\n",
            three!($mac: "q2": "r0" "r2" "r4"),
            three!($mac: "q3": "r2" "r4" "r6"),
            three!($mac: "q0": "r4" "r6" "r8"),
            three!($mac: "q1": "r6" "r8" "r10"),
            three!($mac: "q2": "r8" "r10" "r12"),
            three!($mac: "q3": "r10" "r12" "lr"),
            "vldrh.u16 q0, [r1], #16\n",
            concat!($mac, " r12, q0, q6\n"),
            concat!($mac, " lr, q0, q5\n"),
            "vldrh.u16 q1, [r1], #16\n",
            concat!($mac, " lr, q1, q6\n"),
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

/// The two routines of a kind of features: `$two` computes one row of two output channels, a block of two by four
/// columns at a time, in 113 instructions for a group of input channels and 72 vectors of products; `$one` one row of
/// one output channel, a block of eight columns at a time, in 116.
///
/// `sums` (2 or 1, `distance`): each starts at its bias. No sum may overflow.
macro_rules! routines {
    ($number:ident, $mac:literal, $two:ident, $one:ident) => {
        #[inline(always)]
        pub(crate) fn $two(rows: Groups<'_, $number>, cols: usize, bias: [i32; 2], sums: &mut [i32], distance: usize) {
            const COLUMNS: usize = 4;
            let groups = rows.check(VECTOR / size_of::<$number>(), [2, COLUMNS], distance, sums.len());
            for (first, count) in blocks(cols, COLUMNS, distance) {
                if count == 0 {
                    continue;
                }
                let row = Row::new(rows, groups, [first, count, COLUMNS], bias, sums, distance);
                // SAFETY: the blocks lie within `distance` columns, and read two columns more, which the pitch has; as
                // many groups are there as weights. r6 and r7 belong to the compiler and are restored.
                unsafe {
                    blocks_of_row!(
                        row,
                        "vmov r8, s26",
                        two_by_four!($mac),
                        "vmov r0, s27\nadd r0, r0, r9\nstm r0, {{r8, r10, r12, lr}}"
                    );
                }
            }
        }

        #[inline(always)]
        pub(crate) fn $one(rows: Groups<'_, $number>, cols: usize, bias: i32, sums: &mut [i32], distance: usize) {
            const COLUMNS: usize = 8;
            let groups = rows.check(VECTOR / size_of::<$number>(), [1, COLUMNS], distance, sums.len());
            for (first, count) in blocks(cols, COLUMNS, distance) {
                if count == 0 {
                    continue;
                }
                let row = Row::new(rows, groups, [first, count, COLUMNS], [bias; 2], sums, distance);
                // SAFETY: as above.
                unsafe {
                    blocks_of_row!(row, "mov r8, r0", one_by_eight!($mac), "stm r9!, {{r8, r10, r12, lr}}");
                }
            }
        }
    };
}

routines!(i16, "vmladava.s16", correlate_groups2, correlate_groups1);
routines!(i8, "vmladava.s8", correlate_bytes2, correlate_bytes1);

/// The operands of a row.
struct Row {
    /// Second bias, from the end of the first channel's sums to the second's, first bias, weights, groups, and from
    /// behind the last kernel row to the next block.
    numbers: [usize; 6],
    input: *const u8,
    /// From the last input of a kernel row to the first of the next.
    step: usize,
    sums: *mut i32,
    count: usize,
}

impl Row {
    /// `count` blocks of `columns` from column `first` on.
    #[inline(always)]
    fn new<T>(
        rows: Groups<'_, T>,
        groups: usize,
        [first, count, columns]: [usize; 3],
        bias: [i32; 2],
        sums: &mut [i32],
        distance: usize,
    ) -> Self {
        let word = size_of::<u32>();
        let numbers = [
            bias[1] as usize,
            (distance - columns) * word,
            bias[0] as usize,
            rows.weights.as_ptr().addr(),
            groups,
            (3 * groups * rows.pitch - columns) * VECTOR,
        ];
        let input = rows.input[first * (VECTOR / size_of::<T>())..].as_ptr().cast();
        let step = (rows.pitch - columns - 2) * VECTOR;
        Self { numbers, input, step, sums: sums[first..].as_mut_ptr(), count }
    }
}
