//! A clock that runs while the core sleeps (FPGAIO block, counter: ARM DAI 0500, table 4-6).
#![allow(unsafe_code)] // registers are memory

use super::map::MAP;
use crate::board::activity::Account;
use core::ptr::{read_volatile, write_volatile};
use ommatidia_shared::wire::Activity;

/// The FPGAIO block begins with the register of the LEDs.
const COUNTER: *mut u32 = (MAP.leds + 0x18) as *mut u32;
const PRESCALE: *mut u32 = (MAP.leds + 0x1c) as *mut u32;

/// The clock of the block is the boards' 25 MHz.
static ACCOUNT: Account<25_000> = Account::new();

/// Starts the clock at the rate of the block.
pub(super) fn begin() {
    // SAFETY: a device register of this board, written here only.
    unsafe { write_volatile(PRESCALE, 0) };
    ACCOUNT.begin(now());
}

pub(super) fn now() -> u32 {
    // SAFETY: reading the counter changes nothing.
    unsafe { read_volatile(COUNTER) }
}

/// Records that the core has slept since `before`.
pub(super) fn slept(before: u32) {
    ACCOUNT.slept(before, now());
}

/// How long the core has run and slept.
pub(super) fn activity() -> Option<Activity> {
    Some(ACCOUNT.activity(now()))
}

/// Microseconds since the start.
pub(super) fn now_us() -> u64 {
    ACCOUNT.now_us(now())
}
