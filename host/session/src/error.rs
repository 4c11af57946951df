//! Errors of sessions and stacks of frames.

use crate::remedy;
use std::io::ErrorKind;
use std::path::{Path, PathBuf};
use thiserror::Error;
use tiff::TiffError;

/// Why a session or a stack of frames could not be read or written.
///
/// Each message names the file and the field, what was expected, what was found, and what to do.
#[derive(Debug, Error)]
pub enum SessionError {
    /// A file or folder could not be opened, read or written.
    #[error("{path}: cannot be opened, read or written ({source}); {}", remedy(.source))]
    Io {
        /// The file.
        path: PathBuf,
        /// The system's error.
        source: std::io::Error,
    },
    /// The manifest is not valid TOML, or has a key that is unknown, missing or of the wrong type.
    #[error("{path}: not a valid manifest: {detail}; correct the manifest")]
    Manifest {
        /// The file.
        path: PathBuf,
        /// The parser's message, with line and column.
        detail: String,
    },
    /// The manifest has another version of the session format.
    #[error(
        "{path}: format: expected {expected}, found {found}; this program reads format {expected} only: convert the \
         session, or use the program that wrote it"
    )]
    Version {
        /// The file.
        path: PathBuf,
        /// Version that this program reads.
        expected: u32,
        /// Version of the file.
        found: String,
    },
    /// A value is not finite, negative, outside its range, or contradicts another value.
    #[error("{path}: {field}: expected {expected}, found {found}; {remedy}")]
    Value {
        /// The file.
        path: PathBuf,
        /// Key of the manifest, or column and row of the table, or frame and pixel.
        field: String,
        /// What was expected.
        expected: String,
        /// What was found.
        found: String,
        /// What to do.
        remedy: &'static str,
    },
    /// A table lacks a column, or a manifest an entry.
    #[error("{path}: {field}: expected, but it is missing; found {found}; {remedy}")]
    Missing {
        /// The file.
        path: PathBuf,
        /// Column or key.
        field: String,
        /// What the file has instead.
        found: String,
        /// What to do.
        remedy: &'static str,
    },
    /// A stack or table has another shape than the manifest, or than the stack that it belongs to.
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
    /// The samples of a stack have a type that is not supported.
    #[error("{path}: sample type: expected {expected}, found {found}; convert the frames, e.g. `a.astype('float32')`")]
    SampleType {
        /// The file.
        path: PathBuf,
        /// Supported types.
        expected: &'static str,
        /// Type of the file.
        found: String,
    },
    /// The file is shorter or longer than its header states.
    #[error("{path}: size: expected {expected} bytes, found {found}; the file was cut short or damaged: copy it again")]
    Size {
        /// The file.
        path: PathBuf,
        /// Size according to the header, bytes.
        expected: u64,
        /// Size of the file, bytes.
        found: u64,
    },
    /// The file is not of the kind that its suffix promises, or it is damaged.
    #[error("{path}: not a readable {kind} file ({detail}); {}", again(.kind))]
    Format {
        /// The file.
        path: PathBuf,
        /// Kind of file that was expected.
        kind: &'static str,
        /// What is wrong.
        detail: String,
    },
    /// Another program is needed that is not installed.
    #[error(
        "{path}: the program {program} is needed for videos and was not found; install ffmpeg (Debian: `apt-get \
         install ffmpeg`), {instead}"
    )]
    Program {
        /// The file.
        path: PathBuf,
        /// Name of the program.
        program: &'static str,
        /// What can be done without it.
        instead: &'static str,
    },
    /// The folder for a new session already exists and holds something else.
    #[error("{path}: already exists and is not a session of the virtual instrument; choose another name or remove it")]
    Taken {
        /// The folder.
        path: PathBuf,
    },
}

/// The path in a borrowed error, borrowed in the same way.
macro_rules! path_of {
    ($error:expr) => {
        match $error {
            Self::Io { path, .. }
            | Self::Manifest { path, .. }
            | Self::Version { path, .. }
            | Self::Value { path, .. }
            | Self::Missing { path, .. }
            | Self::Shape { path, .. }
            | Self::SampleType { path, .. }
            | Self::Size { path, .. }
            | Self::Format { path, .. }
            | Self::Program { path, .. }
            | Self::Taken { path } => path,
        }
    };
}

impl SessionError {
    pub(super) fn io(path: &Path, source: std::io::Error) -> Self {
        Self::Io { path: path.into(), source }
    }

    /// A page of a TIFF could not be read or written.
    pub(super) fn tif(path: &Path, error: TiffError) -> Self {
        match error {
            // A place outside the file comes of a damaged header.
            TiffError::IoError(e) if e.raw_os_error().is_some() && e.kind() != ErrorKind::InvalidInput => {
                Self::io(path, e)
            }
            other => Self::format(path, ".tif", other),
        }
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
        // The words of the standard library for a file that ends before what is read of it.
        let detail = detail.to_string().replace("failed to fill whole buffer", "it ends too early");
        Self::Format { path: path.into(), kind, detail }
    }

    /// The message without the path of the file in front, for a reader who knows it.
    pub(super) fn without_path(&self) -> String {
        let (text, path) = (self.to_string(), self.path().display().to_string());
        text.strip_prefix(&format!("{path}: ")).map_or_else(|| text.clone(), str::to_string)
    }

    /// The file that the error is of.
    pub fn path(&self) -> &Path {
        path_of!(self)
    }

    /// The same error of a file that will lie in folder `to` in place of `from`.
    pub(super) fn moved(mut self, from: &Path, to: &Path) -> Self {
        let path = path_of!(&mut self);
        if let Ok(inner) = path.strip_prefix(from) {
            *path = to.join(inner);
        }
        self
    }
}

/// What to do about a file that is damaged: a table is written again, a recording cannot be made a second time.
fn again(kind: &str) -> &'static str {
    match kind {
        ".csv" | "session.toml" | "import.json" | "video" => "write it again",
        _ => "if it is whole where it was recorded or written, copy it again from there",
    }
}
