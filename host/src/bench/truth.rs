//! Ground truth of a virtual session. Only tests and reports compare with it; no verb computes from it.

use super::config::BenchConfig;
use crate::effects::EffectSetting;
use serde::{Deserialize, Serialize};

/// Name of the ground-truth file in the session's folder.
pub const TRUTH_FILE: &str = "bench_truth.json";

/// Ground truth of a virtual session.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct BenchTruth {
    /// Name and version of the program that wrote the session.
    pub program: String,
    /// Seed of noise and scenes.
    pub seed: u64,
    /// Conversion gain, DN per electron.
    pub gain_dn_per_e: f64,
    /// Read noise, electrons rms.
    pub read_noise_e: f64,
    /// Black level, DN.
    pub black_level_dn: f64,
    /// Anchors (the foci of the on-axis source), sensor pixels: [lens row][lens col][row, col].
    pub anchors_px: Vec<Vec<[f64; 2]>>,
    /// True magnification: image size over object size.
    pub magnification: f64,
    /// Object position on the axis of each lens, um: [lens row][lens col][y, x].
    pub axes_um: Vec<Vec<[f64; 2]>>,
    /// Light of one unit of a truth through a lens straight above it, electrons: that of the bead.
    pub unit_e: f64,
    /// Injected effects.
    pub effects: Vec<EffectSetting>,
    /// Configuration of the instrument.
    pub config: BenchConfig,
}
