//! Commands and telemetry between host and device.
//!
//! The host asks, the device answers: one [`Request`], one [`Reply`] of the same sequence number. A packet is a
//! postcard message and its CRC-32, COBS-encoded between zero bytes ([`frame`]); whatever a line loses, repeats or
//! flips is dropped whole. The host asks again until it is answered. The device may do a thing twice without harm: data
//! carry their offset, a run its number, and requests older than the last are stale copies, which it ignores.

mod cobs;
pub mod frame;
mod message;

pub use frame::{Deframer, FrameError, checksum, encode};
pub use message::{
    Activity, CHUNK, Info, MAX_PACKET, Packet, Refusal, Reply, Request, RunReport, SCHEMA_KEY, SlotReport, StartCause,
    Telemetry, Transfer, VERSION,
};
