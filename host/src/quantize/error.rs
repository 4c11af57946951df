//! Why no network file can be made.

use ommatidia_shared::blob::BlobError;
use ommatidia_shared::pipeline::PipelineError;
use thiserror::Error;

/// Why no network file can be made.
#[derive(Debug, Error)]
pub enum QuantizeError {
    /// A weight is no number.
    #[error(
        "weight `{name}`, element {index}: expected a finite value, found {found}; train again or resume an earlier checkpoint"
    )]
    NotFinite {
        /// Name of the tensor.
        name: String,
        /// Which element.
        index: usize,
        /// The value.
        found: f32,
    },
    /// A weight leaves the range of halves.
    #[error("weight `{name}`, element {index}: expected at most 65504 in magnitude to fit a half, found {found}")]
    Range {
        /// Name of the tensor.
        name: String,
        /// Which element.
        index: usize,
        /// The value.
        found: f32,
    },
    /// A device runs one network alone.
    #[error("expected a checkpoint of an SV-FourierNet, found one of {0}: peers run on the host")]
    Family(&'static str),
    /// A size is none that a device can have.
    #[error("{field}: expected {expected}, found {found}")]
    Size {
        /// The field.
        field: &'static str,
        /// What it must be.
        expected: String,
        /// What it is.
        found: usize,
    },
    /// No set of taps keeps enough of the filters.
    #[error(
        "tile {tile}: expected {expected:.4} of the filters' energy in at most {most} taps, found {found:.4}; ask for less energy, a larger tile, or none"
    )]
    Energy {
        /// Side of the tile, pixels.
        tile: usize,
        /// What was asked for.
        expected: f64,
        /// What the most taps keep.
        found: f64,
        /// The most taps.
        most: usize,
    },
    /// The device has too little memory.
    #[error(
        "{what}: expected at most {expected} bytes, found {found}: {missing} bytes are missing; use a smaller preset, or `--prune` for less flash"
    )]
    Budget {
        /// Which memory.
        what: &'static str,
        /// What there is, bytes.
        expected: u64,
        /// What is needed, bytes.
        found: u64,
        /// The difference, bytes.
        missing: u64,
    },
    /// The network file refuses its content.
    #[error("network file: {0}")]
    Blob(#[from] BlobError),
    /// The pipeline refuses the network.
    #[error("pipeline: {0}")]
    Pipeline(#[from] PipelineError),
    /// The float network refuses its weights.
    #[error(transparent)]
    Train(#[from] crate::train::TrainError),
    /// A method could not reconstruct a held-out frame.
    #[error("held-out frame {index}: {detail}")]
    Case {
        /// Which.
        index: usize,
        /// What it said.
        detail: String,
    },
}
