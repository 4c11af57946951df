//! Opens a session: one on disk, or one that a virtual instrument measures on demand.

use super::{BenchConfig, BenchError};
use crate::session::Session;
use std::path::Path;
use std::sync::Arc;

/// Opens the session at `path`: a folder with a measured session, or the configuration of a virtual instrument
/// (`.toml`), whose frames are computed when they are read, under `seed`.
///
/// # Errors
/// The folder is not a session, or the configuration is invalid.
pub fn open_session(path: &Path, seed: u64) -> Result<Session, BenchError> {
    if path.is_file() && path.extension().is_some_and(|e| e == "toml") {
        return Ok(Arc::new(BenchConfig::read(path)?.build(&[])?).live(path, seed));
    }
    Ok(Session::open(path)?)
}
