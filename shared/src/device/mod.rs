//! The device's program without its board: how it handles each request of the host.
//!
//! It is here and not in the firmware so that the workstation can run the same program where there is neither board nor
//! emulator. [`Device`] is the state machine, and [`serve`] connects it to a line. A board implements the traits:
//! [`FrameSource`] and [`Camera`] for its frames, [`FrameSink`] for the reconstruction, [`Monitor`] for pins and
//! counters, [`Watchdog`], and [`crate::flash::MappedFlash`] for its flash.

mod interlock;
mod io;
mod machine;
mod refuse;
mod serve;
mod shutter;
mod steps;
mod upload;
mod virtual_camera;

#[cfg(test)]
mod tests;

pub use interlock::Interlock;
pub use io::{Camera, Footprint, FrameSink, FrameSource, IoError, Monitor, RamFrame, RamObject, Silent, Watchdog};
pub use machine::{Arenas, Device};
pub use serve::{End, Line, Step, serve};
pub use steps::{Steps, check};
pub use virtual_camera::{Clock, PULSES_US, Response, VirtualCamera};
