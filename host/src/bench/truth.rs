//! What was true of a virtual session: for tests, never for another verb.

use super::BenchConfig;
use crate::effects::EffectSetting;
use serde::{Deserialize, Serialize};

/// Name of the file in the session's folder.
pub const TRUTH_FILE: &str = "bench_truth.json";

/// What was true of a virtual session.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct BenchTruth {
    /// Program that made the session.
    pub program: String,
    /// Seed of noise and scenes.
    pub seed: u64,
    /// Conversion gain, DN per electron.
    pub gain_dn_per_e: f64,
    /// Read noise, electrons rms.
    pub read_noise_e: f64,
    /// Black level, DN.
    pub black_level_dn: f64,
    /// Chief rays of the on-axis source: where the light of its foci is centred, sensor pixels: [lens row][lens col][row, col].
    pub anchors_px: Vec<Vec<[f64; 2]>>,
    /// True magnification, image per object.
    pub magnification: f64,
    /// Object position on each lens's axis, um: [lens row][lens col][y, x].
    pub axes_um: Vec<Vec<[f64; 2]>>,
    /// Light of one unit of truth through one lens straight above it, electrons: that of the bead.
    pub unit_e: f64,
    /// Effects that were injected.
    pub effects: Vec<EffectSetting>,
    /// The instrument.
    pub config: BenchConfig,
}
