//! Which networks devices run.

use super::QuantizeError;
use crate::train::{Architecture, Checkpoint};

/// Checks that devices run such networks.
///
/// # Errors
/// The network is of another architecture than SV-FourierNet, or begins with Richardson-Lucy iterations.
pub(super) fn check_architecture(checkpoint: &Checkpoint) -> Result<(), QuantizeError> {
    let network = &checkpoint.body.network;
    if network.architecture != Architecture::SvFourierNet {
        return Err(QuantizeError::Architecture(network.architecture.name().as_str()));
    }
    match network.iterations() {
        0 => Ok(()),
        iterations => Err(QuantizeError::Iterations { iterations }),
    }
}

/// Checks that devices run such networks in integers.
///
/// # Errors
/// As [`check_architecture`]; or the network has more than one pass.
pub(super) fn check_integers(checkpoint: &Checkpoint) -> Result<(), QuantizeError> {
    check_architecture(checkpoint)?;
    match checkpoint.body.network.passes() {
        1 => Ok(()),
        passes => Err(QuantizeError::PassesInIntegers { passes }),
    }
}
