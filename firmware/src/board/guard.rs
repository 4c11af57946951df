//! A guard below the stack: a stack that grows too deep meets memory that can only be read, in place of the variables
//! and buffers that lie there. A frame of a function that is longer than the guard could still step over it.
#![allow(unsafe_code)] // registers, a linker symbol and a handler

use super::restart;
use core::arch::naked_asm;
use core::ptr::addr_of;
use cortex_m::asm::{dsb, isb};
use cortex_m::peripheral::MPU;
use cortex_m::peripheral::scb::Exception;

/// Length of the guard, bytes; it begins at a multiple of that.
const LEN: u32 = 1 << LEN_LOG2;
const LEN_LOG2: u32 = 10;
/// Number of its region in the protection unit. Where regions overlap the higher number counts.
const REGION: u32 = 7;
/// Address of the control register.
const CONTROL: u32 = 0xe000_ed94;
/// Its value: the protection unit is on, except in the handler of a hard fault; elsewhere the default map of the
/// core holds.
pub(super) const ON_WITH_DEFAULT_MAP: u32 = 1 << 2 | 1;

unsafe extern "C" {
    static _stack_end: u8;
}

/// Sets the guard up. Reading it stays possible: that is how the depth of the stack is measured.
pub(super) fn begin() {
    let base = (addr_of!(_stack_end).addr() as u32).next_multiple_of(LEN);
    // SAFETY: the stack is not that deep yet, and nothing but the stack lies there.
    unsafe {
        let mpu = &*MPU::PTR;
        mpu.rnr.write(REGION);
        // Not executable, may be read by the program. ARMv7-M (Arm DDI 0403, B3.5): base, then attributes and size.
        #[cfg(not(feature = "mps3-an547"))]
        {
            mpu.rbar.write(base);
            mpu.rasr.write(1 << 28 | 0b101 << 24 | 1 << 19 | (LEN_LOG2 - 1) << 1 | 1);
        }
        // ARMv8-M (Arm DDI 0553, D1.2): base and attributes, then the last 32 bytes.
        #[cfg(feature = "mps3-an547")]
        {
            mpu.rbar.write(base | 0b10 << 1 | 1);
            mpu.rlar.write((base + LEN - 32) | 1);
        }
        mpu.ctrl.write(ON_WITH_DEFAULT_MAP);
        cortex_m::Peripherals::steal().SCB.enable(Exception::MemoryManagement);
    }
    dsb();
    isb();
}

/// The guard was written to. The handler needs a stack, so the protection unit is turned off first. Where the core
/// could not even store its registers it has raised a hard fault instead, whose handler runs without the protection
/// unit.
#[unsafe(naked)]
#[unsafe(no_mangle)]
unsafe extern "C" fn MemoryManagement() {
    naked_asm!(
        "ldr r0, ={control}",
        "movs r1, #0",
        "str r1, [r0]",
        "dsb",
        "isb",
        "b {fault}",
        control = const CONTROL,
        fault = sym fault,
    )
}

extern "C" fn fault() -> ! {
    restart::fault()
}
