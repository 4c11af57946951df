//! Errors of artifacts.

use crate::remedy;
use crate::signature::FileKind;
use std::path::{Path, PathBuf};
use thiserror::Error;

/// Why an artifact could not be read or written.
#[derive(Debug, Error)]
pub enum ArtifactError {
    /// The file could not be opened, read or written.
    #[error("{path}: cannot be opened, read or written ({source}); {}", remedy(.source))]
    Io {
        /// The file.
        path: PathBuf,
        /// The system's error.
        source: std::io::Error,
    },
    /// The file is not an artifact, or it is cut short.
    #[error("{path}: not an Ommatidia artifact, or cut short ({detail}); write it again with the verb that makes it")]
    Format {
        /// The file.
        path: PathBuf,
        /// What is wrong.
        detail: String,
    },
    /// The path is a file of another kind, or a folder.
    #[error(
        "{path}: expected an artifact, as a verb writes them, found {found}; name a file of that kind, and check the \
         order of the arguments"
    )]
    Other {
        /// The file or folder.
        path: PathBuf,
        /// What it is.
        found: FileKind,
    },
    /// The file is an artifact of another kind.
    #[error("{path}: expected an artifact of kind `{expected}`, found `{found}`")]
    Kind {
        /// The file.
        path: PathBuf,
        /// Requested kind.
        expected: String,
        /// Kind of the file.
        found: String,
    },
    /// The file has another version of its kind's layout.
    #[error("{path}: expected {kind} version {expected}, found {found}; write it again with this program")]
    Version {
        /// The file.
        path: PathBuf,
        /// Kind of the file.
        kind: String,
        /// Version that this program reads.
        expected: u32,
        /// Version of the file.
        found: u32,
    },
    /// A tensor is missing, or has the wrong shape or values.
    #[error("{path}: tensor `{name}`: expected {expected}, found {found}")]
    Tensor {
        /// The file.
        path: PathBuf,
        /// Name of the tensor.
        name: String,
        /// What was expected.
        expected: String,
        /// What was found.
        found: String,
    },
}

impl ArtifactError {
    pub(super) fn io(path: &Path, source: std::io::Error) -> Self {
        Self::Io { path: path.into(), source }
    }

    pub(super) fn format(path: &Path, detail: impl ToString) -> Self {
        Self::Format { path: path.into(), detail: detail.to_string() }
    }
}
