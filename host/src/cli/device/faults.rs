//! `device faults`: the table of faults tried.

use crate::artifact::write_whole;
use crate::cli::Outcome;
use crate::device::{Firmware, faults};
use ommatidia_shared::boards::MPS2_AN500;
use serde_json::json;
use std::path::PathBuf;

/// Options of `device faults`.
#[derive(Debug, clap::Args)]
pub(super) struct Args {
    /// Where the page goes, Markdown
    #[arg(short, long, value_name = "FILE")]
    output: Option<PathBuf>,
}

/// Runs the verb.
pub(super) fn run(args: &Args) -> anyhow::Result<Outcome> {
    let mut rows = faults::try_here()?;
    rows.extend(faults::try_board(&Firmware::build(MPS2_AN500, "app")?, &Firmware::build(MPS2_AN500, "watchdog")?)?);
    if let Some(path) = &args.output {
        write_whole(path, faults::page(&rows).as_bytes())?;
    }
    Ok(Outcome { json: json!({ "faults": rows }), text: faults::table(&rows) })
}
