//! A network file on the host: the very pipeline of the device.

use super::{MethodError, Reconstruct};
use ndarray::{Array2, ArrayView2};
use ommatidia_shared::blob::{ALIGN, BlobError, Header, Verified};
use ommatidia_shared::num::{f16, widen};
use ommatidia_shared::pipeline::{Memory, Pipeline, PipelineError, Stats};
use std::path::{Path, PathBuf};
use thiserror::Error;

/// Why a network file cannot be used.
#[derive(Debug, Error)]
pub enum NetworkFileError {
    /// It cannot be read.
    #[error("{path}: {source}")]
    Io {
        /// The file.
        path: PathBuf,
        /// What the system said.
        source: std::io::Error,
    },
    /// It is no network file, or damaged.
    #[error("network file: {0}")]
    Blob(#[from] BlobError),
    /// It holds a network that cannot run.
    #[error("network file: {0}")]
    Pipeline(#[from] PipelineError),
}

/// A network file, checked.
pub struct Blob {
    /// The file somewhere in here, at a multiple of [`ALIGN`].
    bytes: Vec<u8>,
    start: usize,
    len: usize,
    verified: Verified,
}

impl Blob {
    /// Checks the bytes of a network file.
    ///
    /// # Errors
    /// They are no network file, are damaged, or hold a network that cannot run.
    pub fn new(file: Vec<u8>) -> Result<Self, NetworkFileError> {
        let len = file.len();
        let mut bytes = vec![0; len + ALIGN];
        let start = bytes.as_ptr().align_offset(ALIGN).min(ALIGN);
        bytes[start..start + len].copy_from_slice(&file);
        let verified = Verified::check(&bytes[start..start + len])?;
        let blob = Self { bytes, start, len, verified };
        Pipeline::new(&verified.open(blob.bytes())?)?;
        Ok(blob)
    }

    /// Reads and checks a network file.
    ///
    /// # Errors
    /// As [`Blob::new`], or the file cannot be read.
    pub fn open(path: &Path) -> Result<Self, NetworkFileError> {
        Self::new(std::fs::read(path).map_err(|source| NetworkFileError::Io { path: path.into(), source })?)
    }

    /// The file.
    pub fn bytes(&self) -> &[u8] {
        &self.bytes[self.start..self.start + self.len]
    }

    /// What it says of itself.
    ///
    /// # Errors
    /// None for a file that [`Blob::new`] has accepted.
    pub fn header(&self) -> Result<Header, NetworkFileError> {
        Ok(self.verified.open(self.bytes())?.into_header())
    }

    /// Runs the pipeline on raw codes, [frame rows, frame cols]: the reconstruction as halves, [object rows, object cols], bit for bit
    /// what a device gives.
    ///
    /// # Errors
    /// The frame has another length.
    pub fn run(&self, codes: &[u16]) -> Result<(Vec<f16>, Stats), NetworkFileError> {
        let network = self.verified.open(self.bytes())?;
        let pipeline = Pipeline::new(&network)?;
        let mut fast = vec![0.0; pipeline.fast_len_best().max(pipeline.fast_len())];
        let mut bulk = vec![f16::ZERO; pipeline.bulk_len()];
        let mut output = vec![f16::ZERO; pipeline.output_len()];
        let stats = pipeline.run(codes, Memory { fast: &mut fast, bulk: &mut bulk }, &mut output)?;
        Ok((output, stats))
    }
}

impl Reconstruct for Blob {
    fn name(&self) -> &str {
        "svfouriernet-blob"
    }

    /// Values are rounded to codes first: a device knows no others.
    fn reconstruct(&self, frame_dn: ArrayView2<'_, f32>) -> anyhow::Result<Array2<f32>> {
        let header = self.header()?;
        let expected = (usize::from(header.frame.rows), usize::from(header.frame.cols));
        if frame_dn.dim() != expected {
            return Err(MethodError::FrameShape { expected, found: frame_dn.dim() }.into());
        }
        if let Some(((row, col), &found)) = frame_dn.indexed_iter().find(|(_, v)| !v.is_finite()) {
            return Err(MethodError::NotFinite { row, col, found }.into());
        }
        let codes: Vec<u16> = frame_dn.iter().map(|v| v.round().clamp(0.0, f32::from(u16::MAX)) as u16).collect();
        let (output, _) = self.run(&codes)?;
        let object = (usize::from(header.object.rows), usize::from(header.object.cols));
        Ok(Array2::from_shape_vec(object, output.into_iter().map(widen).collect())?)
    }
}
