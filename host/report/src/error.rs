use ommatidia_model::instrument::InstrumentError;
use ommatidia_session::SessionError;
use ommatidia_session::artifact::ArtifactError;
use ommatidia_shared::blob::BlobError;
use std::path::{Path, PathBuf};
use thiserror::Error;

/// Why a report cannot be rendered.
#[derive(Debug, Error)]
pub enum ReportError {
    /// An artifact cannot be read.
    #[error(transparent)]
    Artifact(#[from] ArtifactError),
    /// An instrument cannot be read.
    #[error(transparent)]
    Instrument(#[from] InstrumentError),
    /// A session cannot be opened.
    #[error(transparent)]
    Session(#[from] SessionError),
    /// A network file is damaged.
    #[error("{path}: {detail}; quantize the checkpoint again")]
    Blob {
        /// The file.
        path: PathBuf,
        /// What is wrong.
        detail: BlobError,
    },
    /// A picture cannot be encoded.
    #[error("a picture cannot be encoded: {0}")]
    Picture(#[from] png::EncodingError),
    /// A chart cannot be drawn.
    #[error("a chart cannot be drawn: {0}")]
    Chart(String),
    /// The file is of a kind that a report does not show.
    #[error(
        "{path}: expected an instrument, checkpoint, network file, evaluation, account of a closed loop, session \
         folder, recording or JSON, found {found}"
    )]
    Kind {
        /// The file.
        path: PathBuf,
        /// What it is.
        found: String,
    },
}

impl ReportError {
    pub(super) fn blob(path: &Path, detail: BlobError) -> Self {
        Self::Blob { path: path.into(), detail }
    }
}
