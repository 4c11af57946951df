//! Options that choose a device.

use crate::cli::common::Run;
use crate::cli::files::{Content, Files};
use crate::device::{BAUD, DeviceError, Runtime, RuntimeChoice};
use anyhow::anyhow;
use clap::ValueEnum;
use clap::builder::{PossibleValue, PossibleValuesParser, TypedValueParser};
use ommatidia_shared::boards::{BOARDS, Board, MPS2_AN500};
use std::io::Write;
use std::path::PathBuf;

/// Options that name a device.
#[derive(Debug, clap::Args)]
pub(super) struct Target {
    /// Board, by name
    #[arg(long, value_parser = boards(), default_value = MPS2_AN500.name)]
    board: Board,
    /// Firmware image for the board, ELF (default: build it)
    #[arg(long, value_name = "ELF")]
    firmware: Option<PathBuf>,
    /// Where the firmware runs
    #[arg(long, value_enum, default_value_t = On::Auto)]
    on: On,
    /// File with the flash of the emulated device, created if it is missing (default: an empty flash that is discarded
    /// at the end)
    #[arg(long, value_name = "FILE")]
    pub(super) state: Option<PathBuf>,
    /// Serial port of a real board, e.g. /dev/ttyACM0 or COM3
    #[arg(long, value_name = "PORT", conflicts_with_all = ["board", "firmware", "on", "state"])]
    port: Option<String>,
    /// Rate of that port, bits per second
    #[arg(long, value_name = "RATE", default_value_t = BAUD, requires = "port")]
    baud: u32,
}

/// The boards that QEMU emulates, by name.
pub(super) fn boards() -> impl TypedValueParser<Value = Board> {
    let emulated = BOARDS.into_iter().filter(|board| board.emulated);
    let values: Vec<_> = emulated.map(|board| PossibleValue::new(board.name).help(board.core)).collect();
    PossibleValuesParser::new(values).try_map(|name| Board::named(&name).ok_or("no such board"))
}

#[derive(Clone, Copy, Debug, ValueEnum)]
enum On {
    /// QEMU if it and the firmware are available, else this computer
    Auto,
    /// QEMU
    Qemu,
    /// The firmware's logic on this computer
    Host,
}

impl Target {
    /// Adds what the device keeps on disk to the files of a verb.
    pub(super) fn with_files(&self, files: Files) -> Files {
        let firmware = files.and_reading(&self.firmware);
        firmware.continuing(&self.state, Content::Flash(self.board.memory_bytes))
    }

    /// Where the device runs; prints a note if that is only the fallback.
    pub(super) fn runtime(&self, run: &Run) -> anyhow::Result<Runtime> {
        if let Some(port) = self.port.clone() {
            return Ok(Runtime::Serial { port, baud: self.baud });
        }
        let wanted = match self.on {
            On::Auto => RuntimeChoice::Best,
            On::Qemu => RuntimeChoice::Qemu,
            On::Host => RuntimeChoice::Host,
        };
        let choice = Runtime::choose(self.board, wanted, self.firmware.as_deref());
        let (runtime, fallback) = choice.map_err(|error| self.advised(error))?;
        if let (Some(why), false) = (&fallback, run.quiet) {
            // A reader of stderr that has left is no reason to stop.
            let _ = writeln!(
                std::io::stderr(),
                "note: the firmware's logic runs on this computer, not on the emulated board: {why}"
            );
        }
        Ok(runtime)
    }

    /// The error with the options that help.
    fn advised(&self, error: DeviceError) -> anyhow::Error {
        let here = "run the firmware's logic on this computer with `--on host`";
        match &error {
            DeviceError::NoFirmware { .. } if self.firmware.is_none() => {
                anyhow!("{error}; or name an image with `--firmware ELF`; or {here}")
            }
            DeviceError::NoQemu | DeviceError::NoFirmware { .. } => anyhow!("{error}; or {here}"),
            _ => error.into(),
        }
    }
}
