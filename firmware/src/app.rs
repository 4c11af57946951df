//! The program: the parts of a board, and the conversation with the host.

use crate::log::info;
use embedded_hal::digital::OutputPin;
use embedded_io::{Read, Write};
use half::f16;
use ommatidia_shared::device::{Arenas, Device, End, Footprint, Line, Monitor, RamFrame, RamObject, RamStore, serve};

/// The parts of a board.
#[derive(Debug)]
pub struct Parts<'m, L, P> {
    /// Name that the host prints.
    pub name: &'static str,
    /// Serial line to the host.
    pub link: L,
    /// Buffers of the line.
    pub line: &'m mut Line,
    /// Pin or LED that is high while a reconstruction is computed.
    pub trigger: P,
    /// What the program takes of the memory.
    pub footprint: fn() -> Footprint,
    /// Where the network file goes; begins at a multiple of [`ommatidia_shared::blob::ALIGN`].
    pub blob: &'m mut [u8],
    /// Where the raw frame goes.
    pub frame: &'m mut [u16],
    /// Where the reconstruction goes.
    pub object: &'m mut [f16],
    /// Working memory.
    pub arenas: Arenas<'m>,
}

/// Serves the host until it asks the program to end.
///
/// # Errors
/// Those of the line.
pub fn run<L: Read + Write, P: OutputPin>(parts: Parts<'_, L, P>) -> Result<End, L::Error> {
    let Parts { name, mut link, line, trigger, footprint, blob, frame, object, arenas } = parts;
    info!("{} is listening", name);
    let monitor = Pins { trigger, footprint };
    let (store, source, sink) = (RamStore::new(blob), RamFrame::new(frame), RamObject::new(object));
    let end = serve(&mut link, line, &mut Device::new(name, store, source, sink, arenas, monitor));
    info!("the host has left");
    end
}

/// Trigger pin and instruction markers.
struct Pins<P> {
    trigger: P,
    footprint: fn() -> Footprint,
}

impl<P: OutputPin> Monitor for Pins<P> {
    fn run_begins(&mut self) {
        info!("run");
        // A pin that fails costs the trigger, not the reconstruction.
        let _ = self.trigger.set_high();
        region_begins();
    }

    fn run_ends(&mut self) {
        region_ends();
        let _ = self.trigger.set_low();
        info!("done");
    }

    fn footprint(&self) -> Footprint {
        (self.footprint)()
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
