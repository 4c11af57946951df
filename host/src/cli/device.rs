//! `device`: the firmware under QEMU or on a board. (being written)

use super::{Outcome, Run};

/// Options of `device`.
#[derive(Debug, clap::Args)]
pub struct Args {}

/// Runs the verb.
///
/// # Errors
/// Whatever the library says.
pub fn run(_args: &Args, _run: &Run) -> anyhow::Result<Outcome> {
    anyhow::bail!("`device` is being written")
}
