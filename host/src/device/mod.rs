//! The firmware, from the workstation: under QEMU over its serial line, or its logic in this process.
//!
//! [`run`] sends a network and frames and gets reconstructions back; [`Client`] is the host's end of the conversation in
//! [`ommatidia_shared::wire`], over any [`Transport`].

mod client;
mod count;
mod counter;
mod error;
pub mod faults;
mod faulty;
mod firmware;
mod flash;
mod footprint;
mod loopback;
mod qemu;
pub mod rates;
mod run;
mod runtime;
mod scope;
mod serial;
mod stream;
pub mod table;
mod transport;
mod view;

pub use client::{Client, Patience};
pub use count::{BoardCounts, OperatorCount, count_board};
pub use counter::Counter;
pub use error::DeviceError;
pub use faulty::{Faults, Faulty};
pub use firmware::Firmware;
pub use flash::{FlashReport, flash, status, upload};
pub use footprint::{Footprint, footprint};
pub use loopback::{Loopback, LoopbackConfig, camera_frame};
pub use qemu::{Qemu, find_qemu};
pub use run::{DeviceRun, Work, reference, run};
pub use runtime::{Running, Runtime, Wanted};
pub use scope::{Deviation, Scope};
pub use serial::{BAUD, Serial};
pub use stream::{FrameFeed, Frames, StreamReport, StreamedFrame, stream};
pub use transport::Transport;
pub use view::View;
