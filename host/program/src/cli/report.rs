//! `report`: renders artifacts to one HTML file.

use super::common::{Outcome, Run, in_json};
use super::files::{Content, Files};
use ommatidia_session::artifact;
use ommatidia_session::kind::FileKind;
use std::path::PathBuf;

/// Options of `report`.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Instruments, checkpoints, network files, evaluations, accounts of closed loops, session folders, JSON that a
    /// command printed
    #[arg(required = true, value_name = "ARTIFACT")]
    artifacts: Vec<PathBuf>,
    /// HTML file to write
    #[arg(short, long, value_name = "FILE", default_value = "report.html")]
    output: PathBuf,
}

impl Args {
    /// What the verb reads and writes.
    pub fn files(&self) -> Files {
        Files::reading(&self.artifacts).writing([&self.output], Content::File(FileKind::Page))
    }
}

/// Runs the verb.
///
/// # Errors
/// An artifact cannot be read or is of no kind that a report shows, or the page cannot be written.
pub fn run(args: &Args, _run: &Run) -> anyhow::Result<Outcome> {
    let page = ommatidia_report::render(&args.artifacts)?;
    artifact::write_whole(&args.output, page.as_bytes())?;
    let artifacts: Vec<String> = args.artifacts.iter().map(in_json).collect();
    Ok(Outcome {
        json: serde_json::json!({ "report": in_json(&args.output), "bytes": page.len(), "artifacts": artifacts }),
        text: format!("report: {} ({})\n", args.output.display(), ommatidia_report::bytes(page.len() as u64)),
    })
}
