//! Reads that may fail. A word of flash whose error correction fails is a fault of the bus when it is read. The handler
//! of that fault skips the one read that expects it, and resets the board for every other one.
//!
//! Zephyr reads the flash of the STM32H7 with all faults masked (FAULTMASK, CCR.BFHFNMIGN) instead. QEMU does not
//! emulate that; a handler does the same on silicon, is tried on every emulated board, and stops no interrupt.
#![allow(unsafe_code)] // a handler, and reads that may fail

use super::restart;
use core::arch::{asm, naked_asm};
use core::sync::atomic::{AtomicU32, Ordering::Relaxed};
use cortex_m::asm::dsb;
use cortex_m::peripheral::SCB;
use cortex_m::peripheral::scb::Exception;

/// Whether a read is being tried.
static TRYING: AtomicU32 = AtomicU32::new(IDLE);
const IDLE: u32 = 0;
const TRIED: u32 = 1;
const FAILED: u32 = 2;

/// The flags of bus faults in the configurable fault status register.
const BUS_FAULTS: u32 = 0xff << 8;

/// Whether the word at `at` can be read.
///
/// # Safety
/// Reading the word must have no effect, if it can be read.
pub(super) unsafe fn readable(at: *const u32) -> bool {
    // SAFETY: bus faults are enabled and cleared here only; the read is the caller's.
    unsafe {
        let mut core = cortex_m::Peripherals::steal();
        core.SCB.enable(Exception::BusFault);
        TRYING.store(TRIED, Relaxed);
        dsb();
        // Four bytes, as the handler skips as many.
        asm!("ldr.w {word}, [{at}]", "dsb", word = out(reg) _, at = in(reg) at, options(nostack, preserves_flags));
        let failed = TRYING.swap(IDLE, Relaxed) == FAILED;
        (*SCB::PTR).cfsr.write(BUS_FAULTS);
        !failed
    }
}

/// A fault of the bus: where a read is being tried, goes on behind it.
#[unsafe(naked)]
#[unsafe(no_mangle)]
unsafe extern "C" fn BusFault() {
    naked_asm!(
        "ldr r0, ={trying}",
        "ldr r1, [r0]",
        "cmp r1, #{tried}",
        "bne 1f",
        "movs r1, #{failed}",
        "str r1, [r0]",
        // The stack that was in use, and in it the address of the read.
        "tst lr, #4",
        "ite eq",
        "mrseq r0, msp",
        "mrsne r0, psp",
        "ldr r1, [r0, #24]",
        "adds r1, #4",
        "str r1, [r0, #24]",
        "bx lr",
        "1: b {fault}",
        trying = sym TRYING,
        tried = const TRIED,
        failed = const FAILED,
        fault = sym fault,
    )
}

extern "C" fn fault() -> ! {
    restart::fault()
}
