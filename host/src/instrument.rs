//! The instrument: everything that calibration learned, in one file.

use crate::effects::EffectSetting;
use crate::noise::NoiseModel;
use crate::session::Manifest;
use ndarray::{Array2, Array4, Array5};
use serde::{Deserialize, Serialize};

/// The calibrated model of one instrument. Lenses are numbered row by row, `l = i * array.cols + j`.
///
/// On disk it is an artifact of kind `instrument`: a safetensors file whose metadata hold the provenance and
/// the small numbers as JSON and whose tensors are the arrays, so that Python reads it as it is.
#[derive(Clone, Debug)]
pub struct Instrument {
    /// Sizes, pitches and names of the session that it was calibrated from (its stacks left out).
    pub manifest: Manifest,
    /// Noise of the sensor.
    pub noise: NoiseModel,
    /// Per-pixel offset relative to the black level, DN, [sensor rows, sensor cols]; None: no darks were measured.
    pub offset_dn: Option<Array2<f32>>,
    /// Chief rays.
    pub geometry: Geometry,
    /// Low-rank spatially varying PSFs.
    pub psf: LowRankPsf,
    /// Effects that the loop has added to the model, in the order in which they were accepted.
    pub effects: Vec<EffectSetting>,
    /// How well it reproduces what it was made from.
    pub quality: Quality,
}

/// Chief rays, Eq. 1 of the paper: the focus of a source at object position (y, x) lies at
/// `anchor_l + magnification / pixel_pitch * (y, x)`, sensor pixels, for each lens l.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Geometry {
    /// Focus of the on-axis source (x = y = 0) through each lens, [row, col], sensor pixels (0 = centre of first pixel).
    pub anchors_px: Vec<[f64; 2]>,
    /// Magnification, image per object; positive, since image coordinates are already un-inverted.
    pub magnification: f64,
    /// Lenses that show no focus at all (dead or blocked): they add nothing.
    pub dead: Vec<bool>,
}

/// Per-lens truncated SVD, Eq. 2: `H_l(p; x, y) = sum_k M_lk(x, y) B_lk(p)`, p relative to the chief ray.
///
/// A window's centre pixel is `round(chief ray)` of an object pixel; the sub-pixel remainder and whatever distortion
/// is left are inside the basis PSFs.
#[derive(Clone, Debug)]
pub struct LowRankPsf {
    /// Basis PSFs B, [lens, k, window, window], unit norm each.
    pub basis: Array4<f32>,
    /// Coefficients M at the nodes of a regular grid over the object, [lens, k, depth, node row, node col]: DN above
    /// black for a unit source in the session's light unit at `exposure_ms`.
    pub coefficients: Array5<f32>,
    /// Depths z of the nodes, um, ascending; one entry where the bead was scanned in one plane.
    pub node_depths_um: Vec<f64>,
    /// Object rows (fractional pixels) of the grid nodes, ascending.
    pub node_rows_px: Vec<f64>,
    /// Object columns (fractional pixels) of the grid nodes, ascending.
    pub node_cols_px: Vec<f64>,
    /// Exposure that the coefficients are for, ms.
    pub exposure_ms: f64,
}

/// How well the model reproduces the bead scan.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Quality {
    /// NRMSE of the rank-K model on the bead frames that it was made from.
    pub approximation_error: f64,
    /// NRMSE on bead positions that were left out (checkerboard).
    pub off_grid_error: f64,
}
