//! The images of one object through all lenses.

use super::wavefront::Kept;
use crate::psf::LensImage;
use ndarray::Array2;
use std::sync::OnceLock;

/// The images of one object, lens by lens (None: dead); empty until they are needed.
pub(super) type Images = OnceLock<Vec<Option<LensImage>>>;

/// The image of one object through each lens, DN above black at the exposure of the calibration.
///
/// What is not made at once is made by the model that first needs it, of its own PSFs
/// ([`super::Forward::make_all_planes`]).
#[derive(Clone, Debug)]
pub struct SceneLight {
    /// For each plane its images. Most effects need those of the object's own plane alone.
    pub(super) planes: Vec<Images>,
    /// What the object emits, [object rows, object cols].
    pub(super) emitted: Array2<f32>,
    /// Its images under PSFs that grow, by the order of the derivative.
    pub(super) growth: [Images; 2],
    /// Changes of its images by wavefronts that effects add, lens by lens.
    pub(super) changes: Kept<LensImage>,
    /// Changes of its images from the planned plane to the others, as pupils have it, lens by lens.
    pub(super) to_planes: Kept<LensImage>,
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
