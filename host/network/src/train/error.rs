//! Why a network cannot be built or trained.

use ommatidia_physics::sensor::MapShapeError;
use ommatidia_session::artifact::ArtifactError;
use std::path::PathBuf;
use thiserror::Error;

/// Why a network cannot be built or trained.
#[derive(Debug, Error)]
pub enum TrainError {
    /// A field of the configuration has a value that is not allowed.
    #[error("{field}: expected {expected}, found {found}")]
    Config {
        /// The field.
        field: &'static str,
        /// Values that are allowed.
        expected: String,
        /// Its value.
        found: String,
    },
    /// A training pair does not fit the network, or holds no light or values that are not finite.
    #[error("training pair {index}: {what}: expected {expected}, found {found}")]
    Pair {
        /// Index of the pair.
        index: usize,
        /// Which of its two images.
        what: &'static str,
        /// What was expected.
        expected: String,
        /// What was found.
        found: String,
    },
    /// The source of pairs failed.
    #[error("training pair {index}: {source}")]
    Source {
        /// Index of the pair.
        index: usize,
        /// Error of the source.
        source: Box<dyn std::error::Error + Send + Sync>,
    },
    /// Too few pairs to hold some out.
    #[error("expected at least {expected} training pairs, found {found}; simulate more")]
    TooFew {
        /// Smallest number of pairs that training needs.
        expected: usize,
        /// Number of pairs.
        found: usize,
    },
    /// The loss or a gradient is not finite.
    #[error(
        "step {step}: the loss or its gradient is not finite (loss {loss}); train again with a lower --learning-rate \
         and --filter-learning-rate (the last checkpoint, if there is one, is still there)"
    )]
    Diverged {
        /// The step.
        step: u64,
        /// The loss.
        loss: f32,
    },
    /// The checkpoint to resume was made with another configuration.
    #[error(
        "{path}: `{field}` is {found} in the checkpoint, but the options ask for {expected}; resume with the options \
         of that run, or start a new one"
    )]
    Resume {
        /// The checkpoint.
        path: PathBuf,
        /// The field.
        field: &'static str,
        /// Value that the options ask for.
        expected: String,
        /// Value in the checkpoint.
        found: String,
    },
    /// A sensor map has another shape than the network's frames.
    #[error(transparent)]
    Maps(#[from] MapShapeError),
    /// A checkpoint could not be read or written.
    #[error(transparent)]
    Artifact(#[from] ArtifactError),
}
