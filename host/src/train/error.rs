//! Why training stops.

use crate::artifact::ArtifactError;
use std::path::PathBuf;
use thiserror::Error;

/// Why a network cannot be built or trained.
#[derive(Debug, Error)]
pub enum TrainError {
    /// A field of the configuration makes no sense.
    #[error("{field}: expected {expected}, found {found}")]
    Config {
        /// The field.
        field: &'static str,
        /// What it must be.
        expected: String,
        /// What it is.
        found: String,
    },
    /// A training pair does not fit the network, or cannot be trained on.
    #[error("training pair {index}: {what}: expected {expected}, found {found}")]
    Pair {
        /// Which pair.
        index: usize,
        /// Which half of it.
        what: &'static str,
        /// What was expected.
        expected: String,
        /// What was found.
        found: String,
    },
    /// The source of pairs failed.
    #[error("training pair {index}: {source}")]
    Source {
        /// Which pair.
        index: usize,
        /// What it said.
        source: Box<dyn std::error::Error + Send + Sync>,
    },
    /// Too few pairs to hold some out.
    #[error("expected at least {expected} training pairs, found {found}; simulate more")]
    TooFew {
        /// Fewest that serve.
        expected: usize,
        /// How many there are.
        found: usize,
    },
    /// The loss is no number any more.
    #[error(
        "step {step}: the loss is {loss}; train anew with a lower --learning-rate and --filter-learning-rate (the last checkpoint, if there is one, stands)"
    )]
    Diverged {
        /// The step.
        step: u64,
        /// The loss.
        loss: f32,
    },
    /// The checkpoint to resume was made with another configuration.
    #[error(
        "{path}: `{field}` is {found} in the checkpoint but {expected} is asked for; resume with the same options or start anew"
    )]
    Resume {
        /// The checkpoint.
        path: PathBuf,
        /// The field.
        field: &'static str,
        /// What is asked for.
        expected: String,
        /// What the checkpoint was made with.
        found: String,
    },
    /// A checkpoint could not be read or written.
    #[error(transparent)]
    Artifact(#[from] ArtifactError),
}
