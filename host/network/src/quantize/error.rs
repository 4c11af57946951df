//! Why a network file cannot be made.

use ommatidia_shared::blob::BlobError;
use ommatidia_shared::pipeline::PipelineError;
use thiserror::Error;

/// Why a network file cannot be made.
#[derive(Debug, Error)]
pub enum QuantizeError {
    /// A weight is infinite or not a number.
    #[error(
        "weight `{name}`, element {index}: expected a finite value, found {found}; train again or resume an earlier \
         checkpoint"
    )]
    NotFinite {
        /// Name of the tensor.
        name: String,
        /// Index of the element, in C order.
        index: usize,
        /// The value.
        found: f32,
    },
    /// A weight is too large for a half.
    #[error("weight `{name}`, element {index}: expected at most 65504 in magnitude to fit a half, found {found}")]
    Range {
        /// Name of the tensor.
        name: String,
        /// Index of the element, in C order.
        index: usize,
        /// The value.
        found: f32,
    },
    /// Devices run SV-FourierNet only.
    #[error("expected a checkpoint of svfouriernet, found one of {0}, which runs on the host only")]
    Architecture(&'static str),
    /// Devices run no Richardson-Lucy iterations.
    #[error(
        "expected a network without Richardson-Lucy iterations, found {iterations}: such networks run on the host \
         only; train with --richardson-lucy 0 (--passes 2 and more run on devices)"
    )]
    Iterations {
        /// Number of Richardson-Lucy iterations ahead of the passes.
        iterations: usize,
    },
    /// Networks in integers have one pass.
    #[error(
        "expected a network of one pass for integers, found {passes} passes, which devices run in half precision only; \
         leave --weights, --activations and, of `train`, --quantize out, or train with --passes 1"
    )]
    PassesInIntegers {
        /// Number of passes.
        passes: usize,
    },
    /// The maps that watch the optics do not fit the network.
    #[error(transparent)]
    Watch(#[from] crate::watch::WatchError),
    /// A size that devices do not support.
    #[error("{field}: expected {expected}, found {found}")]
    Size {
        /// The field.
        field: &'static str,
        /// Sizes that are supported.
        expected: String,
        /// The size.
        found: usize,
    },
    /// The maximum number of taps does not keep enough of the filters.
    #[error(
        "tile {tile}: expected {expected:.4} of the filters' energy in at most {most} taps, found {found:.4}; ask for \
         less energy, a larger tile, or no tile"
    )]
    Energy {
        /// Side of the tile, pixels.
        tile: usize,
        /// Fraction of the energy that was asked for.
        expected: f64,
        /// Fraction that the maximum number of taps keeps.
        found: f64,
        /// Maximum number of taps.
        most: usize,
    },
    /// The network needs more memory than the budget allows.
    #[error(
        "{what}: expected at most {expected} bytes, found {found}: {missing} bytes are missing; use a smaller preset, \
         or `--prune` for less flash"
    )]
    Budget {
        /// Kind of memory.
        what: &'static str,
        /// Budget, bytes.
        expected: u64,
        /// Memory that the network needs, bytes.
        found: u64,
        /// Difference, bytes.
        missing: u64,
    },
    /// The ranges of integers are measured on held-out frames, and the checkpoint has none.
    #[error(
        "the checkpoint has no held-out frames, on which the ranges of integers are measured; train it with \
         `ommatidia train`, or leave --weights out"
    )]
    NoFrames,
    /// A layer cannot be written in integers.
    #[error("layer `{layer}`, output channel {channel}: its weights are too large for integers; leave --weights out")]
    Integers {
        /// Name of the layer.
        layer: String,
        /// Index of the output channel.
        channel: usize,
    },
    /// The parts of the network cannot be encoded as a file.
    #[error("network file: {0}")]
    Blob(#[from] BlobError),
    /// The network cannot run on a device.
    #[error("pipeline: {0}")]
    Pipeline(#[from] PipelineError),
    /// The checkpoint does not make a float network.
    #[error(transparent)]
    Train(#[from] crate::train::TrainError),
    /// A held-out frame could not be reconstructed or judged.
    #[error("held-out frame {index}: {detail}")]
    Case {
        /// Index of the frame.
        index: usize,
        /// Error of the reconstruction.
        detail: String,
    },
}
