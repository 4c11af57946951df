//! What one start leaves for the next: why it ended, and how many there have been. It lies in memory that neither a
//! reset nor the start-up code clears.
#![allow(unsafe_code)] // a section of its own

use crate::start::Start;
use core::sync::atomic::{AtomicU32, Ordering::Relaxed};
use cortex_m::peripheral::SCB;
use cortex_m_rt::{ExceptionFrame, exception};
use ommatidia_shared::wire::StartCause;

/// Starts in a row that end in a fault, after which no network runs until another one is sent.
const MOST_FAULTS: u32 = 3;

/// Marks the memory as written by this program: after the power came on it holds anything.
const KEY: u32 = 0x4f6d_6d61;
/// Causes of a reset.
const HUNG: u32 = 0x4d6f_7073;
const FAULT: u32 = 0x4661_756c;

#[unsafe(link_section = ".uninit.note")]
static NOTE: Note =
    Note { key: AtomicU32::new(0), cause: AtomicU32::new(0), starts: AtomicU32::new(0), faults: AtomicU32::new(0) };

struct Note {
    key: AtomicU32,
    cause: AtomicU32,
    starts: AtomicU32,
    /// Starts in a row that a fault has ended, without a run that was finished in between.
    faults: AtomicU32,
}

/// Counts this start, and reads why the one before ended. `watchdog`: whether the hardware says that the watchdog has
/// reset the board. To be called once.
pub(super) fn begin(watchdog: bool) -> Start {
    if NOTE.key.swap(KEY, Relaxed) != KEY {
        [&NOTE.cause, &NOTE.starts, &NOTE.faults].iter().for_each(|field| field.store(0, Relaxed));
    }
    let cause = match NOTE.cause.swap(0, Relaxed) {
        HUNG => StartCause::Watchdog,
        FAULT => StartCause::Fault,
        _ if watchdog => StartCause::Watchdog,
        _ => StartCause::Power,
    };
    let count = NOTE.starts.load(Relaxed).saturating_add(1);
    NOTE.starts.store(count, Relaxed);
    let faults = if cause == StartCause::Fault { NOTE.faults.load(Relaxed).saturating_add(1) } else { 0 };
    NOTE.faults.store(faults, Relaxed);
    Start { cause, count, keeps_faulting: faults >= MOST_FAULTS, settled }
}

/// A run has ended well: faults before it no longer count.
fn settled() {
    NOTE.faults.store(0, Relaxed);
}

/// Resets the board, whose program has hung. The hardware of the other boards does that itself, and says so.
#[cfg(feature = "emulated")]
pub(super) fn hung() -> ! {
    reset(HUNG)
}

/// Resets the board after a fault of the core or a panic.
pub(super) fn fault() -> ! {
    reset(FAULT)
}

fn reset(cause: u32) -> ! {
    NOTE.cause.store(cause, Relaxed);
    SCB::sys_reset()
}

/// Every fault of the core: a word of the flash that cannot be read, an address without memory, a stack too deep
/// (`guard`). The next start checks the network again; where starts keep ending so, none runs.
#[exception]
unsafe fn HardFault(_: &ExceptionFrame) -> ! {
    fault()
}
