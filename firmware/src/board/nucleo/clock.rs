//! A clock that runs while the core sleeps (TIM2, in microseconds), and a tick that wakes the core.

use crate::board::activity::Account;
use cortex_m::peripheral::SYST;
use cortex_m::peripheral::syst::SystClkSource;
use embassy_stm32::pac::{RCC, TIM2};
use ommatidia_shared::wire::Activity;

/// Cycles between two ticks: the longest, 35 ms.
const TICK_CYCLES: u32 = 0x00ff_ffff;

static ACCOUNT: Account<1000> = Account::new();

/// Starts the clock and the tick, which is handled in [`super::light`]. The clock of the timers of APB1, `timer_mhz`,
/// is twice the bus (ST RM0433, section 8.5.5).
pub(super) fn begin(mut tick: SYST, timer_mhz: u16) {
    RCC.apb1lenr().modify(|w| w.set_tim2en(true));
    TIM2.psc().write_value(timer_mhz - 1);
    // An update event loads the prescaler.
    TIM2.egr().write(|w| w.set_ug(true));
    TIM2.cr1().modify(|w| w.set_cen(true));
    ACCOUNT.begin(now());
    tick.set_clock_source(SystClkSource::Core);
    tick.set_reload(TICK_CYCLES);
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
