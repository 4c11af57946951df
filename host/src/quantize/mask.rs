//! Filter masks for training: the lags that a network file will keep, chosen before the first step.

use super::bank::PlannedBank;
use super::{QuantizeConfig, QuantizeError};
use crate::train::{Architecture, Checkpoint, FilterMask, Trainer};

/// A mask, and how much of the filters it keeps.
#[derive(Clone, Debug, PartialEq)]
pub struct ChosenMask {
    /// The lags that are kept.
    pub mask: FilterMask,
    /// Fraction of the filters' energy that is kept.
    pub energy_kept: f64,
}

/// The mask that [`quantize`](super::quantize) would apply to the filters of a checkpoint; None: no lag is removed.
///
/// # Errors
/// The network is of another architecture than SV-FourierNet, or the filters cannot be kept as `config` asks.
pub fn filter_mask(checkpoint: &Checkpoint, config: &QuantizeConfig) -> Result<Option<ChosenMask>, QuantizeError> {
    let architecture = &checkpoint.body.network.architecture;
    if *architecture != Architecture::SvFourierNet {
        return Err(QuantizeError::Architecture(architecture.name().as_str()));
    }
    let PlannedBank { mask, energy_kept, .. } = PlannedBank::new(checkpoint, config)?;
    Ok(mask.map(|mask| ChosenMask { mask, energy_kept }))
}

/// The filters whose strongest lags a mask keeps.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum MaskSource {
    /// The filters that the run starts with.
    Weights,
    /// Pseudo-inverses of the calibrated PSFs.
    Psfs,
}

/// The mask for training a network that [`quantize`](super::quantize) will prune with `config`; None: no lag is
/// removed.
///
/// # Errors
/// As [`filter_mask`]; or [`MaskSource::Psfs`] without calibrated lenses.
pub fn training_mask(
    run: &Trainer<'_>,
    source: MaskSource,
    config: &QuantizeConfig,
) -> Result<Option<ChosenMask>, QuantizeError> {
    match source {
        MaskSource::Weights => filter_mask(run.checkpoint(), config),
        MaskSource::Psfs => filter_mask(run.restarted_from_psfs()?.checkpoint(), config),
    }
}
