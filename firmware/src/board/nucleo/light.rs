//! The excitation LED: the current of its driver follows the converter DAC1 (ST RM0433, chapter 26), output 2, and the
//! driver is enabled by the pin LED_OUT of the sensor, which is high during exposures. The program sets the level to 0
//! at the end of each exposure, and the tick does so where the program hangs.

use super::clock;
use crate::log;
use cortex_m_rt::exception;
use embassy_stm32::pac::{DAC1, RCC};
use embassy_stm32::peripherals::PA5;
use embassy_stm32::{Peri, gpio};
use ommatidia_shared::device::Interlock;

/// Time that the level may stay on after an exposure, us. The sensor starts an exposure up to a row or two after the
/// pulse. The next tick sets it to 0, so that it is 0 after twice that time.
const AFTER_US: u32 = 5_000;
const _: () = assert!(AFTER_US + clock::TICK_US <= 10_000, "docs/boards.md says 10 ms");
/// Output 2 of the converter.
const OUTPUT: usize = 1;

static INTERLOCK: Interlock = Interlock::new();

/// Turns the converter on, at level 0.
pub(super) fn begin(pin: Peri<'static, PA5>) {
    // An analogue pin, which it is after a reset as well.
    let _analogue = gpio::Flex::new(pin);
    RCC.apb1lenr().modify(|w| w.set_dac12en(true));
    off();
    DAC1.cr().modify(|w| w.set_en(OUTPUT, true));
}

/// Sets the level, 0 to 4095, for an exposure.
pub(super) fn set(level: u16, exposure_us: u32) {
    if level == 0 {
        return off();
    }
    INTERLOCK.lights(clock::now(), exposure_us.saturating_add(AFTER_US));
    DAC1.dhr12r(OUTPUT).write(|w| w.set_dhr(level));
}

/// The program has failed, perhaps before the converter was turned on.
pub(super) fn fail() {
    if INTERLOCK.is_lit() {
        off();
    }
}

/// Level 0.
fn off() {
    DAC1.dhr12r(OUTPUT).write(|w| w.set_dhr(0));
    INTERLOCK.is_dark();
}

/// The tick wakes the core, and watches over the LED.
#[exception]
fn SysTick() {
    if INTERLOCK.expired(clock::now()) {
        off();
        log::interlock();
    }
}
