//! The program: it connects the parts of a board with the device that serves the host.

use crate::log;
use crate::start::Start;
use embedded_hal::digital::OutputPin;
use embedded_io::{Read, Write};
use half::f16;
use ommatidia_shared::device::{
    Arenas, Device, End, Footprint, FrameSource, Line, Monitor, RamObject, Watchdog, serve,
};
use ommatidia_shared::flash::MappedFlash;
use ommatidia_shared::wire::{Activity, Reply, Request, StartCause};

/// The parts of a board.
#[derive(Debug)]
pub struct Parts<'m, L, P, F, W, S> {
    /// Name of the board.
    pub name: &'static str,
    /// Serial line to the host.
    pub link: L,
    /// Buffers of the serial line.
    pub line: &'m mut Line,
    /// Pin or LED that is high while a reconstruction is computed.
    pub trigger: P,
    /// Resets the board when the program hangs.
    pub watchdog: W,
    /// How the program was started.
    pub start: Start,
    /// Clock of the core, MHz, where it is known.
    pub core_mhz: Option<u16>,
    /// Function that measures the memory that the program occupies.
    pub footprint: fn() -> Footprint,
    /// Function that reads the cycle counter of the core, where there is one. It wraps at 32 bits.
    pub cycles: fn() -> Option<u32>,
    /// Function that measures the temperature in hundredths of a degree Celsius, where there is a sensor.
    pub temperature_cdeg: fn() -> Option<i16>,
    /// Function that reports how long the core has run and slept, where there is a clock.
    pub activity: fn() -> Option<Activity>,
    /// Flash with the network files.
    pub flash: F,
    /// Source of raw frames.
    pub source: S,
    /// Buffer of the reconstruction, pixels.
    pub object: &'m mut [f16],
    /// Working memory of the pipeline.
    pub arenas: Arenas<'m>,
}

/// Serves the host until it asks the program to end or closes the line.
///
/// # Errors
/// Those of the serial line.
pub fn run<L: Read + Write, P: OutputPin, F: MappedFlash, W: Watchdog, S: FrameSource>(
    parts: Parts<'_, L, P, F, W, S>,
) -> Result<End, L::Error> {
    let Parts { name, mut link, line, trigger, mut watchdog, start, footprint, cycles, .. } = parts;
    let Parts { temperature_cdeg, activity, core_mhz, .. } = parts;
    watchdog.start();
    log::started(name, &start);
    let monitor =
        Board { trigger, watchdog, start, core_mhz, footprint, cycles, temperature_cdeg, activity, began: None };
    let (source, sink) = (parts.source, RamObject::new(parts.object));
    let end = serve(&mut link, line, &mut Device::new(name, parts.flash, source, sink, parts.arenas, monitor));
    log::ended();
    end
}

/// Trigger pin, watchdog, counters and instruction markers.
struct Board<P, W> {
    trigger: P,
    watchdog: W,
    start: Start,
    core_mhz: Option<u16>,
    footprint: fn() -> Footprint,
    cycles: fn() -> Option<u32>,
    temperature_cdeg: fn() -> Option<i16>,
    activity: fn() -> Option<Activity>,
    /// Cycle counter when the run began.
    began: Option<u32>,
}

impl<P: OutputPin, W: Watchdog> Monitor for Board<P, W> {
    fn alive(&mut self) {
        self.watchdog.feed();
    }

    fn run_begins(&mut self) {
        self.watchdog.feed();
        // The reconstruction does not need the trigger: a pin that fails is ignored.
        let _ = self.trigger.set_high();
        self.began = (self.cycles)();
        region_begins();
    }

    fn run_ends(&mut self) -> Option<u32> {
        region_ends();
        let cycles = (self.cycles)().zip(self.began).map(|(now, began)| now.wrapping_sub(began));
        let _ = self.trigger.set_low();
        self.watchdog.feed();
        (self.start.settled)();
        log::computed(cycles, self.core_mhz);
        cycles
    }

    fn answers(&mut self, request: &Request<'_>, reply: &Reply<'_>) {
        log::answered(request, reply);
    }

    fn footprint(&self) -> Footprint {
        (self.footprint)()
    }

    fn temperature_cdeg(&mut self) -> Option<i16> {
        (self.temperature_cdeg)()
    }

    fn start_cause(&self) -> StartCause {
        self.start.cause
    }

    fn starts(&self) -> u32 {
        self.start.count
    }

    fn core_mhz(&self) -> Option<u16> {
        self.core_mhz
    }

    fn keeps_faulting(&self) -> bool {
        self.start.keeps_faulting
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
