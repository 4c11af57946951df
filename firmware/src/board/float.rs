//! The mode of the floating-point unit that the numeric policy needs.
#![allow(unsafe_code)] // a register

use core::arch::asm;

/// Alternative halves, default NaN, flush to zero, rounding, flush to zero of halves (Arm DDI 0553, FPSCR; the last one
/// is reserved on cores before the M55). All 0: IEEE halves, subnormals kept, round to nearest even. The other bits are
/// flags, and the length of Helium's loops, which the core sets.
const MODE: u32 = 1 << 26 | 1 << 25 | 1 << 24 | 3 << 22 | 1 << 19;
/// The same of the floating-point context that an exception handler begins with (FPDSCR).
const DEFAULT: *mut u32 = 0xe000_ef3c as *mut u32;

/// Sets the mode, whatever ran before this program, and returns whether the unit has it.
pub(super) fn set_mode() -> bool {
    let mut status: u32;
    // SAFETY: the mode is that which the compiler assumes; FPDSCR is a register of every core with this unit.
    unsafe {
        DEFAULT.write_volatile(DEFAULT.read_volatile() & !MODE);
        asm!(
            "vmrs {status}, fpscr",
            "bic {status}, {status}, {mode}",
            "vmsr fpscr, {status}",
            "vmrs {status}, fpscr",
            status = out(reg) status,
            mode = in(reg) MODE,
            options(nostack)
        );
        status & MODE == 0 && DEFAULT.read_volatile() & MODE == 0
    }
}
