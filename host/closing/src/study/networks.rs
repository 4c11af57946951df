//! What a study needs of networks; the crate that knows networks implements it.

use crate::Retrain;
use ommatidia_model::instrument::Instrument;
use std::path::Path;

/// Steps of the first training.
const STEPS: u64 = 3000;
/// Trains the networks of a study; the crate that knows networks implements it.
pub trait FirstTraining {
    /// Trains a network of the smallest preset on scenes that the instrument simulates, and writes its checkpoint.
    ///
    /// # Errors
    /// The instrument's parts disagree, or the file cannot be written.
    fn train(&self, request: &TrainRequest<'_>) -> anyhow::Result<()>;
}

/// What a first training needs.
#[derive(Clone, Copy, Debug)]
pub struct TrainRequest<'a> {
    /// The instrument that the scenes are simulated with.
    pub instrument: &'a Instrument,
    /// Its file, for the provenance of the checkpoint.
    pub instrument_file: &'a Path,
    /// Checkpoint to write.
    pub output: &'a Path,
    /// Steps of the optimiser.
    pub steps: u64,
    /// Seed of all random draws.
    pub seed: u64,
}

/// What a study needs of networks.
pub trait Networks: FirstTraining + Retrain + Sync {}

impl<T: FirstTraining + Retrain + Sync> Networks for T {}

/// Trains the network that both fine-tunings start from.
///
/// # Errors
/// The instrument's parts disagree, or the file cannot be written.
pub fn train(
    networks: &dyn Networks,
    instrument: &Instrument,
    instrument_file: &Path,
    seed: u64,
    output: &Path,
) -> anyhow::Result<()> {
    networks.train(&TrainRequest { instrument, instrument_file, output, steps: STEPS, seed })
}
