//! `evaluate`: methods side by side. (being written)

use super::{Outcome, Run};

/// Options of `evaluate`.
#[derive(Debug, clap::Args)]
pub struct Args {}

/// Runs the verb.
///
/// # Errors
/// Whatever the library says.
pub fn run(_args: &Args, _run: &Run) -> anyhow::Result<Outcome> {
    anyhow::bail!("`evaluate` is being written")
}
