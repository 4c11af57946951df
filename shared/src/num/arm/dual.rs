//! The inner loop of the integer convolution in `SMLAD`: two products of 16 bits, added to a sum of 32.

use super::groups::{COLUMNS, Groups, blocks};

/// Channels of a group.
const GROUP: usize = 2;

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

/// One kernel row: five inputs, the last one in place of the first.
macro_rules! kernel_row {
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

/// One row of two output channels, a block of two by three columns at a time: 78 instructions a pair of input channels
/// for 108 products.
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
    let word = size_of::<u32>();
    let width = rows.pitch * word;
    let weights = rows.weights.as_ptr();
    let numbers: [usize; 10] = [
        groups * width,
        // From the third row of a group to the first of the next.
        (2 * groups - 1) * width,
        weights.addr() + groups * 18 * word,
        weights.addr(),
        // From behind the last group to the next block.
        groups * width - COLUMNS * word,
        bias[0] as usize,
        bias[1] as usize,
        sums[first..].as_mut_ptr().addr(),
        distance * word,
        count,
    ];
    // SAFETY: the blocks lie within `distance` columns, and read two columns more, which the pitch has; as many groups
    // are there as weights. r6 and r7 belong to the compiler and are restored.
    unsafe {
        core::arch::asm!(
            "push {{r6, r7}}",
            "vldmia r0, {{s0-s9}}",
            "3:",
            "vmov r0, s5",
            "mov r1, r0",
            "mov r2, r0",
            "vmov r3, s6",
            "mov r4, r3",
            "mov r5, r3",
            "2:",
            kernel_row!(),
            "vmov r6, s0",
            "add r12, r12, r6",
            kernel_row!(),
            "vmov r6, s0",
            "add r12, r12, r6",
            kernel_row!(),
            "vmov r6, s1",
            "sub r12, r12, r6",
            "vmov r6, s2",
            "cmp lr, r6",
            "bne 2b",
            "vmov r6, s7",
            "vmov r7, s8",
            "add r7, r7, r6",
            "stm r7, {{r3-r5}}",
            "stm r6!, {{r0-r2}}",
            "vmov s7, r6",
            "vmov lr, s3",
            "vmov r6, s4",
            "sub r12, r12, r6",
            "vmov r6, s9",
            "subs r6, r6, #1",
            "vmov s9, r6",
            "bne 3b",
            "pop {{r6, r7}}",
            inout("r0") numbers.as_ptr() => _,
            inout("r12") rows.input[first * GROUP..].as_ptr() => _,
            inout("lr") weights => _,
            out("r1") _, out("r2") _, out("r3") _, out("r4") _, out("r5") _,
            out("r8") _, out("r9") _, out("r10") _, out("r11") _,
            out("d0") _, out("d1") _, out("d2") _, out("d3") _, out("d4") _,
        );
    }
}
