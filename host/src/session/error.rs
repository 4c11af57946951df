//! Why a session or a stack of frames could not be read or written.

use std::path::{Path, PathBuf};
use thiserror::Error;

/// Why a session or a stack of frames could not be read or written: the file, the field, what was expected, what was
/// found, and what to do.
#[derive(Debug, Error)]
pub enum SessionError {
    /// A file or folder could not be opened, read or written.
    #[error(
        "{path}: cannot be opened, read or written ({source}); check its name, that it is there, and its permissions"
    )]
    Io {
        /// The file.
        path: PathBuf,
        /// What the system said.
        source: std::io::Error,
    },
    /// The manifest is no valid TOML, or has a key that is unknown, missing or of the wrong type.
    #[error("{path}: not a valid manifest: {detail}")]
    Manifest {
        /// The file.
        path: PathBuf,
        /// What the parser said, with line and column.
        detail: String,
    },
    /// The manifest is of another version of the format.
    #[error("{path}: format: expected {expected}, found {found}; this program reads format {expected} only")]
    Version {
        /// The file.
        path: PathBuf,
        /// Version that this program reads.
        expected: u32,
        /// Version of the file.
        found: String,
    },
    /// A value cannot be: not finite, negative, out of its range, or at odds with another one.
    #[error("{path}: {field}: expected {expected}, found {found}; {remedy}")]
    Value {
        /// The file.
        path: PathBuf,
        /// Key, or column and row.
        field: String,
        /// What was expected.
        expected: String,
        /// What was found.
        found: String,
        /// What to do.
        remedy: &'static str,
    },
    /// A table lacks a column, or a manifest an entry.
    #[error("{path}: {field}: expected, but there is none; found {found}; {remedy}")]
    Missing {
        /// The file.
        path: PathBuf,
        /// Column or key.
        field: String,
        /// What is there instead.
        found: String,
        /// What to do.
        remedy: &'static str,
    },
    /// A stack or table has another shape than the manifest or its companion says.
    #[error("{path}: shape: expected {expected}, found {found}; {remedy}")]
    Shape {
        /// The file.
        path: PathBuf,
        /// Expected shape.
        expected: String,
        /// Shape of the file.
        found: String,
        /// What to do.
        remedy: &'static str,
    },
    /// Samples of a type that is not read.
    #[error("{path}: sample type: expected {expected}, found {found}; convert the frames, e.g. `a.astype('float32')`")]
    SampleType {
        /// The file.
        path: PathBuf,
        /// Types that are read here.
        expected: &'static str,
        /// Type of the file.
        found: String,
    },
    /// The file ends before (or after) its header says.
    #[error("{path}: size: expected {expected} bytes, found {found}; the file was cut short or damaged: copy it again")]
    Size {
        /// The file.
        path: PathBuf,
        /// Size that the header asks for.
        expected: u64,
        /// Size of the file.
        found: u64,
    },
    /// The file is no .npy or .tif, or a damaged one.
    #[error("{path}: not a readable {kind} file ({detail}); write it again")]
    Format {
        /// The file.
        path: PathBuf,
        /// Kind of file that was expected.
        kind: &'static str,
        /// What is wrong.
        detail: String,
    },
    /// The place that a session shall be written to is taken.
    #[error("{path}: already exists and is no session of the virtual instrument; choose another name or remove it")]
    Taken {
        /// The folder.
        path: PathBuf,
    },
}

impl SessionError {
    pub(super) fn io(path: &Path, source: std::io::Error) -> Self {
        Self::Io { path: path.into(), source }
    }

    pub(super) fn value(
        path: &Path,
        field: impl Into<String>,
        expected: impl Into<String>,
        found: impl ToString,
        remedy: &'static str,
    ) -> Self {
        Self::Value {
            path: path.into(),
            field: field.into(),
            expected: expected.into(),
            found: found.to_string(),
            remedy,
        }
    }

    pub(super) fn format(path: &Path, kind: &'static str, detail: impl ToString) -> Self {
        Self::Format { path: path.into(), kind, detail: detail.to_string() }
    }
}
