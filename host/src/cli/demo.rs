//! `demo`: the verbs in a row on the virtual instrument. (being written)

use super::{Outcome, Run};

/// Options of `demo`.
#[derive(Debug, clap::Args)]
pub struct Args {}

/// Runs the verb.
///
/// # Errors
/// Whatever the library says.
pub fn run(_args: &Args, _run: &Run) -> anyhow::Result<Outcome> {
    anyhow::bail!("`demo` is being written")
}
