//! The messages.

use super::camera::{CameraChange, CameraStatus, Capture};
use super::refusal::Refusal;
use super::transfer::Transfer;
use crate::flash::{Mark, Slot};
use crate::image::Region;
use crate::watch;
use heapless::String;
use postcard_schema::Schema;
use postcard_schema::key::Key;
use serde::{Deserialize, Serialize};

/// Version of the conversation. It changes with everything that the schema key does not cover.
pub const VERSION: u16 = 4;
/// Hash of every name and type in the messages: it changes when one of them does.
pub const SCHEMA_KEY: u64 = u64::from_le_bytes(
    Key::for_path::<(Packet<Request<'static>>, Packet<Reply<'static>>)>("ommatidia/wire").to_bytes(),
);
/// Largest number of data bytes in one message.
pub const CHUNK: usize = 2048;
/// Largest number of bytes of a packet on the line, delimiters included: the data, up to 96 bytes of message and CRC
/// around them, and the overhead of COBS.
pub const MAX_PACKET: usize = CHUNK + 96 + (CHUNK + 96) / 254 + 3;

/// A message and its sequence number.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, Schema)]
pub struct Packet<T> {
    /// Number of the request, which the host counts up. A reply has the number of its request.
    pub seq: u16,
    /// The message.
    pub body: T,
}

/// A request of the host.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, Schema)]
pub enum Request<'a> {
    /// Begins a conversation, whose first sequence number is that of this packet. The device answers with [`Info`]. It
    /// refuses everything else until it was greeted once ([`Refusal::NoHello`]).
    Hello {
        /// [`VERSION`] of the host.
        version: u16,
        /// [`SCHEMA_KEY`] of the host.
        schema: u64,
    },
    /// Begins a transfer to the device. An earlier transfer of the same kind is discarded. The active network stays
    /// active.
    Begin {
        /// What is transferred.
        what: Transfer,
        /// Length of the transfer, bytes.
        len: u32,
    },
    /// The next bytes of a transfer.
    Chunk {
        /// Which transfer they belong to.
        what: Transfer,
        /// Offset from the beginning of the transfer, bytes.
        offset: u32,
        /// At most [`CHUNK`] bytes.
        data: &'a [u8],
    },
    /// The next pixels of a frame, packed by [`pack`](super::pack).
    Packed {
        /// Offset of the first pixel from the beginning of the transfer, bytes.
        offset: u32,
        /// Number of pixels.
        pixels: u16,
        /// At most [`CHUNK`] bytes.
        data: &'a [u8],
    },
    /// The network file is complete: the device is to check it and to make it the active one, now and after every
    /// start.
    Commit,
    /// Reconstructs a frame.
    Run {
        /// Number of the run, which the host chooses. The device runs a request of the same number, source, region and
        /// hold on the same frame only once.
        id: u32,
        /// Which frame.
        frame: FrameFrom,
        /// Region to reconstruct; the whole object where there is none.
        region: Option<Region>,
        /// Largest age of the statistics of the field that the run may take from an earlier run, in runs. With 0 the
        /// run measures them in its own frame, and every bit of the region is that of the whole. So it does where the
        /// device holds none that are young enough.
        hold: u16,
    },
    /// Requests bytes of the reconstruction: little-endian halves, row by row.
    Read {
        /// Number of the run.
        id: u32,
        /// First byte.
        offset: u32,
        /// Number of bytes, at most [`CHUNK`].
        len: u16,
    },
    /// Changes settings of the camera; with none to change, asks for them. The device answers with the settings in
    /// force ([`CameraStatus`]), which are the nearest that the sensor has.
    Camera(CameraChange),
    /// Requests the telemetry of the device.
    Telemetry,
    /// Asks the program to end, on a board where it can.
    Quit,
}

/// Where the frame of a run comes from.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, Schema)]
pub enum FrameFrom {
    /// The host has sent it.
    Host,
    /// The camera exposes it now.
    Camera,
}

/// A reply of the device.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, Schema)]
pub enum Reply<'a> {
    /// The device, in answer to [`Request::Hello`].
    Hello(Info),
    /// The request was carried out.
    Done,
    /// All bytes of the transfer before this offset have arrived.
    Received {
        /// Bytes from the beginning of the transfer.
        offset: u32,
    },
    /// The frame was reconstructed.
    Ran(RunReport),
    /// Bytes of the reconstruction.
    Data {
        /// First byte.
        offset: u32,
        /// The bytes.
        data: &'a [u8],
    },
    /// The camera and its settings.
    Camera(CameraStatus),
    /// Telemetry of the device.
    Telemetry(Telemetry),
    /// The request was refused, and why.
    Refused(Refusal),
}

/// The device and its capacities.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, Schema)]
pub struct Info {
    /// [`VERSION`] of the device.
    pub version: u16,
    /// [`SCHEMA_KEY`] of the device.
    pub schema: u64,
    /// Name of the board.
    pub board: String<24>,
    /// Largest network file, bytes.
    pub blob_bytes: u32,
    /// Largest raw frame, pixels.
    pub frame_px: u32,
    /// Largest reconstruction, pixels.
    pub object_px: u32,
    /// Fast memory, bytes.
    pub fast_bytes: u32,
    /// Bulk memory, bytes.
    pub bulk_bytes: u32,
    /// Whether the device has a camera, so that the host need not send frames.
    pub live: bool,
}

/// The report of a run; compare [`crate::pipeline::Stats`].
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, Schema)]
pub struct RunReport {
    /// Number of the run.
    pub id: u32,
    /// Region that was reconstructed.
    pub region: Region,
    /// Number of the run that measured the statistics of the field: see [`crate::pipeline::Field`].
    pub field_id: u32,
    /// Age of these statistics, in runs. 0: measured in this run, so the reconstruction is exact. Otherwise it is
    /// approximate.
    pub field_age: u16,
    /// Length of the reconstruction, bytes.
    pub len: u32,
    /// Pixels of the raw frame at or above the saturation code.
    pub saturated_px: u32,
    /// Maximum of the corrected frame, DN.
    pub frame_max_dn: f32,
    /// Whether every output of the filters was finite as a half.
    pub filter_finite: bool,
    /// CRC-32 of the raw frame that was reconstructed.
    pub frame_crc: u32,
    /// CRC-32 of the reconstruction.
    pub object_crc: u32,
    /// How the frame was taken, where it is one of the camera.
    pub capture: Option<Capture>,
    /// What the watch on the optics has seen so far.
    pub watch: watch::Report,
}

/// Why the program of the device was started.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, Schema)]
pub enum StartCause {
    /// Power was switched on, or the board was reset from outside.
    #[default]
    Power,
    /// The watchdog reset the board, as the program had hung.
    Watchdog,
    /// A fault of the core or a panic reset the board. After three such starts in a row no network runs until another
    /// one is sent.
    Fault,
}

/// How long the core has run and slept.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, Schema)]
pub struct Activity {
    /// Time since the start, ms.
    pub total_ms: u32,
    /// Of this, time asleep until a byte came, ms.
    pub asleep_ms: u32,
}

/// A slot that holds a committed network file.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, Schema)]
pub struct SlotReport {
    /// The slot.
    pub slot: Slot,
    /// Its commit mark.
    pub mark: Mark,
    /// Whether this slot is the active one.
    pub runs: bool,
}

/// Counters and measurements of the device.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize, Schema)]
pub struct Telemetry {
    /// Number of starts since the power came on, this one included.
    pub starts: u32,
    /// Cause of this start.
    pub started_by: StartCause,
    /// Slots with a committed network file, the newest first.
    pub slots: [Option<SlotReport>; 2],
    /// Number of slots that were refused at this start because their file is damaged or has another version. If one of
    /// them is the newer slot, an older network is active.
    pub refused_slots: u8,
    /// Name of the active network; empty without one.
    pub network: String<48>,
    /// Number of runs since the start.
    pub runs: u32,
    /// Of these, runs that took the statistics of the field from an earlier run.
    pub held_runs: u32,
    /// How long the core has run and slept, where there is a clock.
    pub activity: Option<Activity>,
    /// Cycles of the core during the last run, where they are counted.
    pub cycles: Option<u32>,
    /// Saturated pixels of all runs since the start.
    pub saturated_px: u64,
    /// Number of frames since the start that the host began to send and that were not reconstructed.
    pub dropped_frames: u32,
    /// Temperature in hundredths of a degree Celsius, where there is a sensor.
    pub temperature_cdeg: Option<i16>,
    /// Number of packets since the start with a wrong checksum.
    pub crc_errors: u32,
    /// Number of packets since the start that were damaged or held no request, those with a wrong checksum included.
    pub dropped_packets: u32,
    /// Number of requests since the start that had been answered before.
    pub repeated_requests: u32,
    /// Fast scratch of the last run, bytes.
    pub fast_bytes: u32,
    /// Bulk arena of the last run, bytes.
    pub bulk_bytes: u32,
    /// Raw frame of the last run, bytes.
    pub frame_bytes: u32,
    /// Reconstruction of the last run, bytes.
    pub object_bytes: u32,
    /// Code and constants of the program, bytes; 0 on the workstation.
    pub image_bytes: u32,
    /// Static variables of the program without the buffers for frame, reconstruction and arenas, bytes; 0 on the
    /// workstation.
    pub static_bytes: u32,
    /// Largest depth of the stack since the start, bytes; 0 on the workstation.
    pub stack_bytes: u32,
    /// Clock of the core, MHz, where it is known.
    pub core_mhz: Option<u16>,
    /// What the watch on the optics has seen since the network was sent, or since the start.
    pub watch: watch::Report,
}
