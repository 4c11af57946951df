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

    /// Time since the start, microseconds, at clock `now`. It wraps after 49 days.
    pub(super) fn now_us(&self, now: u32) -> u64 {
        self.pass(now);
        self.total.us()
    }

    fn pass(&self, now: u32) {
        self.total.add(now.wrapping_sub(self.last.load(Ordering::Relaxed)));
        self.last.store(now, Ordering::Relaxed);
    }
}

/// A sum of ticks, in milliseconds.
struct Sum<const PER_MS: u32> {
    ms: AtomicU32,
    rest: AtomicU32,
}

impl<const PER_MS: u32> Sum<PER_MS> {
    const fn new() -> Self {
        Self { ms: AtomicU32::new(0), rest: AtomicU32::new(0) }
    }

    fn ms(&self) -> u32 {
        self.ms.load(Ordering::Relaxed)
    }

    fn us(&self) -> u64 {
        let rest = u64::from(self.rest.load(Ordering::Relaxed)) * 1000 / u64::from(PER_MS);
        u64::from(self.ms()) * 1000 + rest
    }

    fn add(&self, ticks: u32) {
        let ticks = u64::from(self.rest.load(Ordering::Relaxed)) + u64::from(ticks);
        self.rest.store((ticks % u64::from(PER_MS)) as u32, Ordering::Relaxed);
        self.ms.store(self.ms().wrapping_add((ticks / u64::from(PER_MS)) as u32), Ordering::Relaxed);
    }
}
