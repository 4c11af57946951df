//! The device's program, minus the board: what is done with each request of the host.
//!
//! It stands here and not in the firmware so that the workstation can run the very same program where there is neither
//! board nor emulator. [`Device`] is the state machine; [`serve`] connects it to a line; traits like [`FrameInput`] are where a
//! board puts its storage, its camera and its pins.

mod io;
mod machine;
mod serve;
mod upload;

pub use io::{Footprint, FrameInput, FrameSink, IoError, Monitor, RamFrame, RamObject, Silent, Watchdog};
pub use machine::{Arenas, Device};
pub use serve::{End, Line, Step, serve};
