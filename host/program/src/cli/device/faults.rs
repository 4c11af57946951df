//! `device faults`: injects faults and prints the table.

use crate::cli::common::Outcome;
use crate::cli::files::{Content, Files};
use crate::device::{Emulator, Firmware, faults};
use ommatidia_session::artifact::write_whole;
use ommatidia_shared::boards::BOARDS;
use serde_json::json;
use std::path::PathBuf;

/// Options of `device faults`.
#[derive(Debug, clap::Args)]
pub(super) struct Args {
    /// Page to write, Markdown (default: only print the table)
    #[arg(short, long, value_name = "FILE")]
    output: Option<PathBuf>,
}

impl Args {
    /// What the verb reads and writes.
    pub(super) fn files(&self) -> Files {
        Files::default().writing(&self.output, Content::Text(faults::START))
    }
}

/// Runs the verb.
pub(super) fn run(args: &Args) -> anyhow::Result<Outcome> {
    // Before the faults that need none.
    Emulator::find()?;
    let mut rows = faults::try_here()?;
    let build = |bin| {
        let emulated = BOARDS.into_iter().filter(|board| board.emulated);
        emulated.map(|board| Firmware::build(board, bin)).collect::<Result<Vec<_>, _>>()
    };
    rows.extend(faults::try_boards(&build("app")?, &build("watchdog")?, &build("faults")?)?);
    if let Some(path) = &args.output {
        write_whole(path, faults::page(&rows).as_bytes())?;
    }
    Ok(Outcome { json: json!({ "faults": rows }), text: faults::table(&rows) })
}
