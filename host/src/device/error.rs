//! Why the device did not give reconstructions.

use crate::network_file::NetworkFileError;
use ommatidia_shared::pipeline::PipelineError;
use ommatidia_shared::wire::{Refusal, SlotReport};
use std::path::PathBuf;
use thiserror::Error;

/// Why the device did not give reconstructions.
#[derive(Debug, Error)]
pub enum DeviceError {
    /// QEMU is not there.
    #[error(
        "qemu-system-arm is not on the PATH; install it (Debian, Ubuntu: `apt-get install qemu-system-arm`; macOS: `brew install qemu`), or run the firmware's logic on this machine with `--on host`"
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
    #[error(
        "no firmware image: {detail}; name one with `--firmware ELF`, or run the firmware's logic here with `--on host`"
    )]
    NoFirmware {
        /// What was tried.
        detail: String,
    },
    /// The firmware does not build.
    #[error("the firmware does not build:\n{log}")]
    FirmwareBuild {
        /// The end of the compiler's messages.
        log: String,
    },
    /// The emulator ended.
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
    /// The board behind a serial port has gone.
    #[error(
        "{port}: the board is gone ({source}). What was on its way is lost: an upload, or the reconstructions of `device run`; what `device stream` recorded and the network in its flash stay. Plug it in and start again"
    )]
    Unplugged {
        /// The port.
        port: String,
        /// What the system said.
        source: std::io::Error,
    },
    /// The line failed.
    #[error("the line to the device failed: {0}")]
    Line(#[from] std::io::Error),
    /// No answer.
    #[error("the device does not answer `{request}`: asked {attempts} times; check the line and the firmware")]
    Silent {
        /// What was asked.
        request: String,
        /// How often.
        attempts: u32,
    },
    /// Frames were to come from a camera.
    #[error("{board} has no camera that answers; give the frames with `--frames STACK`")]
    NoCamera {
        /// The board.
        board: String,
    },
    /// An answer to something else.
    #[error("the device answered `{request}` with something else: {found}")]
    Unexpected {
        /// What was asked.
        request: String,
        /// What came.
        found: String,
    },
    /// Bytes changed on the way in spite of the checksums of their packets.
    #[error("{what} {id}: expected CRC {expected:08x}, found {found:08x}; it is not used")]
    Damaged {
        /// Frame or reconstruction.
        what: &'static str,
        /// Its number.
        id: u32,
        /// Checksum at the end that it comes from.
        expected: u32,
        /// Checksum at the other end.
        found: u32,
    },
    /// The network that runs is not the one that was sent.
    #[error("the device runs {found:?} after the network was committed; send it again")]
    NotCommitted {
        /// The slot that runs.
        found: Option<SlotReport>,
    },
    /// The device refuses.
    #[error("the device refuses: {0}")]
    Refused(Refusal),
    /// A file or a frame is no good.
    #[error(transparent)]
    Blob(#[from] NetworkFileError),
    /// The pipeline refuses on this machine.
    #[error("{0}")]
    Pipeline(PipelineError),
    /// The instruction counter could not be set up.
    #[error("{path}: the instruction counter cannot be built or read: {detail}")]
    Counter {
        /// The plugin or its output.
        path: PathBuf,
        /// What is wrong.
        detail: String,
    },
}
