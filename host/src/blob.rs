//! Network files on disk, and the raw codes that a network takes.

use crate::artifact::{ArtifactError, write_whole};
use ndarray::ArrayView2;
use ommatidia_shared::blob::{ALIGN, BlobError, Header, Network, Verified, Weights, encode, encoded_len};
use ommatidia_shared::pipeline::PipelineError;
use std::path::{Path, PathBuf};
use thiserror::Error;

/// Why a network file or a raw frame cannot be used.
#[derive(Debug, Error)]
pub enum BlobFileError {
    /// The file could not be read.
    #[error("{path}: cannot be read ({source}); check its name, that it is there, and its permissions")]
    Io {
        /// The file.
        path: PathBuf,
        /// What the system said.
        source: std::io::Error,
    },
    /// The file could not be written.
    #[error(transparent)]
    Write(#[from] ArtifactError),
    /// The bytes are no network.
    #[error("{path}: {source}")]
    Blob {
        /// The file, or the name of the network.
        path: PathBuf,
        /// What is wrong with it.
        source: BlobError,
    },
    /// The network contradicts itself.
    #[error("network file: {0}")]
    Pipeline(PipelineError),
    /// A raw frame has another shape than the network takes.
    #[error(
        "raw frame: expected {expected:?} pixels, found {found:?}; use frames of the instrument that it was made for"
    )]
    FrameShape {
        /// Rows and columns of the network.
        expected: (usize, usize),
        /// Rows and columns of the frame.
        found: (usize, usize),
    },
    /// A pixel is no code of a camera.
    #[error("raw frame: pixel ({row}, {col}): expected a code from 0 to 65535 DN, found {found}")]
    Code {
        /// Row.
        row: usize,
        /// Column.
        col: usize,
        /// Value, DN.
        found: f32,
    },
}

/// A network file in memory, checked bit by bit, at an address where the weights can be read in place.
#[derive(Clone, Debug)]
pub struct BlobFile {
    words: Vec<u128>,
    len: usize,
    verified: Verified,
}

const _: () = assert!(size_of::<u128>() == ALIGN);

impl BlobFile {
    /// Writes a network to memory.
    ///
    /// # Errors
    /// The header and the weights do not belong together.
    pub fn new(header: &Header, weights: &Weights<'_>) -> Result<Self, BlobFileError> {
        let named = |source| BlobFileError::Blob { path: header.name.as_str().into(), source };
        let len = encoded_len(header).map_err(named)?;
        let mut words = vec![0u128; len.div_ceil(ALIGN)];
        encode(header, weights, bytemuck::cast_slice_mut(&mut words)).map_err(named)?;
        let verified = Verified::check(&bytemuck::cast_slice(&words)[..len]).map_err(named)?;
        Ok(Self { words, len, verified })
    }

    /// Takes the bytes of a network file.
    ///
    /// # Errors
    /// The first thing that is wrong with them; `path` names them.
    pub fn from_bytes(path: &Path, bytes: &[u8]) -> Result<Self, BlobFileError> {
        let mut words = vec![0u128; bytes.len().div_ceil(ALIGN)];
        bytemuck::cast_slice_mut(&mut words)[..bytes.len()].copy_from_slice(bytes);
        let named = |source| BlobFileError::Blob { path: path.into(), source };
        let verified = Verified::check(&bytemuck::cast_slice(&words)[..bytes.len()]).map_err(named)?;
        Ok(Self { words, len: bytes.len(), verified })
    }

    /// Reads a network file.
    ///
    /// # Errors
    /// It is missing, or the first thing that is wrong with it.
    pub fn read(path: &Path) -> Result<Self, BlobFileError> {
        let bytes = std::fs::read(path).map_err(|source| BlobFileError::Io { path: path.into(), source })?;
        Self::from_bytes(path, &bytes)
    }

    /// Writes the file: whole, or not at all.
    ///
    /// # Errors
    /// The folder is missing or not writable, or the disk is full.
    pub fn write(&self, path: &Path) -> Result<(), BlobFileError> {
        Ok(write_whole(path, self.bytes())?)
    }

    /// The bytes of the file.
    pub fn bytes(&self) -> &[u8] {
        &bytemuck::cast_slice(&self.words)[..self.len]
    }

    /// The network.
    ///
    /// # Errors
    /// None: the bytes have been checked.
    pub fn network(&self) -> Result<Network<'_>, BlobFileError> {
        self.verified.open(self.bytes()).map_err(|source| BlobFileError::Blob { path: "network file".into(), source })
    }
}

/// The codes of a raw frame, DN, row by row, for a network that takes frames of `header.frame`. Values between two codes go
/// to the nearest.
///
/// # Errors
/// The frame has another shape, or a value is no code of a 16-bit camera.
pub fn raw_codes(header: &Header, frame_dn: ArrayView2<'_, f32>) -> Result<Vec<u16>, BlobFileError> {
    let expected = (usize::from(header.frame.rows), usize::from(header.frame.cols));
    if frame_dn.dim() != expected {
        return Err(BlobFileError::FrameShape { expected, found: frame_dn.dim() });
    }
    let code = |((row, col), &found): ((usize, usize), &f32)| {
        let rounded = found.round();
        let is_code = (0.0..=f32::from(u16::MAX)).contains(&rounded);
        if is_code { Ok(rounded as u16) } else { Err(BlobFileError::Code { row, col, found }) }
    };
    frame_dn.indexed_iter().map(code).collect()
}
