//! What runs the device's program, and the choice of it.

use super::{Counter, DeviceError, Firmware, Loopback, LoopbackConfig, Qemu, Serial, Transport, find_qemu};
use ommatidia_shared::boards::Board;
use std::path::Path;
use std::time::Duration;

/// What runs the device's program.
#[derive(Clone, Debug)]
pub enum Runtime {
    /// QEMU runs the firmware.
    Qemu(Firmware),
    /// This process runs the firmware's logic.
    Host(LoopbackConfig),
    /// A board behind a serial port.
    Serial {
        /// The port.
        port: String,
        /// Bits a second.
        baud: u32,
    },
}

/// What the user wants it to run on.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Wanted {
    /// QEMU, or an error.
    Qemu,
    /// This process.
    Host,
    /// QEMU where it and the firmware can be had, else this process.
    Best,
}

impl Runtime {
    /// What was wanted, and why it is not QEMU where that was only the second choice. Builds the firmware unless `image` names it.
    ///
    /// # Errors
    /// QEMU or the firmware was asked for and is not there, or the firmware does not build.
    pub fn choose(board: Board, wanted: Wanted, image: Option<&Path>) -> Result<(Self, Option<String>), DeviceError> {
        let here = Self::Host(LoopbackConfig::default());
        if wanted == Wanted::Host {
            return Ok((here, None));
        }
        let found = match find_qemu() {
            None => Err(DeviceError::NoQemu),
            Some(_) => match image {
                Some(image) => Firmware::given(board, image),
                None => Firmware::build(board, "app"),
            },
        };
        match found {
            Ok(firmware) => Ok((Self::Qemu(firmware), None)),
            Err(why @ (DeviceError::NoQemu | DeviceError::NoFirmware { .. }))
                if wanted == Wanted::Best && image.is_none() =>
            {
                Ok((here, Some(why.to_string())))
            }
            Err(why) => Err(why),
        }
    }

    /// Starts the device. Its flash is kept in the file `state`; without one it is empty at the start and lost at the end.
    ///
    /// # Errors
    /// It cannot be started.
    pub fn start(&self, counter: Option<&Counter>, state: Option<&Path>) -> Result<Running, DeviceError> {
        match self {
            Self::Qemu(firmware) => Qemu::start(firmware, counter, state).map(Running::Qemu),
            Self::Serial { port, baud } => Serial::open(port, *baud).map(Running::Serial),
            Self::Host(config) => Loopback::start_on(*config, state.map(Path::to_path_buf)).map(Running::Host),
        }
    }
}

/// A device that runs, and the line to it.
#[derive(Debug)]
pub enum Running {
    /// An emulated board.
    Qemu(Qemu),
    /// This process.
    Host(Loopback),
    /// A board.
    Serial(Serial),
}

impl Running {
    /// Waits for a program that was asked to end.
    ///
    /// # Errors
    /// It does not end, or ends with a failure.
    pub fn wait(self) -> Result<(), DeviceError> {
        match self {
            Self::Qemu(qemu) => qemu.wait(),
            Self::Host(_) | Self::Serial(_) => Ok(()),
        }
    }
}

impl Transport for Running {
    fn send(&mut self, bytes: &[u8]) -> Result<(), DeviceError> {
        match self {
            Self::Qemu(line) => line.send(bytes),
            Self::Host(line) => line.send(bytes),
            Self::Serial(line) => line.send(bytes),
        }
    }

    fn receive(&mut self, buffer: &mut [u8], patience: Duration) -> Result<usize, DeviceError> {
        match self {
            Self::Qemu(line) => line.receive(buffer, patience),
            Self::Host(line) => line.receive(buffer, patience),
            Self::Serial(line) => line.receive(buffer, patience),
        }
    }

    fn answer_len(&self) -> usize {
        match self {
            Self::Qemu(line) => line.answer_len(),
            Self::Host(line) => line.answer_len(),
            Self::Serial(line) => line.answer_len(),
        }
    }

    fn ends(&self) -> bool {
        match self {
            Self::Qemu(line) => line.ends(),
            Self::Host(line) => line.ends(),
            Self::Serial(line) => line.ends(),
        }
    }
}
