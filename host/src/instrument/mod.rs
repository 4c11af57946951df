//! The instrument: everything that calibration learned, in one file.

mod calibrate;
mod file;
#[cfg(test)]
pub(crate) mod fixture;
mod light_unit;
mod model;
mod replicates;
mod sensor_maps;
mod sensor_only;
#[cfg(test)]
#[allow(clippy::unwrap_used)]
pub(crate) mod testbed;
#[cfg(test)]
mod tests;
#[cfg(test)]
mod width_tests;

pub use calibrate::{CalibrateConfig, CalibrateError, Calibration, calibrate};
pub use file::{INSTRUMENT_KIND, INSTRUMENT_VERSION, InstrumentError};

use crate::effects::EffectSetting;
use crate::noise::{MapErrors, NoiseModel, inverse_response};
use crate::psf::nodes::Taps;
use crate::session::Manifest;
use ndarray::{Array1, Array2, Array4, Array5, Axis, s};
use serde::{Deserialize, Serialize};

/// The calibrated model of one instrument. Lenses are numbered row by row, `l = i * array.cols + j`.
///
/// On disk it is an artifact of kind `instrument`: a safetensors file whose metadata hold the provenance and
/// the small numbers as JSON and whose tensors are the arrays, so that Python reads it as it is.
#[derive(Clone, Debug)]
pub struct Instrument {
    /// Sizes, pitches and names of the session that it was calibrated from; its stacks left out, and the window as wide as that of
    /// the basis PSFs.
    pub manifest: Manifest,
    /// Noise of the sensor.
    pub noise: NoiseModel,
    /// Per-pixel offset relative to the black level, DN, [sensor rows, sensor cols]; None: no darks were measured.
    pub offset_dn: Option<Array2<f32>>,
    /// Per-pixel response to light relative to the mean, lamp shading left out, [sensor rows, sensor cols]; None: the flats
    /// do not tell it.
    pub response: Option<Array2<f32>>,
    /// Variance of the reading of each pixel, rounding included, DN^2, [sensor rows, sensor cols]; None: the pixels are alike as far as
    /// the darks tell, and `noise` holds for all of them.
    pub reading_dn2: Option<Array2<f32>>,
    /// Chief rays.
    pub geometry: Geometry,
    /// Low-rank spatially varying PSFs.
    pub psf: LowRankPsf,
    /// The PSF model as J fits with a group of beads left out each give it; empty: its uncertainty is not known.
    ///
    /// For any figure s that is predicted with each of them in the place of `psf` (see [`Instrument::replicate`]) the variance
    /// that calibration gives it is `(J-1)/J * sum_j (s_j - mean s)^2`. Each has a basis of its own: basis and coefficients of
    /// two of them cannot be mixed. Chief rays, noise and light unit are those of the
    /// instrument in all of them: the error of the light unit, one scale common to all predictions, is not in that variance.
    pub replicates: Vec<LowRankPsf>,
    /// Effects that the loop has added to the model, in the order in which they were accepted.
    pub effects: Vec<EffectSetting>,
    /// What one unit of light in objects is.
    pub light_unit: LightUnit,
    /// How well it reproduces what it was made from.
    pub quality: Quality,
    /// What a report draws of the calibration.
    pub diagnostics: Diagnostics,
}

impl Instrument {
    /// What brings the light of each pixel to that of a pixel of mean response, [sensor rows, sensor cols]; None: not known.
    pub fn inverse_response(&self) -> Option<Array2<f32>> {
        self.response.as_ref().map(inverse_response)
    }
}

impl Instrument {
    /// The instrument with its PSF model replaced by replicate `j`; None: there is no such one.
    pub fn replicate(&self, j: usize) -> Option<Self> {
        let psf = self.replicates.get(j)?.clone();
        Some(Self { psf, replicates: Vec::new(), ..self.clone() })
    }

    /// Rank at which one decomposition of all lenses together errs as little on the scan as this model; None: not known, or beyond what
    /// was looked at.
    pub fn whole_array_rank(&self) -> Option<usize> {
        let errors = &self.diagnostics.whole_array_error;
        Some(1 + errors.iter().position(|e| f64::from(*e) <= self.quality.approximation_error)?)
    }

    /// Whether the optics was never measured: there was no bead scan, and the model stands for the sensor alone.
    pub fn sensor_only(&self) -> bool {
        self.diagnostics.positions_px.is_empty() && self.psf.basis.len_of(Axis(1)) == 1
    }
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
/// A window's centre pixel is `corner_l + (r, c)` for object pixel (r, c), with `corner_l = round(anchor_l - centre)`:
/// one object pixel is one sensor pixel; the sub-pixel remainder and whatever distortion
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

impl LowRankPsf {
    /// Index of the depth nearest to `z_um`.
    pub fn depth_nearest(&self, z_um: f64) -> usize {
        let off = |i: &usize| (self.node_depths_um[*i] - z_um).abs();
        (0..self.node_depths_um.len()).min_by(|a, b| off(a).total_cmp(&off(b))).unwrap_or(0)
    }

    /// The model at one depth, interpolated between the calibrated ones; outside them the last one holds.
    pub fn at_depth(&self, z_um: f64) -> Self {
        let taps = Taps::at(&self.node_depths_um, z_um);
        let mut coefficients = self.coefficients.slice(s![.., .., ..1, .., ..]).to_owned();
        coefficients.fill(0.0);
        for (i, weight) in taps.weights.iter().enumerate().take(taps.count) {
            let depth = taps.first + i;
            coefficients.scaled_add(*weight, &self.coefficients.slice(s![.., .., depth..depth + 1, .., ..]));
        }
        Self { coefficients, node_depths_um: vec![z_um], ..self.clone() }
    }
}

/// What one unit of light in objects is.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum LightUnit {
    /// The bead of the calibration scan, in one object pixel.
    #[default]
    Bead,
    /// 1 DN above black on the pixel's place on the sensor at the exposure of the model: there was no bead scan.
    Dn,
    /// The unit of the session's scene truths; this many of it make one bead.
    Truth {
        /// Truth units a bead (a DN, without a bead scan).
        per_bead: f64,
    },
}

/// How well the model reproduces the bead scan. NRMSE is `|measured - predicted| / |measured|` (Euclidean norms over all
/// windows, black level taken off).
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Quality {
    /// NRMSE of the rank-K model on the bead frames that it was made from.
    pub approximation_error: f64,
    /// NRMSE on bead positions that were left out (checkerboard).
    pub off_grid_error: f64,
    /// The same for one PSF a lens, the mean of the positions that were not left out.
    pub one_psf_error: f64,
    /// The part of these errors that the noise of the bead frames alone makes.
    pub noise_floor: f64,
    /// Distance of the foci from their chief rays (Eq. 1), rms over both axes, px: distortion and noise.
    pub chief_ray_rms_px: f64,
    /// What the maps of the sensor leave of its true patterns.
    pub maps: MapErrors,
}

/// Curves and maps of the calibration, for reports and `inspect`; no figure depends on them.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Diagnostics {
    /// Bead positions, object pixels, [bead, (row, col)].
    pub positions_px: Array2<f32>,
    /// Pearson correlation of each bead's foci with those of the bead nearest to the axis (Fig. 2a), one a bead.
    pub pcc: Array1<f32>,
    /// NRMSE of the rank-K model by bead, each bead's own light as the norm, one a bead.
    pub bead_nrmse: Array1<f32>,
    /// Singular values of each lens's windows, largest first, [lens, bead].
    pub singular_values: Array2<f32>,
    /// Error against rank, [rank tried, (rank, approximation error, off-grid error)].
    pub error_by_rank: Array2<f32>,
    /// NRMSE on the scan of one decomposition of all lenses together, by its rank from 1; empty: not known.
    pub whole_array_error: Array1<f32>,
    /// Photon transfer, [level, (mean above black in DN, temporal variance in DN^2, fitted variance in DN^2)].
    pub photon_transfer: Array2<f32>,
}
