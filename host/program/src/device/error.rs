//! Errors of the link to a device.

use ommatidia_network::network_file::NetworkFileError;
use ommatidia_session::remedy;
use ommatidia_shared::pipeline::PipelineError;
use ommatidia_shared::wire::{CameraSettings, Refusal, SlotReport};
use std::path::{Path, PathBuf};
use thiserror::Error;

/// Errors of the link to a device: starting it, talking to it, and using its answers.
#[derive(Debug, Error)]
pub enum DeviceError {
    /// QEMU is not installed.
    #[error(
        "qemu-system-arm is not on the PATH; install it (Debian, Ubuntu: `apt-get install qemu-system-arm`; macOS: \
         `brew install qemu`)"
    )]
    NoQemu,
    /// A program could not be started.
    #[error("{program}: cannot be started ({source})")]
    Start {
        /// The program.
        program: String,
        /// What the system said.
        source: std::io::Error,
    },
    /// There is no firmware image.
    #[error("no firmware image: {detail}")]
    NoFirmware {
        /// Where it was searched.
        detail: String,
    },
    /// The firmware does not build.
    #[error("the firmware does not build:\n{log}")]
    FirmwareBuild {
        /// The end of the compiler's messages.
        log: String,
    },
    /// The emulator stopped.
    #[error("the emulated board stopped ({status}): {output}")]
    Stopped {
        /// How it ended.
        status: String,
        /// What it printed.
        output: String,
    },
    /// The serial port cannot be opened.
    #[error("{port}: the serial port cannot be opened ({source}); {advice}")]
    Port {
        /// The port.
        port: String,
        /// What the system said.
        source: serialport::Error,
        /// What to do.
        advice: &'static str,
    },
    /// The board on a serial port was unplugged.
    #[error(
        "{port}: the board was unplugged ({source}). A running upload and the reconstructions of `device run` are \
            lost; \
         recordings of `device stream` and the network in its flash are kept. Plug it in and start again"
    )]
    Unplugged {
        /// The port.
        port: String,
        /// What the system said.
        source: std::io::Error,
    },
    /// The connection failed.
    #[error("the connection to the device failed: {0}")]
    Line(#[from] std::io::Error),
    /// The device does not answer.
    #[error("the device does not answer `{request}` after {attempts} attempts; check the cable and the firmware")]
    Silent {
        /// The request.
        request: String,
        /// Number of attempts.
        attempts: u32,
    },
    /// The board has no camera.
    #[error("the device has no working camera ({board}); give the frames with `--frames STACK`")]
    NoCamera {
        /// The board.
        board: String,
    },
    /// The camera is set to another frame than that of the network.
    #[error(
        "the camera gives frames of {rows} x {cols} pixels (rows x columns), the network is for {} x {}; set the \
         region with `--sensor-region`", .network[0], .network[1]
    )]
    CameraRegion {
        /// Rows of the camera's frames.
        rows: u16,
        /// Columns of the camera's frames.
        cols: u16,
        /// Rows and columns of the network's frames.
        network: [u16; 2],
    },
    /// The camera has other settings than those in force when the stream began.
    #[error(
        "the settings of the camera have changed during the stream: {found:?} in place of {expected:?}; start again"
    )]
    OtherSettings {
        /// Settings at the start.
        expected: CameraSettings,
        /// Settings now.
        found: CameraSettings,
    },
    /// No pulse has come to the trigger input of the board.
    #[error(
        "no pulse came to the trigger input for {seconds} s; check its wire, or let the device start exposures with \
         `--trigger device`"
    )]
    NoTrigger {
        /// Time waited, s.
        seconds: u64,
    },
    /// A reply of the wrong kind.
    #[error("unexpected reply of the device to `{request}`: {found}")]
    Unexpected {
        /// The request.
        request: String,
        /// The reply.
        found: String,
    },
    /// Bytes changed on the way in spite of the checksums of their packets.
    #[error("{what} {id}: expected CRC {expected:08x}, found {found:08x}; it is discarded")]
    Damaged {
        /// Frame or reconstruction.
        what: &'static str,
        /// Its number.
        id: u32,
        /// Checksum at the sender.
        expected: u32,
        /// Checksum at the receiver.
        found: u32,
    },
    /// The network that runs is not the one that was sent.
    #[error("after the commit the device still runs {found:?}; send the network again")]
    NotCommitted {
        /// The slot that runs.
        found: Option<SlotReport>,
    },
    /// The device refused a request.
    #[error("the device refuses: {0}{more}", more = advice(.0))]
    Refused(Refusal),
    /// A network file or a frame is invalid.
    #[error(transparent)]
    Blob(#[from] NetworkFileError),
    /// The pipeline refuses on this machine.
    #[error("{0}")]
    Pipeline(PipelineError),
    /// The file with the flash of a device cannot be used.
    #[error(
        "{path}: the flash of the device cannot be kept in this file ({source}), nothing is kept; {}, or name another \
         file with `--state`",
        remedy(.source)
    )]
    State {
        /// The file.
        path: PathBuf,
        /// What the system said.
        source: std::io::Error,
    },
    /// The emulator takes no plugin that counts instructions.
    #[error("{emulator} counts no instructions: {detail}")]
    Uncountable {
        /// The emulator and its version.
        emulator: String,
        /// What it says.
        detail: String,
    },
    /// The instruction counter could not be built, or its counts cannot be read.
    #[error("instructions cannot be counted: {detail}")]
    Counter {
        /// What is wrong.
        detail: String,
    },
}

/// What to do about a refusal, where the text does not say it.
fn advice(refusal: &Refusal) -> String {
    use ommatidia_shared::wire::Transfer;
    match refusal {
        Refusal::NoRoom { what: Transfer::Blob, available, .. } => {
            format!(" in a slot of its flash; `ommatidia quantize --flash {available}` makes a network that fits")
        }
        Refusal::NoRoom { what: Transfer::Frame, .. } => " for a frame; the board is too small for this sensor".into(),
        _ => String::new(),
    }
}

impl DeviceError {
    /// The file `path` with the flash of a device cannot be used.
    pub(super) fn state(path: &Path, source: std::io::Error) -> Self {
        Self::State { path: path.into(), source }
    }
}
