//! Errors of the virtual instrument.

use ommatidia_physics::effects::EffectError;
use ommatidia_physics::optics::OpticsError;
use ommatidia_physics::scene::SceneError;
use ommatidia_session::{SessionError, remedy};
use std::path::PathBuf;
use thiserror::Error;

/// Why the virtual instrument cannot measure.
#[derive(Debug, Error)]
pub enum BenchError {
    /// The configuration cannot be read.
    #[error("{path}: cannot be read ({source}); {}", remedy(.source))]
    Io {
        /// The file.
        path: PathBuf,
        /// The system's error.
        source: std::io::Error,
    },
    /// The configuration is not valid TOML, or has an unknown key.
    #[error("{path}: not a valid configuration: {detail}; correct the configuration")]
    Syntax {
        /// The file.
        path: PathBuf,
        /// The parser's message, with line and column.
        detail: String,
    },
    /// A number of the configuration is impossible.
    #[error("{field}: expected {expected}, found {found}; correct the configuration")]
    Config {
        /// The field.
        field: &'static str,
        /// What was expected.
        expected: String,
        /// What was found.
        found: String,
    },
    /// A number of the optics is impossible.
    #[error("optics: {0}")]
    Optics(#[from] OpticsError),
    /// An effect is unknown, or one of its parameters is out of range.
    #[error(transparent)]
    Effect(#[from] EffectError),
    /// An effect cannot act on the lenses of a family.
    #[error(
        "`{effect}` cannot act on this instrument of family `{family}`: {why}; inject less of it, or choose \
         another family"
    )]
    Refused {
        /// Id of the effect.
        effect: String,
        /// Name of the family.
        family: &'static str,
        /// Why.
        why: String,
    },
    /// The scenes cannot be drawn.
    #[error(transparent)]
    Scene(#[from] SceneError),
    /// The session cannot be written.
    #[error(transparent)]
    Session(#[from] SessionError),
}
