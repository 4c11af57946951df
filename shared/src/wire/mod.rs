//! The messages between host and device.
//!
//! The host sends a [`Request`], and the device answers with one [`Reply`] of the same sequence number. A packet is a
//! message in the encoding of postcard and its CRC-32, COBS-encoded between zero bytes ([`frame`]). A packet that the
//! line damages is dropped. The host repeats a request until it gets the reply. A repeated request does no harm: data
//! carry their offset, a run its number, and the device ignores requests that are older than the last one.
//!
//! ```
//! use ommatidia_shared::wire::frame::decode;
//! use ommatidia_shared::wire::{Deframer, MAX_PACKET, Packet, Request, Transfer, encode};
//!
//! let body = Request::Chunk { what: Transfer::Frame, offset: 4096, data: &[0, 1, 2, 3] };
//! let mut out = [0; MAX_PACKET];
//! let line = encode(&Packet { seq: 7, body }, &mut out).unwrap();
//! assert_eq!((line[0], line[line.len() - 1]), (0, 0), "a zero on either side, and none between");
//!
//! let mut deframer = Deframer::<MAX_PACKET>::new();
//! let mut received = 0;
//! for &byte in line {
//!     if let Some(packet) = deframer.push(byte).unwrap() {
//!         assert_eq!(decode(packet), Ok(Packet { seq: 7, body }));
//!         received += 1;
//!     }
//! }
//! assert_eq!(received, 1);
//! ```

mod camera;
mod cobs;
pub mod frame;
mod message;
mod pack;
mod refusal;
mod transfer;

pub use camera::{
    CameraChange, CameraLimits, CameraSettings, CameraStatus, Capture, Limits, SensorRegion, Setting, SettingError,
    Trigger,
};
pub use frame::{Deframer, FrameError, checksum, encode};
pub use message::{
    Activity, CHUNK, FrameFrom, Info, MAX_PACKET, Packet, Reply, Request, RunReport, SCHEMA_KEY, SlotReport,
    StartCause, Telemetry, VERSION,
};
pub use pack::{Unpacker, pack};
pub use refusal::Refusal;
pub use transfer::Transfer;
