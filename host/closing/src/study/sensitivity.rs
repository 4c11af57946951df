//! How well a session determines the strength of each effect.

use super::sessions::Holds;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// How well a session determines one strength.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Sensitivity {
    /// Name of the strength.
    pub param: String,
    /// Its unit; `1`: relative.
    pub unit: String,
    /// Standard error when the effect is absent: noise, scatter and calibration (foreign effects: noise alone).
    pub sigma: f64,
}

/// How well sessions of one instrument determine each effect.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Sensitivities {
    /// By id of the effect.
    pub of: BTreeMap<String, Sensitivity>,
    /// Ids of effects that they cannot determine.
    pub cannot: Vec<String>,
    /// The same of sessions of other kinds, where a study asks for them.
    #[serde(default)]
    pub of_kinds: BTreeMap<Holds, Sensitivities>,
}
