//! The second switch of the excitation LED.

use core::sync::atomic::{AtomicBool, AtomicU32, Ordering};

/// When an LED that is lit must be dark at the latest. The program darkens it itself; an interrupt that asks
/// [`Self::expired`] darkens it where the program hangs during an exposure. Clocks wrap at 32 bits.
#[derive(Debug, Default)]
pub struct Interlock {
    lit: AtomicBool,
    until_us: AtomicU32,
}

impl Interlock {
    /// Of a dark LED.
    pub const fn new() -> Self {
        Self { lit: AtomicBool::new(false), until_us: AtomicU32::new(0) }
    }

    /// The LED is about to be lit at `now_us`, for `longest_us` at most (below 2^31).
    pub fn lights(&self, now_us: u32, longest_us: u32) {
        self.until_us.store(now_us.wrapping_add(longest_us), Ordering::Release);
        self.lit.store(true, Ordering::Release);
    }

    /// The LED is dark.
    pub fn is_dark(&self) {
        self.lit.store(false, Ordering::Release);
    }

    /// Whether the LED is lit.
    pub fn is_lit(&self) -> bool {
        self.lit.load(Ordering::Acquire)
    }

    /// Whether the LED is lit although its time is over.
    pub fn expired(&self, now_us: u32) -> bool {
        let over = now_us.wrapping_sub(self.until_us.load(Ordering::Acquire));
        self.is_lit() && over > 0 && over < 1 << 31
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_led_that_was_forgotten_is_noticed_and_one_in_time_is_not() {
        let interlock = Interlock::new();
        assert!(!interlock.expired(0) && !interlock.expired(u32::MAX));
        for now in [0, 5, u32::MAX - 10] {
            interlock.lights(now, 1000);
            assert!(!interlock.expired(now) && !interlock.expired(now.wrapping_add(1000)));
            assert!(interlock.expired(now.wrapping_add(1001)) && interlock.expired(now.wrapping_add(60_000_000)));
            interlock.is_dark();
            assert!(!interlock.expired(now.wrapping_add(1001)));
        }
    }
}
