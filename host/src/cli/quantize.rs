//! `quantize`: checkpoint -> blob. (being written)

use super::{Outcome, Run};

/// Options of `quantize`.
#[derive(Debug, clap::Args)]
pub struct Args {}

/// Runs the verb.
///
/// # Errors
/// Whatever the library says.
pub fn run(_args: &Args, _run: &Run) -> anyhow::Result<Outcome> {
    anyhow::bail!("`quantize` is being written")
}
