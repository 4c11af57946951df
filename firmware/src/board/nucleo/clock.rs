//! A clock that runs while the core sleeps (TIM2, in microseconds), and a tick that wakes the core.

use crate::board::activity::Account;
use cortex_m::peripheral::SYST;
use cortex_m::peripheral::syst::SystClkSource;
use embassy_stm32::pac::{RCC, TIM2};
use ommatidia_shared::wire::Activity;

/// Time between two ticks, us.
pub(super) const TICK_US: u32 = 5_000;

static ACCOUNT: Account<1000> = Account::new();

/// Starts the clock and the tick, which is handled in [`super::light`], of a core of `core_mhz`. The timers of APB1
/// have twice the clock of the bus, half that of the core (ST RM0433, section 8.5.5).
pub(super) fn begin(mut tick: SYST, core_mhz: u16) {
    RCC.apb1lenr().modify(|w| w.set_tim2en(true));
    TIM2.psc().write_value(core_mhz / 2 - 1);
    // An update event loads the prescaler.
    TIM2.egr().write(|w| w.set_ug(true));
    TIM2.cr1().modify(|w| w.set_cen(true));
    ACCOUNT.begin(now());
    tick.set_clock_source(SystClkSource::Core);
    // At 480 MHz a seventh of what its 24 bits hold.
    tick.set_reload(u32::from(core_mhz) * TICK_US - 1);
    tick.clear_current();
    tick.enable_counter();
    tick.enable_interrupt();
}

pub(super) fn now() -> u32 {
    TIM2.cnt().read()
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
