//! The program: the parts of a board, and the conversation with the host.

use crate::log::info;
use embedded_hal::digital::OutputPin;
use embedded_io::{Read, Write};
use half::f16;
use ommatidia_shared::device::{Arenas, Device, End, Footprint, FrameInput, Line, Monitor, RamObject, Watchdog, serve};
use ommatidia_shared::flash::MappedFlash;
use ommatidia_shared::wire::{Activity, StartCause};

/// The parts of a board.
#[derive(Debug)]
pub struct Parts<'m, L, P, F, W, S> {
    /// Name that the host prints.
    pub name: &'static str,
    /// Serial line to the host.
    pub link: L,
    /// Buffers of the line.
    pub line: &'m mut Line,
    /// Pin or LED that is high while a reconstruction is computed.
    pub trigger: P,
    /// Resets the board when the program hangs.
    pub watchdog: W,
    /// Why the program was started.
    pub started_by: StartCause,
    /// What the program takes of the memory.
    pub footprint: fn() -> Footprint,
    /// Cycles of the core so far, where they are counted; they wrap.
    pub cycles: fn() -> Option<u32>,
    /// Temperature in hundredths of a degree Celsius, where there is a sensor.
    pub temperature_cdeg: fn() -> Option<i16>,
    /// How the core spends its time, where there is a clock.
    pub activity: fn() -> Option<Activity>,
    /// Where the network files are kept.
    pub flash: F,
    /// Where raw frames come from.
    pub source: S,
    /// Where the reconstruction goes.
    pub object: &'m mut [f16],
    /// Working memory.
    pub arenas: Arenas<'m>,
}

/// Serves the host until it asks the program to end.
///
/// # Errors
/// Those of the line.
pub fn run<L: Read + Write, P: OutputPin, F: MappedFlash, W: Watchdog, S: FrameInput>(
    parts: Parts<'_, L, P, F, W, S>,
) -> Result<End, L::Error> {
    let Parts { name, mut link, line, trigger, mut watchdog, started_by, footprint, cycles, .. } = parts;
    let Parts { temperature_cdeg, activity, .. } = parts;
    watchdog.start();
    info!("{} is listening", name);
    let monitor = Board { trigger, watchdog, started_by, footprint, cycles, temperature_cdeg, activity, began: None };
    let (source, sink) = (parts.source, RamObject::new(parts.object));
    let end = serve(&mut link, line, &mut Device::new(name, parts.flash, source, sink, parts.arenas, monitor));
    info!("the host has left");
    end
}

/// Trigger pin, watchdog, counters and instruction markers.
struct Board<P, W> {
    trigger: P,
    watchdog: W,
    started_by: StartCause,
    footprint: fn() -> Footprint,
    cycles: fn() -> Option<u32>,
    temperature_cdeg: fn() -> Option<i16>,
    activity: fn() -> Option<Activity>,
    /// Cycles when the run began.
    began: Option<u32>,
}

impl<P: OutputPin, W: Watchdog> Monitor for Board<P, W> {
    fn alive(&mut self) {
        self.watchdog.feed();
    }

    fn run_begins(&mut self) {
        info!("run");
        self.watchdog.feed();
        // A pin that fails costs the trigger, not the reconstruction.
        let _ = self.trigger.set_high();
        self.began = (self.cycles)();
        region_begins();
    }

    fn run_ends(&mut self) -> Option<u32> {
        region_ends();
        let cycles = (self.cycles)().zip(self.began).map(|(now, began)| now.wrapping_sub(began));
        let _ = self.trigger.set_low();
        self.watchdog.feed();
        info!("done");
        cycles
    }

    fn footprint(&self) -> Footprint {
        (self.footprint)()
    }

    fn temperature_cdeg(&mut self) -> Option<i16> {
        (self.temperature_cdeg)()
    }

    fn start_cause(&self) -> StartCause {
        self.started_by
    }

    fn activity(&self) -> Option<Activity> {
        (self.activity)()
    }
}

/// Marks the first instruction to be counted: `DBG #1`, which does nothing on silicon.
#[inline(always)]
#[cfg_attr(target_arch = "arm", allow(unsafe_code))]
pub fn region_begins() {
    // SAFETY: a hint without effect. It may touch memory as far as the compiler knows, so nothing moves across it.
    #[cfg(target_arch = "arm")]
    unsafe {
        core::arch::asm!("dbg #1", options(nostack, preserves_flags))
    };
}

/// Marks the last instruction to be counted: `DBG #2`.
#[inline(always)]
#[cfg_attr(target_arch = "arm", allow(unsafe_code))]
pub fn region_ends() {
    // SAFETY: as above.
    #[cfg(target_arch = "arm")]
    unsafe {
        core::arch::asm!("dbg #2", options(nostack, preserves_flags))
    };
}
