//! CMSDK watchdog (ARM Cortex-M System Design Kit, DDI 0479, section 4.7).
#![allow(unsafe_code)] // registers are memory

use super::map::MAP;
use crate::board::restart;
use core::ptr::write_volatile;
use cortex_m_rt::exception;
use ommatidia_shared::device::Watchdog;

const BASE: usize = MAP.watchdog;
const LOAD: *mut u32 = BASE as *mut u32;
const CONTROL: *mut u32 = (BASE + 8) as *mut u32;
const INTCLEAR: *mut u32 = (BASE + 12) as *mut u32;
const LOCK: *mut u32 = (BASE + 0xc00) as *mut u32;

/// Control bits: count, and reset when the count ends a second time.
const INTERRUPT_AND_RESET: u32 = 3;
const UNLOCK: u32 = 0x1acc_e551;
/// Seconds between two feeds: more than the longest reconstruction takes, under an emulator too.
pub(super) const PATIENCE_S: u32 = 30;

/// The watchdog. When its count ends it raises the non-maskable interrupt, whose handler stores the cause for the next
/// start and resets the board. If that fails, the watchdog resets the board when its count ends again.
#[derive(Clone, Copy, Debug)]
pub struct Dog {
    seconds: u32,
}

impl Dog {
    /// A watchdog, not started yet, that must be fed every `seconds`, at most 171.
    pub const fn new(seconds: u32) -> Self {
        Self { seconds }
    }
}

impl Watchdog for Dog {
    fn start(&mut self) {
        // SAFETY: device registers of this board, used from here only.
        unsafe {
            write_volatile(LOCK, UNLOCK);
            write_volatile(LOAD, self.seconds.saturating_mul(MAP.watchdog_hz));
            write_volatile(CONTROL, INTERRUPT_AND_RESET);
        }
    }

    fn feed(&mut self) {
        // SAFETY: as above. Clearing the interrupt restarts the count.
        unsafe { write_volatile(INTCLEAR, 1) };
    }
}

/// The program has hung: stores the cause and resets the board.
#[exception]
unsafe fn NonMaskableInt() {
    restart::hung()
}
