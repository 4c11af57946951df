//! The device's program without its board: how it handles each request of the host.
//!
//! It is here and not in the firmware so that the workstation can run the same program where there is neither board nor
//! emulator. [`Device`] is the state machine, and [`serve`] connects it to a line. A board implements the traits:
//! [`FrameSource`] for its camera, [`FrameSink`] for the reconstruction, [`Monitor`] for pins and counters,
//! [`Watchdog`], and [`crate::flash::MappedFlash`] for its flash.

mod io;
mod machine;
mod serve;
mod upload;

pub use io::{Footprint, FrameSink, FrameSource, IoError, Monitor, RamFrame, RamObject, Silent, Watchdog};
pub use machine::{Arenas, Device};
pub use serve::{End, Line, Step, serve};
