//! Network files on disk: what a device runs, and what the host runs bit for bit like the device.

use ndarray::ArrayView2;
use ommatidia_physics::sensor::{FrameError, sensor_codes};
use ommatidia_session::artifact::{ArtifactError, write_whole};
use ommatidia_session::kind::FileKind;
use ommatidia_session::remedy;
use ommatidia_shared::blob::{ALIGN, BlobError, Header, Network, Verified, Weights, encode, encoded_len};
use ommatidia_shared::num::f16;
use ommatidia_shared::pipeline::{Memory, Pipeline, PipelineError};
use std::path::{Path, PathBuf};
use thiserror::Error;

/// Why a network file, or a raw frame given to it, cannot be used.
#[derive(Debug, Error)]
pub enum NetworkFileError {
    /// The file could not be read.
    #[error("{path}: cannot be read ({source}); {}", remedy(.source))]
    Io {
        /// The file.
        path: PathBuf,
        /// Error of the operating system.
        source: std::io::Error,
    },
    /// The file could not be written.
    #[error(transparent)]
    Write(#[from] ArtifactError),
    /// The file is of another kind.
    #[error("{path}: expected a network file, found {found}; `ommatidia quantize` makes one from a checkpoint")]
    Kind {
        /// The file.
        path: PathBuf,
        /// What it is.
        found: FileKind,
    },
    /// The bytes are not a network file, or are damaged.
    #[error("{path}: {source}")]
    Format {
        /// The file, or the name of the network.
        path: PathBuf,
        /// What is wrong with the bytes.
        source: BlobError,
    },
    /// The parts of the network do not fit together, so it cannot run.
    #[error("{path}: {source}")]
    Pipeline {
        /// The file, or the name of the network.
        path: PathBuf,
        /// What does not fit.
        source: PipelineError,
    },
    /// A raw frame has another shape than the network, or holds values that are not sensor codes.
    #[error(transparent)]
    Frame(#[from] FrameError),
}

/// A network file in memory, checked bit by bit, at an address where the weights can be read in place.
#[derive(Clone, Debug)]
pub struct NetworkFile {
    words: Vec<u128>,
    len: usize,
    /// Proof that the bytes were checked: they are opened without checking them again.
    verified: Verified,
}

const _: () = assert!(size_of::<u128>() == ALIGN);

impl NetworkFile {
    /// Encodes a network in memory.
    ///
    /// # Errors
    /// [`NetworkFileError::Format`]: the header and the weights do not belong together.
    pub fn new(header: &Header, weights: &Weights<'_>) -> Result<Self, NetworkFileError> {
        let named = |source| NetworkFileError::Format { path: header.name.as_str().into(), source };
        let len = encoded_len(header).map_err(named)?;
        let mut words = vec![0u128; len.div_ceil(ALIGN)];
        encode(header, weights, bytemuck::cast_slice_mut(&mut words)).map_err(named)?;
        let verified = Verified::check(&bytemuck::cast_slice(&words)[..len]).map_err(named)?;
        Ok(Self { words, len, verified })
    }

    /// Takes the bytes of a network file and checks them; `path` names them in errors.
    ///
    /// # Errors
    /// The first thing that is wrong with the bytes, or the network cannot run.
    pub fn from_bytes(path: &Path, bytes: &[u8]) -> Result<Self, NetworkFileError> {
        let mut words = vec![0u128; bytes.len().div_ceil(ALIGN)];
        bytemuck::cast_slice_mut(&mut words)[..bytes.len()].copy_from_slice(bytes);
        let named = |source| NetworkFileError::Format { path: path.into(), source };
        let verified = Verified::check(&bytemuck::cast_slice(&words)[..bytes.len()]).map_err(named)?;
        let file = Self { words, len: bytes.len(), verified };
        Pipeline::new(&file.network()?).map_err(|source| NetworkFileError::Pipeline { path: path.into(), source })?;
        Ok(file)
    }

    /// Reads and checks a network file.
    ///
    /// # Errors
    /// The file is missing, or as [`NetworkFile::from_bytes`].
    pub fn read(path: &Path) -> Result<Self, NetworkFileError> {
        let bytes = std::fs::read(path).map_err(|source| NetworkFileError::Io { path: path.into(), source })?;
        match FileKind::of(path) {
            // What looks like a network file, or like nothing known, is judged by its bytes.
            Ok(FileKind::Blob | FileKind::Unknown) | Err(_) => Self::from_bytes(path, &bytes),
            Ok(found) => Err(NetworkFileError::Kind { path: path.into(), found }),
        }
    }

    /// Writes the file: whole, or not at all.
    ///
    /// # Errors
    /// The folder is missing or not writable, or the disk is full.
    pub fn write(&self, path: &Path) -> Result<(), NetworkFileError> {
        Ok(write_whole(path, self.bytes())?)
    }

    /// The bytes of the file.
    pub fn bytes(&self) -> &[u8] {
        &bytemuck::cast_slice(&self.words)[..self.len]
    }

    /// The network, borrowed from the file's bytes.
    ///
    /// # Errors
    /// None: the bytes have been checked.
    pub fn network(&self) -> Result<Network<'_>, NetworkFileError> {
        self.verified
            .open(self.bytes())
            .map_err(|source| NetworkFileError::Format { path: "network file".into(), source })
    }

    /// The header: name, shapes, sensor, memory plan.
    ///
    /// # Errors
    /// None: the bytes have been checked.
    pub fn header(&self) -> Result<Header, NetworkFileError> {
        Ok(self.network()?.into_header())
    }

    /// The sensor codes of a raw frame, DN, [frame rows, frame cols], row by row; see [`sensor_codes`].
    ///
    /// # Errors
    /// [`NetworkFileError::Frame`]: the frame has another shape than the network takes, or a value is not a sensor
    /// code.
    pub fn codes(&self, frame_dn: ArrayView2<'_, f32>) -> Result<Vec<u16>, NetworkFileError> {
        let frame = self.header()?.frame;
        Ok(sensor_codes(frame_dn, [frame.rows.into(), frame.cols.into()])?)
    }

    /// Runs the network on the codes of one frame, [frame rows * frame cols]: the reconstruction as halves, [object
    /// rows * object cols], bit for bit what a device gives.
    ///
    /// # Errors
    /// [`NetworkFileError::Pipeline`]: the frame has another length.
    pub fn run(&self, codes: &[u16]) -> Result<Vec<f16>, NetworkFileError> {
        let network = self.network()?;
        let refused = |source| NetworkFileError::Pipeline { path: "network file".into(), source };
        let pipeline = Pipeline::new(&network).map_err(refused)?;
        let mut fast = vec![0.0; pipeline.fast_len_best().max(pipeline.fast_len())];
        let mut bulk = vec![f16::ZERO; pipeline.bulk_len()];
        let mut output = vec![f16::ZERO; pipeline.output_len()];
        pipeline.run(codes, Memory { fast: &mut fast, bulk: &mut bulk }, &mut output).map_err(refused)?;
        Ok(output)
    }
}
