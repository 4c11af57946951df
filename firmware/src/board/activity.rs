//! Account of the time since the start, and of the time that the core slept in it.

use core::sync::atomic::{AtomicU32, Ordering};
use ommatidia_shared::wire::Activity;

/// The account of a board whose clock counts `PER_MS` ticks per millisecond and wraps at 32 bits. Only one thread uses
/// it.
pub(super) struct Account<const PER_MS: u32> {
    /// Clock at the last update of the account.
    last: AtomicU32,
    total: Sum<PER_MS>,
    asleep: Sum<PER_MS>,
}

impl<const PER_MS: u32> Account<PER_MS> {
    pub(super) const fn new() -> Self {
        Self { last: AtomicU32::new(0), total: Sum::new(), asleep: Sum::new() }
    }

    /// Begins the account at clock `now`.
    pub(super) fn begin(&self, now: u32) {
        self.last.store(now, Ordering::Relaxed);
    }

    /// Records that the core has slept from `before` to `now`.
    pub(super) fn slept(&self, before: u32, now: u32) {
        self.asleep.add(now.wrapping_sub(before));
        self.pass(now);
    }

    /// Time since the start and time asleep, at clock `now`.
    pub(super) fn activity(&self, now: u32) -> Activity {
        self.pass(now);
        Activity { total_ms: self.total.ms(), asleep_ms: self.asleep.ms() }
    }

    /// Time since the start, microseconds, at clock `now`.
    pub(super) fn now_us(&self, now: u32) -> u64 {
        self.pass(now);
        self.total.us()
    }

    fn pass(&self, now: u32) {
        self.total.add(now.wrapping_sub(self.last.load(Ordering::Relaxed)));
        self.last.store(now, Ordering::Relaxed);
    }
}

/// A sum of ticks: its low and its high word, as the cores have no atomic numbers of 64 bits.
struct Sum<const PER_MS: u32>([AtomicU32; 2]);

impl<const PER_MS: u32> Sum<PER_MS> {
    const fn new() -> Self {
        Self([AtomicU32::new(0), AtomicU32::new(0)])
    }

    fn ticks(&self) -> u64 {
        let [low, high] = self.0.each_ref().map(|word| u64::from(word.load(Ordering::Relaxed)));
        high << 32 | low
    }

    /// Milliseconds, at most 49 days of them: the message has 32 bits.
    fn ms(&self) -> u32 {
        u32::try_from(self.ticks() / u64::from(PER_MS)).unwrap_or(u32::MAX)
    }

    fn us(&self) -> u64 {
        let (ticks, per_ms) = (self.ticks(), u64::from(PER_MS));
        ticks / per_ms * 1000 + ticks % per_ms * 1000 / per_ms
    }

    fn add(&self, ticks: u32) {
        let sum = self.ticks().wrapping_add(ticks.into());
        for (word, value) in self.0.iter().zip([sum as u32, (sum >> 32) as u32]) {
            word.store(value, Ordering::Relaxed);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The longest step between two updates of a clock of 32 bits that a test takes.
    const STEP: u32 = 0xffff_0000;

    fn after<const PER_MS: u32>(steps: u32) -> (u64, Activity) {
        let account = Account::<PER_MS>::new();
        let (mut now, mut last_us) = (7, 0);
        account.begin(now);
        for _ in 0..steps {
            now = now.wrapping_add(STEP);
            let us = account.now_us(now);
            assert!(us > last_us, "the clock went from {last_us} to {us} us");
            last_us = us;
        }
        account.slept(now, now.wrapping_add(PER_MS));
        (last_us, account.activity(now.wrapping_add(PER_MS)))
    }

    #[test]
    fn the_clock_never_steps_back() {
        // Microseconds, for 100 days: the sum of milliseconds passes 32 bits after 49 of them.
        let (us, activity) = after::<1000>(2012);
        assert_eq!((us, activity.total_ms, activity.asleep_ms), (2012 * u64::from(STEP), u32::MAX, 1));
        // The 25 MHz of the emulated boards, for an hour.
        let (us, activity) = after::<25_000>(21);
        let ticks = 21 * u64::from(STEP);
        assert_eq!(us, ticks / 25);
        assert_eq!((u64::from(activity.total_ms), activity.asleep_ms), (ticks / 25_000 + 1, 1));
    }
}
