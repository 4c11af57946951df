//! `train`: the network. (being written)

use super::{Outcome, Run};

/// Options of `train`.
#[derive(Debug, clap::Args)]
pub struct Args {}

/// Runs the verb.
///
/// # Errors
/// Whatever the library says.
pub fn run(_args: &Args, _run: &Run) -> anyhow::Result<Outcome> {
    anyhow::bail!("`train` is being written")
}
