//! The background of measured frames over their predictions: light, or a shift of the black level, that does not come
//! from the object.
//!
//! It is a plane, level and two slopes, that all frames share. It is fitted by least squares, weighted with the noise,
//! together with a factor of the predicted light, so that light of another unit is not taken for a background.

use super::figures::MetricError;
use super::frames::{FrameComparison, SensorNoise};
use crate::slopes::{Slopes, slope_terms, slope_value};
use ndarray::{Array2, ArrayView2, Zip};
use ommatidia_physics::linalg::least_squares;
use serde::{Deserialize, Serialize};

/// Significance, in standard errors, from which a background is added to the prediction.
const SEEN: f64 = 5.0;
/// Smallest level or slope that is added, as a share of the read noise: below it, chi-squared changes by less than 1 %.
const MATTERS: f64 = 0.1;
/// Share of the mean light that a level or slope must exceed: fainter light far from the foci may be their tails, which
/// are the optics' affair.
const TAILS: f64 = 0.005;
/// Fewest pixels that determine a background.
const FEWEST_PX: f64 = 256.0;

/// What measured frames hold beyond the light of their objects.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct FrameBackground {
    /// Level, change from the first to the last row, and from the first to the last column, e- a pixel.
    pub mean_e: Slopes,
    /// Their standard errors, e-. They grow where the residual is larger than the noise.
    pub sigma_e: Slopes,
    /// Whether it was added to the prediction: it is significant and large enough to matter.
    pub added: bool,
    /// NRMSE of the prediction without it.
    pub nrmse_without: f64,
    /// Chi-squared per lit pixel without it.
    pub chi2_ndf_without: f64,
}

impl FrameBackground {
    /// Whether level or slopes cannot be noise, and are large enough to matter where the read noise is `read_e`, and
    /// the mean of the predicted light `light_e`, e-.
    pub(super) fn is_seen(&self, read_e: f64, light_e: f64) -> bool {
        let least = (MATTERS * read_e).max(TAILS * light_e);
        let seen = |(m, s): (&f64, &f64)| *s > 0.0 && m.abs() > SEEN * s && m.abs() > least;
        self.mean_e.iter().zip(&self.sigma_e).any(seen)
    }
}

/// Normal equations of `residual = factor * light + plane`, over all frames.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct PlaneFit {
    gram: [[f64; 4]; 4],
    right: [f64; 4],
    squares: f64,
    light_dn: f64,
    pixels: f64,
}

impl PlaneFit {
    /// Adds the pixels of a frame that clip neither in the prediction nor in `reference`.
    pub(super) fn add(
        &mut self,
        f: &FrameComparison,
        reference: ArrayView2<'_, f32>,
        sensor: SensorNoise<'_>,
    ) -> Result<(), MetricError> {
        let dim = f.predicted.dim();
        if reference.dim() != dim {
            return Err(MetricError::Shape { expected: dim, found: reference.dim() });
        }
        let (black, top) = (sensor.noise.black_level_dn, sensor.noise.saturation_dn as f32 - 0.5);
        Zip::indexed(&f.predicted).and(reference).for_each(|(r, c), &p, &y| {
            if p >= top || y >= top {
                return;
            }
            let level = f64::from(p) - sensor.offset_at((r, c));
            let t = slope_terms(dim, [r, c]);
            let x = [t[0], t[1], t[2], level - black];
            let (off, weight) = (f64::from(y - p), 1.0 / sensor.variance_dn2((r, c), level));
            for i in 0..4 {
                self.right[i] += weight * x[i] * off;
                (0..4).for_each(|j| self.gram[i][j] += weight * x[i] * x[j]);
            }
            self.squares += weight * off * off;
            self.light_dn += level - black;
            self.pixels += 1.0;
        });
        Ok(())
    }

    /// Mean of the predicted light, background included, DN.
    pub(super) fn mean_light_dn(&self) -> f64 {
        self.light_dn / self.pixels.max(1.0)
    }

    /// The plane and its standard errors, DN; None from too few pixels.
    pub(super) fn plane(&self) -> Option<(Slopes, Slopes)> {
        if self.pixels < FEWEST_PX {
            return None;
        }
        let gram = Array2::from_shape_fn((4, 4), |(i, j)| self.gram[i][j]);
        let scale: Vec<f64> = (0..4).map(|i| gram[[i, i]].sqrt().max(f64::MIN_POSITIVE)).collect();
        let even = Array2::from_shape_fn((4, 4), |(i, j)| gram[[i, j]] / (scale[i] * scale[j]));
        let right = Array2::from_shape_fn((4, 1), |(i, _)| self.right[i] / scale[i]);
        let found = least_squares(&even, &right).ok()?;
        let inverse = least_squares(&even, &Array2::eye(4)).ok()?;
        let explained: f64 = (0..4).map(|i| found[[i, 0]] * right[[i, 0]]).sum();
        let more = ((self.squares - explained) / self.pixels).max(1.0);
        let value = [0, 1, 2].map(|i| found[[i, 0]] / scale[i]);
        Some((value, [0, 1, 2].map(|i| (more * inverse[[i, i]].max(0.0)).sqrt() / scale[i])))
    }
}

/// Adds a plane, DN, to a predicted frame [sensor rows, sensor cols]; `top_dn` clips it.
pub fn add_background(frame_dn: &mut Array2<f32>, plane_dn: &Slopes, top_dn: f64) {
    let dim = frame_dn.dim();
    for ((r, c), v) in frame_dn.indexed_iter_mut() {
        *v = (f64::from(*v) + slope_value(plane_dn, dim, [r, c])).min(top_dn) as f32;
    }
}
