//! Errors of the link to a device.

use crate::network_file::NetworkFileError;
use ommatidia_shared::pipeline::PipelineError;
use ommatidia_shared::wire::{Refusal, SlotReport};
use std::path::PathBuf;
use thiserror::Error;

/// Errors of the link to a device: starting it, talking to it, and using its answers.
#[derive(Debug, Error)]
pub enum DeviceError {
    /// QEMU is not installed.
    #[error(
        "qemu-system-arm is not on the PATH; install it (Debian, Ubuntu: `apt-get install qemu-system-arm`; macOS: \
         `brew install qemu`), or run the firmware's logic on this computer with `--on host`"
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
        "no firmware image: {detail}; name one with `--firmware ELF`, or run the firmware's logic on this computer \
            with \
         `--on host`"
    )]
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
    #[error("{board} has no working camera; give the frames with `--frames STACK`")]
    NoCamera {
        /// The board.
        board: String,
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
    #[error("the device refuses: {0}")]
    Refused(Refusal),
    /// A network file or a frame is invalid.
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
