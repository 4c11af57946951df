//! The inner loops of the integer convolution in `SMLAD`: two products of 16 bits, added to a sum of 32.

use super::groups::{Groups, blocks};

/// Channels of a group.
const GROUP: usize = 2;
/// Steps, each a kernel row of a group, that are done in a row. The number of channels is a multiple of eight, that of
/// steps one of twelve.
const UNROLLED: usize = 6;

/// Repeats the instructions of a step, and moves the input on to the next one.
macro_rules! steps {
    ($step:expr) => {
        concat!($step, next!(), $step, next!(), $step, next!(), $step, next!(), $step, next!(), $step, next!())
    };
}

/// The next step's input lies s0 bytes further.
macro_rules! next {
    () => {
        "vmov r6, s0\nadd r12, r12, r6\n"
    };
}

/// Three columns of two output channels, times the weights of a tap in r10 and r11.
macro_rules! six {
    ($x0:literal $x1:literal $x2:literal) => {
        concat!(
            "ldrd r10, r11, [lr], #8\n",
            concat!("smlad r0, ", $x0, ", r10, r0\n"),
            concat!("smlad r1, ", $x1, ", r10, r1\n"),
            concat!("smlad r2, ", $x2, ", r10, r2\n"),
            concat!("smlad r3, ", $x0, ", r11, r3\n"),
            concat!("smlad r4, ", $x1, ", r11, r4\n"),
            concat!("smlad r5, ", $x2, ", r11, r5\n"),
        )
    };
}

/// A step of two output channels: five inputs, the last one in place of the first.
macro_rules! two_by_three {
    () => {
        concat!(
            "ldm r12, {{r6-r9}}\n",
            six!("r6" "r7" "r8"),
            six!("r7" "r8" "r9"),
            "ldr r6, [r12, #16]\n",
            six!("r8" "r9" "r6"),
        )
    };
}

/// A step of one output channel: eight inputs, three at a time, times the weights of the three taps in r9 to r11.
macro_rules! one_by_six {
    () => {
        concat!(
            "ldm lr!, {{r9-r11}}\n",
            "ldm r12!, {{r6-r8}}\n",
            "smlad r0, r6, r9, r0\n",
            "smlad r1, r7, r9, r1\n",
            "smlad r2, r8, r9, r2\n",
            "smlad r0, r7, r10, r0\n",
            "smlad r1, r8, r10, r1\n",
            "smlad r0, r8, r11, r0\n",
            "ldm r12!, {{r6-r8}}\n",
            "smlad r3, r6, r9, r3\n",
            "smlad r4, r7, r9, r4\n",
            "smlad r5, r8, r9, r5\n",
            "smlad r2, r6, r10, r2\n",
            "smlad r3, r7, r10, r3\n",
            "smlad r4, r8, r10, r4\n",
            "smlad r1, r6, r11, r1\n",
            "smlad r2, r7, r11, r2\n",
            "smlad r3, r8, r11, r3\n",
            "ldm r12!, {{r6-r7}}\n",
            "smlad r5, r6, r10, r5\n",
            "smlad r4, r6, r11, r4\n",
            "smlad r5, r7, r11, r5\n",
        )
    };
}

/// The numbers that a routine keeps in s0 to s8.
struct Numbers {
    /// From the input of a step, or from its end, to the next one.
    step: usize,
    weights: usize,
    weights_end: usize,
    /// From behind the last step to the next block.
    back: usize,
    bias: [i32; 2],
    sums: usize,
    /// Between the sums of the two channels.
    distance: usize,
    count: usize,
}

impl Numbers {
    /// In the order of the registers.
    fn words(self) -> [usize; 9] {
        let Self { step, weights, weights_end, back, bias, sums, distance, count } = self;
        [step, weights_end, weights, back, bias[0] as usize, bias[1] as usize, sums, distance, count]
    }
}

/// `asm!` of all blocks of a row: the accumulators start at `$start`, `$step` is repeated, and `$store` stores them
/// with r6 at the sums.
macro_rules! blocks_of_row {
    ($numbers:expr, $input:expr, $weights:expr, $start:literal, $step:expr, $store:literal) => {
        core::arch::asm!(
            "push {{r6, r7}}",
            "vldmia r0, {{s0-s8}}",
            "3:",
            $start,
            "2:",
            steps!($step),
            "vmov r6, s1",
            "cmp lr, r6",
            "bne 2b",
            "vmov r6, s6",
            $store,
            "vmov s6, r6",
            "vmov lr, s2",
            "vmov r6, s3",
            "sub r12, r12, r6",
            "vmov r6, s8",
            "subs r6, r6, #1",
            "vmov s8, r6",
            "bne 3b",
            "pop {{r6, r7}}",
            inout("r0") $numbers.as_ptr() => _,
            inout("r12") $input => _,
            inout("lr") $weights => _,
            out("r1") _, out("r2") _, out("r3") _, out("r4") _, out("r5") _,
            out("r8") _, out("r9") _, out("r10") _, out("r11") _,
            out("d0") _, out("d1") _, out("d2") _, out("d3") _, out("d4") _,
        )
    };
}

/// One row of two output channels, a block of two by three columns at a time: 153 instructions for six steps and 216
/// products.
///
/// `sums` (2, `distance`): each starts at its bias. No sum may overflow.
#[inline(always)]
pub(crate) fn correlate_groups2(rows: Groups<'_>, cols: usize, bias: [i32; 2], sums: &mut [i32], distance: usize) {
    const COLUMNS: usize = 3;
    let steps = steps(rows, [2, COLUMNS], distance, sums.len());
    for (first, count) in blocks(cols, COLUMNS, distance) {
        if count == 0 {
            continue;
        }
        let numbers = numbers(rows, steps, [0, COLUMNS], bias, &mut sums[first..], [distance, count]).words();
        // SAFETY: the blocks lie within `distance` columns, and read two columns more, which the pitch has; as many
        // steps are there as weights. r6 and r7 belong to the compiler and are restored.
        unsafe {
            blocks_of_row!(
                numbers,
                rows.input[first * GROUP..].as_ptr(),
                rows.weights.as_ptr(),
                "vmov r0, s4\nmov r1, r0\nmov r2, r0\nvmov r3, s5\nmov r4, r3\nmov r5, r3",
                two_by_three!(),
                "vmov r7, s7\nadd r7, r7, r6\nstm r7, {{r3-r5}}\nstm r6!, {{r0-r2}}"
            );
        }
    }
}

/// One row of one output channel, a block of six columns at a time: 147 instructions for six steps and 216 products.
///
/// `sums` (`distance`): each starts at the bias. No sum may overflow.
#[inline(always)]
pub(crate) fn correlate_groups1(rows: Groups<'_>, cols: usize, bias: i32, sums: &mut [i32], distance: usize) {
    const COLUMNS: usize = 6;
    let steps = steps(rows, [1, COLUMNS], distance, sums.len());
    for (first, count) in blocks(cols, COLUMNS, distance) {
        if count == 0 {
            continue;
        }
        let read = COLUMNS + 2;
        let numbers = numbers(rows, steps, [read, COLUMNS], [bias; 2], &mut sums[first..], [distance, count]).words();
        // SAFETY: as in `correlate_groups2`.
        unsafe {
            blocks_of_row!(
                numbers,
                rows.input[first * GROUP..].as_ptr(),
                rows.weights.as_ptr(),
                "vmov r0, s4\nmov r1, r0\nmov r2, r0\nmov r3, r0\nmov r4, r0\nmov r5, r0",
                one_by_six!(),
                "stm r6!, {{r0-r5}}"
            );
        }
    }
}

/// The number of steps. Panics unless the slices hold everything, and the steps are whole rounds of the loop.
#[inline(always)]
fn steps(rows: Groups<'_>, block: [usize; 2], distance: usize, sums: usize) -> usize {
    let steps = 3 * rows.check(GROUP, block, distance, sums);
    assert!(steps.is_multiple_of(UNROLLED), "{steps} steps");
    steps
}

/// The numbers of a row. A step moves the input on by `read` columns, a block by `columns`.
#[inline(always)]
fn numbers(
    rows: Groups<'_>,
    steps: usize,
    [read, columns]: [usize; 2],
    bias: [i32; 2],
    sums: &mut [i32],
    [distance, count]: [usize; 2],
) -> Numbers {
    let word = size_of::<u32>();
    Numbers {
        step: (rows.pitch - read) * word,
        weights: rows.weights.as_ptr().addr(),
        weights_end: rows.weights.as_ptr_range().end.addr(),
        back: (steps * rows.pitch - columns) * word,
        bias,
        sums: sums.as_mut_ptr().addr(),
        distance: distance * word,
        count,
    }
}
