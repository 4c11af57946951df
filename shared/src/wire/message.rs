//! The messages.

use crate::blob::BlobError;
use crate::flash::{Mark, Slot};
use crate::image::Region;
use core::fmt;
use heapless::String;
use postcard_schema::Schema;
use postcard_schema::key::Key;
use serde::{Deserialize, Serialize};

/// Version of the conversation; it changes with whatever the schema key cannot see.
pub const VERSION: u16 = 3;
/// Changes with every name and type in the messages.
pub const SCHEMA_KEY: u64 = u64::from_le_bytes(
    Key::for_path::<(Packet<Request<'static>>, Packet<Reply<'static>>)>("ommatidia/wire").to_bytes(),
);
/// The most bytes of data in one message.
pub const CHUNK: usize = 2048;
/// The most bytes that a packet takes on the line, delimiters included: the data, up to 96 bytes of message and CRC
/// around them, and what COBS adds.
pub const MAX_PACKET: usize = CHUNK + 96 + (CHUNK + 96) / 254 + 3;

/// A message and its sequence number.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, Schema)]
pub struct Packet<T> {
    /// Counted up by the host with every new request; the reply carries the number of its request.
    pub seq: u16,
    /// The message.
    pub body: T,
}

/// What the host asks.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, Schema)]
pub enum Request<'a> {
    /// Who are you? Begins a conversation: its sequence number is the first.
    Hello {
        /// [`VERSION`] of the host.
        version: u16,
        /// [`SCHEMA_KEY`] of the host.
        schema: u64,
    },
    /// A transfer to the device begins; what came before it of the same kind is forgotten. A network that runs goes on running.
    Begin {
        /// What comes.
        what: Transfer,
        /// Its length, bytes.
        len: u32,
    },
    /// The next bytes of a transfer.
    Chunk {
        /// Of which.
        what: Transfer,
        /// Where they belong, bytes from its beginning.
        offset: u32,
        /// At most [`CHUNK`] bytes.
        data: &'a [u8],
    },
    /// The network file is complete: check it, mark it as what runs from now on, and after every start.
    Commit,
    /// Reconstruct the frame.
    Run {
        /// Number of the frame; a run of the same number, frame, region and hold is done once.
        id: u32,
        /// The region of the reconstruction that is wanted; all of it where there is none.
        region: Option<Region>,
        /// How many runs old the statistics of the field may be that the run takes; 0: its own, so that every bit is that of the whole. Where
        /// the device holds none so young, it measures them and is exact.
        hold: u16,
    },
    /// Bytes of the reconstruction: little-endian halves, row by row.
    Read {
        /// Number of the run.
        id: u32,
        /// First byte.
        offset: u32,
        /// How many, at most [`CHUNK`].
        len: u16,
    },
    /// Figures of the device.
    Telemetry,
    /// The program may end, where a program can.
    Quit,
}

/// What is transferred to the device.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, Schema)]
pub enum Transfer {
    /// The network file.
    Blob,
    /// A raw frame: little-endian 16-bit codes, row by row.
    Frame,
}

/// What the device answers.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, Schema)]
pub enum Reply<'a> {
    /// Who I am.
    Hello(Info),
    /// Done.
    Done,
    /// All bytes before this offset have arrived.
    Received {
        /// Bytes from the beginning of the transfer.
        offset: u32,
    },
    /// The frame is reconstructed.
    Ran(RunReport),
    /// Bytes of the reconstruction.
    Data {
        /// First byte.
        offset: u32,
        /// The bytes.
        data: &'a [u8],
    },
    /// Figures of the device.
    Telemetry(Telemetry),
    /// Not done, and why.
    Refused(Refusal),
}

/// Who the device is, and what it has.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, Schema)]
pub struct Info {
    /// [`VERSION`] of the device.
    pub version: u16,
    /// [`SCHEMA_KEY`] of the device.
    pub schema: u64,
    /// Name of the board.
    pub board: String<24>,
    /// Room for a network file, bytes.
    pub blob_bytes: u32,
    /// Room for a raw frame, pixels.
    pub frame_px: u32,
    /// Room for a reconstruction, pixels.
    pub object_px: u32,
    /// Fast memory, bytes.
    pub fast_bytes: u32,
    /// Bulk memory, bytes.
    pub bulk_bytes: u32,
    /// It has a camera: frames need not be sent.
    pub live: bool,
}

/// What a run saw: see [`crate::pipeline::Stats`].
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, Schema)]
pub struct RunReport {
    /// Number of the run.
    pub id: u32,
    /// What was reconstructed.
    pub region: Region,
    /// Number of the run that measured the statistics of the field: see [`crate::pipeline::Field`].
    pub field_id: u32,
    /// How many runs ago that was. 0: in this one, so the reconstruction is exact; else it is approximate.
    pub field_age: u16,
    /// Bytes of the reconstruction.
    pub len: u32,
    /// Pixels of the raw frame at or above the saturation code.
    pub saturated_px: u32,
    /// Maximum of the corrected frame, DN.
    pub frame_max_dn: f32,
    /// Whether every filter output stayed in the range of halves.
    pub filter_finite: bool,
    /// CRC-32 of the raw frame that was reconstructed.
    pub frame_crc: u32,
    /// CRC-32 of the reconstruction.
    pub object_crc: u32,
}

/// Why the device's program was started.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, Schema)]
pub enum StartCause {
    /// Power, or a reset from outside.
    #[default]
    Power,
    /// The watchdog: the program before had hung.
    Watchdog,
}

/// How the core spends its time.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, Schema)]
pub struct Activity {
    /// Since the start, ms.
    pub total_ms: u32,
    /// Of these, asleep until a byte came, ms.
    pub asleep_ms: u32,
}

/// A slot that holds a committed network file.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, Schema)]
pub struct SlotReport {
    /// Which one.
    pub slot: Slot,
    /// What its mark says.
    pub mark: Mark,
    /// Whether this is the network that runs.
    pub runs: bool,
}

/// Figures of the device.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize, Schema)]
pub struct Telemetry {
    /// Starts of the device, this one included; 0 where they cannot be counted.
    pub starts: u32,
    /// Why it was started.
    pub started_by: StartCause,
    /// Slots with a committed network file, the newest first.
    pub slots: [Option<SlotReport>; 2],
    /// Slots that were refused at the start: damaged, or of another version. Where one of them is newer, an older network runs.
    pub refused_slots: u8,
    /// Name of the network that runs; empty without one.
    pub network: String<48>,
    /// Runs since the start.
    pub runs: u32,
    /// Of these, runs that took statistics of the field which an earlier one had measured.
    pub held_runs: u32,
    /// How the core spends its time, where there is a clock.
    pub activity: Option<Activity>,
    /// Cycles of the last run, where the core counts them.
    pub cycles: Option<u32>,
    /// Saturated pixels of all runs since the start.
    pub saturated_px: u64,
    /// Frames since the start that were begun and never reconstructed.
    pub dropped_frames: u32,
    /// Temperature in hundredths of a degree Celsius, where there is a sensor.
    pub temperature_cdeg: Option<i16>,
    /// Packets since the start whose checksum was wrong.
    pub crc_errors: u32,
    /// Damaged or foreign packets since the start, those with a wrong checksum included.
    pub dropped_packets: u32,
    /// Requests since the start that had been answered before.
    pub repeated_requests: u32,
    /// Fast scratch that the last run worked with, bytes.
    pub fast_bytes: u32,
    /// Bulk arena that the last run worked with, bytes.
    pub bulk_bytes: u32,
    /// The raw frame of the last run, bytes.
    pub frame_bytes: u32,
    /// Its reconstruction, bytes.
    pub object_bytes: u32,
    /// Code and constants, bytes; 0 where the program runs on the workstation.
    pub image_bytes: u32,
    /// Variables, without the buffers for network, frame, reconstruction and arenas, bytes; 0 on the workstation.
    pub static_bytes: u32,
    /// The deepest that the stack has been, bytes; 0 on the workstation.
    pub stack_bytes: u32,
}

/// Why the device did not do what it was asked.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, Schema)]
pub enum Refusal {
    /// Host and device speak different versions.
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
    /// No room for so many bytes.
    NoRoom {
        /// What was to be transferred.
        what: Transfer,
        /// Bytes asked for.
        needed: u32,
        /// Bytes there are.
        available: u32,
    },
    /// No room for the reconstruction.
    ObjectRoom {
        /// Pixels of a reconstruction of this network.
        needed: u32,
        /// Pixels there is room for.
        available: u32,
    },
    /// The bytes do not follow those that have arrived.
    OutOfOrder {
        /// Where the next bytes belong.
        expected: u32,
        /// Where these belong.
        found: u32,
    },
    /// The bytes go past the end of what they belong to.
    PastEnd {
        /// Its length, bytes.
        len: u32,
        /// Where these bytes end.
        found: u64,
    },
    /// The transfer has not begun or is not complete.
    Incomplete {
        /// Of what.
        what: Transfer,
        /// Bytes that there should be.
        expected: u32,
        /// Bytes that there are.
        found: u32,
    },
    /// No network has been committed.
    NoNetwork,
    /// The network file is refused.
    Blob(BlobError),
    /// The frame has another length than the network takes.
    FrameLength {
        /// Bytes of a frame of this network.
        expected: u32,
        /// Bytes of the frame that arrived.
        found: u32,
    },
    /// There is no reconstruction of that number.
    NoResult {
        /// Number of the last run, if any.
        expected: Option<u32>,
        /// Number asked for.
        found: u32,
    },
    /// The pipeline refuses; in its words.
    Pipeline(String<96>),
    /// The device's storage failed.
    Storage,
}

impl fmt::Display for Refusal {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Version { expected, found } => {
                write!(f, "it speaks version {expected}, this program version {found}; put matching firmware on it")
            }
            Self::Schema { expected, found } => write!(
                f,
                "its messages have schema {expected:016x}, this program's {found:016x}; put matching firmware on it"
            ),
            Self::NoRoom { what, needed, available } => {
                write!(f, "{what:?}: {needed} bytes needed, room for {available}")
            }
            Self::ObjectRoom { needed, available } => {
                write!(f, "reconstruction: {needed} pixels needed, room for {available}")
            }
            Self::OutOfOrder { expected, found } => {
                write!(f, "expected the bytes at {expected}, found those at {found}")
            }
            Self::PastEnd { len, found } => write!(f, "expected at most {len} bytes, found {found}"),
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
            Self::Storage => f.write_str("its storage failed"),
        }
    }
}

impl core::error::Error for Refusal {}
