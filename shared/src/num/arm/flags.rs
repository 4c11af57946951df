//! The overflow flag of the floating-point unit.

use core::arch::asm;

use crate::num::f16;

/// Overflow (OFC) of the floating-point status register: set where a number was rounded to infinity.
const OVERFLOW: u32 = 1 << 2;

/// Whether a number has overflowed since the last call that returned true, which clears the flag.
#[inline(always)]
pub(in crate::num) fn overflowed() -> bool {
    let status: u32;
    // SAFETY: reads a register. As it may read memory for all the compiler knows, it stays behind the stores before it.
    unsafe { asm!("vmrs {status}, fpscr", status = out(reg) status, options(nostack, preserves_flags)) };
    let up = status & OVERFLOW != 0;
    if up {
        // SAFETY: the flag has no other effect.
        unsafe { asm!("vmsr fpscr, {status}", status = in(reg) status & !OVERFLOW, options(nostack)) };
    }
    up
}

/// Narrows all of `from`. Returns the number of elements done.
#[inline(always)]
pub(in crate::num) fn narrow_whole(from: &[f32], to: &mut [f16]) -> usize {
    let len = from.len().min(to.len());
    crate::num::narrow_slice(&from[..len], &mut to[..len]);
    len
}
