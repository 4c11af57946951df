//! Chief rays: where the focus of each lens lies for each place of a source.

use serde::{Deserialize, Serialize};

/// Chief rays, Eq. 1 of the paper: the focus of a source at object position (y, x) lies at
/// `anchor_l + magnification / pixel_pitch * (y, x)`, sensor pixels, for each lens l.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ChiefRays {
    /// Focus of the on-axis source (x = y = 0) through each lens, [row, col], sensor pixels (0: centre of the first
    /// pixel).
    pub anchors_px: Vec<[f64; 2]>,
    /// Magnification, image per object; positive, since image coordinates are already un-inverted.
    pub magnification: f64,
    /// True for each lens that shows no focus (dead or blocked); it contributes no light.
    pub dead: Vec<bool>,
}

impl ChiefRays {
    /// Those of one lens alone. None: there is no such lens.
    pub fn of_lens(&self, lens: usize) -> Option<Self> {
        Some(Self {
            anchors_px: vec![*self.anchors_px.get(lens)?],
            magnification: self.magnification,
            dead: vec![*self.dead.get(lens)?],
        })
    }
}
