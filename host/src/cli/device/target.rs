//! Which device, and what runs it.

use crate::cli::Run;
use crate::device::{Runtime, Wanted};
use clap::ValueEnum;
use std::path::PathBuf;

/// Options that name a device.
#[derive(Debug, clap::Args)]
pub(super) struct Target {
    /// The board
    #[arg(long, value_enum, default_value_t = Board::Mps2An500)]
    board: Board,
    /// Firmware image for the board (default: build it)
    #[arg(long, value_name = "ELF")]
    firmware: Option<PathBuf>,
    /// What runs the firmware
    #[arg(long, value_enum, default_value_t = On::Auto)]
    on: On,
    /// File that is the flash of the device; made if it is missing (default: a flash that is empty, and lost at the end)
    #[arg(long, value_name = "FILE")]
    pub(super) state: Option<PathBuf>,
}

#[derive(Clone, Copy, Debug, ValueEnum)]
enum Board {
    /// Cortex-M7, ARM MPS2 with FPGA image AN500
    Mps2An500,
}

#[derive(Clone, Copy, Debug, ValueEnum)]
enum On {
    /// QEMU if it and the firmware can be had, else this machine
    Auto,
    /// QEMU
    Qemu,
    /// The firmware's logic on this machine
    Host,
}

impl Target {
    /// What runs the device; tells where it is the second choice.
    pub(super) fn runtime(&self, run: &Run) -> anyhow::Result<Runtime> {
        let Board::Mps2An500 = self.board;
        let wanted = match self.on {
            On::Auto => Wanted::Best,
            On::Qemu => Wanted::Qemu,
            On::Host => Wanted::Host,
        };
        let (runtime, fallback) = Runtime::choose(wanted, self.firmware.as_deref())?;
        if let (Some(why), false) = (&fallback, run.quiet) {
            eprintln!("note: the firmware's logic runs on this machine, not on the emulated board: {why}");
        }
        Ok(runtime)
    }
}
