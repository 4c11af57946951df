//! Photon transfer: a line through variance over light.

use crate::noise::stats::Summary;
use ndarray::Array2;

/// Variance of rounding to whole DN, DN^2.
pub const ROUNDING_DN2: f64 = 1.0 / 12.0;
/// Allowance for errors beside counting statistics (nonlinearity, drift), relative to the variance of each level.
pub(super) const MODEL_ERROR: f64 = 2e-3;

/// The line `variance - 1/12 = slope * mean + intercept`, mean light above black in DN, variance in DN^2.
pub(super) struct Transfer {
    /// Gain, DN per electron.
    pub slope: f64,
    /// Standard error of the slope.
    pub slope_sigma: f64,
    /// Variance of the read noise, DN^2.
    pub intercept: f64,
    /// Standard error of the intercept.
    pub intercept_sigma: f64,
}

impl Transfer {
    /// Weighted least squares through the levels of flats, and the darks if there are any.
    ///
    /// # Errors
    /// States why the levels do not determine a line.
    pub(super) fn fit(levels: &[Summary], dark: Option<Summary>) -> Result<Self, &'static str> {
        if levels.is_empty() {
            return Err("there are no flats with two or more unsaturated frames at one light level");
        }
        let points: Vec<Summary> = dark.into_iter().chain(levels.iter().copied()).collect();
        let range = points.iter().fold([f64::INFINITY, f64::NEG_INFINITY], |r, p| [r[0].min(p.mean), r[1].max(p.mean)]);
        if points.len() < 2 || range[1] - range[0] <= 0.1 * range[1].abs() {
            return Err("the flats have only one light level, and there are no darks to compare it with");
        }
        let mut s = [0.0; 5];
        for p in &points {
            let w = 1.0 / (p.sigma.powi(2) + (MODEL_ERROR * p.variance.max(ROUNDING_DN2)).powi(2));
            let y = p.variance - ROUNDING_DN2;
            for (sum, v) in s.iter_mut().zip([w, w * p.mean, w * p.mean * p.mean, w * y, w * p.mean * y]) {
                *sum += v;
            }
        }
        let determinant = s[0] * s[2] - s[1] * s[1];
        Ok(Self {
            slope: (s[0] * s[4] - s[1] * s[3]) / determinant,
            slope_sigma: (s[0] / determinant).sqrt(),
            intercept: (s[2] * s[3] - s[1] * s[4]) / determinant,
            intercept_sigma: (s[2] / determinant).sqrt(),
        })
    }
}

/// Photon-transfer points, [level, (mean above black, variance, fitted variance)], DN and DN^2; darks first.
pub(super) fn curve(
    levels: &[Summary],
    dark: Option<Summary>,
    transfer: &Result<Transfer, &'static str>,
) -> Array2<f32> {
    let points: Vec<Summary> = dark.into_iter().chain(levels.iter().copied()).collect();
    let fitted = |p: &Summary| transfer.as_ref().map_or(p.variance, |t| t.slope * p.mean + t.intercept + ROUNDING_DN2);
    Array2::from_shape_fn((points.len(), 3), |(i, c)| {
        [points[i].mean, points[i].variance, fitted(&points[i])][c] as f32
    })
}
