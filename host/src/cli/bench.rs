//! `bench`: the virtual instrument measures a session. (being written)

use super::{Outcome, Run};

/// Options of `bench`.
#[derive(Debug, clap::Args)]
pub struct Args {}

/// Runs the verb.
///
/// # Errors
/// Whatever the library says.
pub fn run(_args: &Args, _run: &Run) -> anyhow::Result<Outcome> {
    anyhow::bail!("`bench` is being written")
}
