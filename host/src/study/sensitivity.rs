//! How well a session determines the strength of each effect.

use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// How well a session tells one strength.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Sensitivity {
    /// Name of the strength.
    pub param: String,
    /// Its unit.
    pub unit: String,
    /// Standard error where the effect is absent: noise, scatter, calibration (of a foreign effect the noise alone).
    pub sigma: f64,
}

/// What sessions of an instrument can tell.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Sensitivities {
    /// By id of the effect.
    pub of: BTreeMap<String, Sensitivity>,
    /// Ids that they cannot tell.
    pub cannot: Vec<String>,
}
