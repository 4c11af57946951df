//! The images of one object through all lenses.

use crate::psf::LensImage;

/// The image of one object through each lens, DN above black at the exposure of the calibration.
#[derive(Clone, Debug)]
pub struct SceneLight {
    /// For each lens (None: dead), one image for each plane.
    pub(super) lenses: Vec<Option<Vec<LensImage>>>,
    /// Offset of a point source from the nearest object pixel, [row, col], px.
    pub(super) shift_px: [f64; 2],
    /// Depth, um; None: that of the planned plane.
    pub(super) z_um: Option<f64>,
}

impl SceneLight {
    /// The same object at depth `z_um`. The model must be planned at every depth ([`super::Forward::with_all_depths`]).
    /// It is interpolated between depths; beyond them the nearest depth holds.
    pub fn at_depth(self, z_um: f64) -> Self {
        Self { z_um: Some(z_um), ..self }
    }
}
