//! Where the device's program runs: QEMU, this process, or a board.

use super::counter::Counter;
use super::emulator::find_qemu;
use super::error::DeviceError;
use super::firmware::Firmware;
use super::loopback::{Loopback, LoopbackConfig};
use super::qemu::Qemu;
use super::serial::Serial;
use super::transport::Transport;
use ommatidia_shared::boards::Board;
use std::path::Path;
use std::time::Duration;

/// Where the device's program runs.
#[derive(Clone, Debug)]
pub enum Runtime {
    /// QEMU runs the firmware.
    Qemu(Firmware),
    /// This process runs the firmware's logic.
    Host(LoopbackConfig),
    /// A board on a serial port.
    Serial {
        /// The port.
        port: String,
        /// Bits a second.
        baud: u32,
    },
}

/// Where a program ran: figures of the computer's own run are no figures of a device.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Place {
    /// A board on a serial port.
    Board,
    /// A board that QEMU emulates.
    Emulator,
    /// This computer: the firmware's logic, compiled for it. No device took part.
    Host,
}

impl Place {
    /// As it is written in JSON.
    pub fn name(self) -> &'static str {
        match self {
            Self::Board => "board",
            Self::Emulator => "emulator",
            Self::Host => "host",
        }
    }

    /// The board for people, where a device reports the name `board`.
    pub fn board(self, board: &str) -> String {
        match self {
            Self::Board => board.into(),
            Self::Emulator => format!("{board}, emulated"),
            Self::Host => "none: the firmware's logic ran on this computer".into(),
        }
    }
}

/// Where the user wants the program to run.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum RuntimeChoice {
    /// QEMU, or an error.
    Qemu,
    /// This process.
    Host,
    /// QEMU if it and the firmware are available, else this process.
    Best,
}

impl Runtime {
    /// Chooses the runtime. Builds the firmware unless `image` names one. The second value gives the reason if
    /// [`RuntimeChoice::Best`] had to fall back to this process.
    ///
    /// # Errors
    /// QEMU or the firmware was required and is missing, or the firmware does not build.
    pub fn choose(
        board: Board,
        wanted: RuntimeChoice,
        image: Option<&Path>,
    ) -> Result<(Self, Option<String>), DeviceError> {
        let here = Self::Host(LoopbackConfig::default());
        if wanted == RuntimeChoice::Host {
            return Ok((here, None));
        }
        let given = image.map(|image| Firmware::given(board, image)).transpose()?;
        let found = match (find_qemu(), given) {
            (None, _) => Err(DeviceError::NoQemu),
            (Some(_), Some(image)) => Ok(image),
            (Some(_), None) => Firmware::build(board, "app"),
        };
        match found {
            Ok(firmware) => Ok((Self::Qemu(firmware), None)),
            Err(why @ (DeviceError::NoQemu | DeviceError::NoFirmware { .. }))
                if wanted == RuntimeChoice::Best && image.is_none() =>
            {
                Ok((here, Some(why.to_string())))
            }
            Err(why) => Err(why),
        }
    }

    /// Where the program runs.
    pub fn place(&self) -> Place {
        match self {
            Self::Qemu(_) => Place::Emulator,
            Self::Host(_) => Place::Host,
            Self::Serial { .. } => Place::Board,
        }
    }

    /// Starts the device. Its flash is kept in the file `state`; without one it is empty at the start and lost at the
    /// end.
    ///
    /// # Errors
    /// It cannot be started.
    pub fn start(&self, counter: Option<&Counter>, state: Option<&Path>) -> Result<DeviceLine, DeviceError> {
        match self {
            Self::Qemu(firmware) => Qemu::start(firmware, counter, state).map(DeviceLine::Qemu),
            Self::Serial { port, baud } => Serial::open(port, *baud).map(DeviceLine::Serial),
            Self::Host(config) => Loopback::start_on(*config, state.map(Path::to_path_buf)).map(DeviceLine::Host),
        }
    }
}

/// A running device and the line to it.
#[derive(Debug)]
pub enum DeviceLine {
    /// An emulated board.
    Qemu(Qemu),
    /// This process.
    Host(Loopback),
    /// A board.
    Serial(Serial),
}

impl DeviceLine {
    /// Waits for a program that was asked to end, and for its flash to be in its file.
    ///
    /// # Errors
    /// It does not end, or ends with a failure; or the flash cannot be written to its file.
    pub fn wait(self) -> Result<(), DeviceError> {
        match self {
            Self::Qemu(qemu) => qemu.wait(),
            Self::Host(line) => line.finish(),
            Self::Serial(_) => Ok(()),
        }
    }
}

impl Transport for DeviceLine {
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
