//! `inspect`: what a file is. (being written)

use super::{Outcome, Run};

/// Options of `inspect`.
#[derive(Debug, clap::Args)]
pub struct Args {}

/// Runs the verb.
///
/// # Errors
/// Whatever the library says.
pub fn run(_args: &Args, _run: &Run) -> anyhow::Result<Outcome> {
    anyhow::bail!("`inspect` is being written")
}
