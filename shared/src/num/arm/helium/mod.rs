//! Loops in Helium, the vector extension of the Cortex-M55: four singles or eight halves in a register.
//!
//! Helium flushes subnormal singles to zero, operands and results. It converts subnormal halves correctly. Where every
//! possible number is a multiple of a power of two far above 2^-126, as all sums of products of halves are (2^-48),
//! that changes nothing, and the documentation of the routine states it. Most transforms have no such bound. They run
//! under [`unflushed`], which reads from the status register whether a number was flushed, and are then repeated by the
//! scalar unit, which flushes nothing.
//!
//! Helium returns the default NaN for every NaN. It is converted as [`crate::num`] defines.

mod bounds;
mod columns;
mod correlate;
mod dot;
mod extremes;
mod fft;
mod fused;
pub(crate) mod integers16;
pub(crate) mod integers8;
mod rows;
mod sigmoid;

pub(crate) use columns::{
    add_product_columns, forward_columns, scatter_columns, transform_columns, transform_product_columns,
};
pub(crate) use correlate::{correlate1, correlate4};
pub(crate) use dot::{correlate_bytes1, correlate_bytes2, correlate_groups1, correlate_groups2};
pub(in crate::num) use extremes::{count_from, extreme_halves, largest};
pub(in crate::num) use fused::{
    accumulate, add_eights, add_scaled, correct, narrow_relu, narrow_slice, round_interleaved, widen_alternate,
    widen_slice,
};
pub(crate) use integers16::spread_halves;
pub(crate) use rows::{forward_rows, inverse_rows};
pub(in crate::num) use sigmoid::sigmoid;

/// `asm!` that clobbers every vector register and uses the stack.
macro_rules! asm_push {
    ($($item:tt)*) => {
        core::arch::asm!(
            $($item)*
            out("d0") _, out("d1") _, out("d2") _, out("d3") _, out("d4") _, out("d5") _, out("d6") _, out("d7") _,
            out("d8") _, out("d9") _, out("d10") _, out("d11") _,
            out("d12") _, out("d13") _, out("d14") _, out("d15") _,
        )
    };
}

use asm_push;

/// A complex number of four lanes: real parts, imaginary parts.
pub(crate) type Four = [[f32; 4]; 2];

/// Addresses of four rows that lie `stride` bytes apart.
fn rows_at<T>(first: *const T, stride: usize) -> [usize; 4] {
    [0, 1, 2, 3].map(|row| first.addr() + row * stride)
}

/// Shift to the left of an index below `len`, after which reversing its bits gives the offset of the element in bytes.
const fn shift(len: usize) -> u32 {
    (u32::BITS - size_of::<Four>().trailing_zeros()).saturating_sub(len.trailing_zeros())
}

/// Underflow (UFC) and denormal operand (IDC) of the floating-point status register (FPSCR): Helium sets them where it
/// flushes a number (Arm DDI 0553, FPProcessException).
const FLUSHED: u32 = 1 << 3 | 1 << 7;

/// Does `work`, and returns whether Helium flushed nothing to zero meanwhile. Narrowing to halves sets the same flags,
/// so work that narrows must restore them.
#[inline(always)]
fn unflushed(work: impl FnOnce()) -> bool {
    // SAFETY: the flags have no other effect.
    unsafe {
        core::arch::asm!(
            "vmrs {t}, fpscr",
            "bic {t}, {t}, {mask}",
            "vmsr fpscr, {t}",
            t = out(reg) _,
            mask = in(reg) FLUSHED,
        )
    };
    work();
    let status: u32;
    // SAFETY: as above.
    unsafe { core::arch::asm!("vmrs {status}, fpscr", status = out(reg) status) };
    status & FLUSHED == 0
}
