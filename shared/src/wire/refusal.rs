//! Why a device refuses a request.

use super::camera::SettingError;
use super::transfer::Transfer;
use crate::blob::BlobError;
use core::fmt;
use heapless::String;
use postcard_schema::Schema;
use serde::{Deserialize, Serialize};

/// Why the device refused a request.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, Schema)]
pub enum Refusal {
    /// Host and device have different versions of the conversation.
    Version {
        /// Version of the device.
        expected: u16,
        /// Version of the host.
        found: u16,
    },
    /// The messages of host and device have different fields.
    Schema {
        /// Schema key of the device.
        expected: u64,
        /// Schema key of the host.
        found: u64,
    },
    /// A transfer does not fit.
    NoRoom {
        /// What was to be transferred.
        what: Transfer,
        /// Bytes needed.
        needed: u32,
        /// Bytes available.
        available: u32,
    },
    /// The reconstruction does not fit.
    ObjectRoom {
        /// Pixels of a reconstruction of this network.
        needed: u32,
        /// Pixels that fit.
        available: u32,
    },
    /// The bytes do not follow those that have arrived.
    OutOfOrder {
        /// Offset of the next bytes.
        expected: u32,
        /// Offset of the bytes that were sent.
        found: u32,
    },
    /// The bytes go past the end of the transfer, or of the reconstruction.
    PastEnd {
        /// Its length, bytes.
        len: u32,
        /// Offset of the end of these bytes.
        found: u64,
    },
    /// Packed pixels that end before their number is reached.
    Packed {
        /// Pixels that were announced.
        expected: u16,
        /// Pixels in the packet.
        found: u16,
    },
    /// The transfer has not begun or is not complete.
    Incomplete {
        /// Which transfer.
        what: Transfer,
        /// Length of the transfer, bytes.
        expected: u32,
        /// Bytes that have arrived.
        found: u32,
    },
    /// No network has been committed.
    NoNetwork,
    /// The network file was refused.
    Blob(BlobError),
    /// The frame has another length than the network needs.
    FrameLength {
        /// Bytes of a frame for this network.
        expected: u32,
        /// Bytes of the frame that arrived.
        found: u32,
    },
    /// There is no reconstruction of that number.
    NoResult {
        /// Number of the last run, if there was one.
        expected: Option<u32>,
        /// Number in the request.
        found: u32,
    },
    /// The pipeline refused; the text of its error.
    Pipeline(String<96>),
    /// No camera answers.
    NoCamera,
    /// The camera cannot have a setting.
    Setting(SettingError),
    /// The camera did not deliver a frame that was exposed. The excitation LED is dark.
    NoFrame {
        /// Time since the start of the exposure, ms.
        waited_ms: u32,
    },
    /// No pulse came to the trigger input. The excitation LED is dark.
    NoTrigger {
        /// Time waited, ms.
        waited_ms: u32,
    },
    /// The flash, a buffer or the camera of the device failed.
    Storage,
    /// The device has started anew since the host greeted it: its camera has other settings, and transfers are lost. It
    /// waits for [`Request::Hello`](super::Request::Hello).
    NoHello,
}

impl fmt::Display for Refusal {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Version { expected, found } => {
                write!(
                    f,
                    "it has version {expected} of the messages, this program version {found}; install matching firmware"
                )
            }
            Self::Schema { expected, found } => write!(
                f,
                "its messages have schema {expected:016x}, those of this program {found:016x}; install matching \
                 firmware"
            ),
            Self::NoRoom { what, needed, available } => {
                write!(f, "{what:?}: {needed} bytes needed, {available} available")
            }
            Self::ObjectRoom { needed, available } => {
                write!(f, "reconstruction: {needed} pixels needed, {available} available")
            }
            Self::OutOfOrder { expected, found } => {
                write!(f, "expected the bytes at offset {expected}, found those at {found}")
            }
            Self::PastEnd { len, found } => write!(f, "expected at most {len} bytes, found {found}"),
            Self::Packed { expected, found } => {
                write!(f, "packed pixels: expected {expected}, found {found}")
            }
            Self::Incomplete { what, expected, found } => {
                write!(f, "{what:?} is not complete: expected {expected} bytes, found {found}")
            }
            Self::NoNetwork => f.write_str("it has no network yet; send one first"),
            Self::Blob(error) => write!(f, "network file: {error}"),
            Self::FrameLength { expected, found } => {
                write!(f, "raw frame: expected {expected} bytes, found {found}")
            }
            Self::NoResult { expected, found } => {
                write!(f, "no reconstruction {found}; the last one is {expected:?}")
            }
            Self::Pipeline(text) => f.write_str(text),
            Self::NoCamera => f.write_str("it has no working camera"),
            Self::Setting(error) => write!(f, "camera: {error}"),
            Self::NoFrame { waited_ms } => {
                write!(
                    f,
                    "its camera delivered no frame within {waited_ms} ms; the LED is dark; check the sensor's cable"
                )
            }
            Self::NoTrigger { waited_ms } => {
                write!(f, "no pulse came to its trigger input within {waited_ms} ms; the LED is dark")
            }
            Self::Storage => f.write_str("its flash, a buffer or its camera failed"),
            Self::NoHello => {
                f.write_str("it was restarted; settings of its camera and what was being sent are lost; start again")
            }
        }
    }
}

impl core::error::Error for Refusal {}
