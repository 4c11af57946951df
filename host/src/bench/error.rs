//! Why the virtual instrument cannot measure.

use crate::effects::EffectError;
use crate::optics::OpticsError;
use crate::scene::SceneError;
use crate::session::SessionError;
use std::path::PathBuf;
use thiserror::Error;

/// Why the virtual instrument cannot measure.
#[derive(Debug, Error)]
pub enum BenchError {
    /// The configuration cannot be read.
    #[error("{path}: {source}; check the name of the configuration")]
    Io {
        /// The file.
        path: PathBuf,
        /// What the system said.
        source: std::io::Error,
    },
    /// The configuration is no valid TOML, or has an unknown key.
    #[error("{path}: not a valid configuration: {detail}")]
    Syntax {
        /// The file.
        path: PathBuf,
        /// What the parser said, with line and column.
        detail: String,
    },
    /// A number of the configuration cannot be.
    #[error("{field}: expected {expected}, found {found}")]
    Config {
        /// The field.
        field: &'static str,
        /// What was expected.
        expected: String,
        /// What was found.
        found: String,
    },
    /// A number of the optics cannot be.
    #[error("optics: {0}")]
    Optics(#[from] OpticsError),
    /// An effect is unknown or its strength cannot be.
    #[error(transparent)]
    Effect(#[from] EffectError),
    /// There are no scenes.
    #[error(transparent)]
    Scene(#[from] SceneError),
    /// The session cannot be written.
    #[error(transparent)]
    Session(#[from] SessionError),
}
