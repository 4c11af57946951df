//! The link from the host to a device: a board on a serial port, a board emulated by QEMU, or the firmware's logic in
//! this process ([`Runtime`]).
//!
//! [`run`] sends a network and frames and returns reconstructions; [`stream`] does so frame by frame; [`flash`] uploads
//! a network. [`Client`] is the host's end of the protocol [`ommatidia_shared::wire`], over any [`Transport`].

mod camera;
mod client;
mod count;
mod counter;
mod emulator;
mod error;
pub mod faults;
mod faulty_line;
mod firmware;
mod flash;
mod footprint;
mod live_view;
mod loopback;
mod qemu;
pub mod rates;
mod recording;
mod run;
mod runtime;
mod scope;
mod serial;
mod status;
mod stream;
pub mod table;
mod transport;
mod watch;

pub use camera::camera;
pub use client::{Client, RetryPolicy};
pub use count::{BoardCounts, OperatorCount, count_board};
pub use counter::Counter;
pub use emulator::{Emulator, find_qemu};
pub use error::DeviceError;
pub use faulty_line::{FaultyLine, LineFaults};
pub use firmware::Firmware;
pub use flash::{FlashReport, flash, upload};
pub use footprint::{Footprint, footprint};
pub use live_view::LiveView;
pub use loopback::{Loopback, LoopbackConfig};
pub use qemu::{Qemu, run_to_end};
pub use recording::{PageScale, StreamRecording};
pub use run::{DeviceRun, RunRequest, reference, run};
pub use runtime::{DeviceLine, Place, Runtime, RuntimeChoice};
pub use scope::{Deviation, Scope};
pub use serial::{BAUD, Serial};
pub use status::{active_fraction, status};
pub use stream::{FrameFeed, Frames, StreamReport, StreamedFrame, stream};
pub use transport::Transport;
pub use watch::{watch_json, watch_text};
