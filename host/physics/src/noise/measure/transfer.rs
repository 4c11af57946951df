//! Photon transfer: a line through variance over light.

use super::bend::Bend;
use crate::noise::stats::Summary;
use ndarray::Array2;

/// Variance of rounding to whole DN, DN^2.
pub const ROUNDING_DN2: f64 = 1.0 / 12.0;
/// Allowance for errors beside counting statistics (nonlinearity, drift), relative to the variance of each level.
pub(super) const MODEL_ERROR: f64 = 2e-3;

/// Error of the variance of a level, DN^2.
pub(super) fn variance_error(level: &Summary) -> f64 {
    level.sigma.hypot(MODEL_ERROR * level.variance.max(ROUNDING_DN2))
}

/// The line `variance - 1/12 = slope * light + intercept`, light above black in DN, variance in DN^2. Where the
/// response bends, `light` is that of a linear pixel, times the square of the slope of the response there.
pub(super) struct Transfer {
    /// Gain, DN per electron.
    pub slope: f64,
    /// Standard error of the slope.
    pub slope_sigma: f64,
    /// Variance of the read noise, DN^2.
    pub intercept: f64,
    /// Standard error of the intercept.
    pub intercept_sigma: f64,
    /// The bend of the response. None: linear.
    pub bend: Option<Bend>,
}

/// What the variance is proportional to, DN: the light of a level, times the square of the slope of the response.
fn counted(mean: f64, bend: Option<&Bend>) -> f64 {
    bend.map_or(mean, |b| {
        let light = b.straight(mean);
        light * b.slope(light).powi(2)
    })
}

impl Transfer {
    /// Weighted least squares through the levels of flats, and the darks if there are any.
    ///
    /// # Errors
    /// States why the levels do not determine a line.
    pub(super) fn fit(levels: &[Summary], dark: Option<Summary>, bend: Option<Bend>) -> Result<Self, &'static str> {
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
            let w = 1.0 / variance_error(p).powi(2);
            let (x, y) = (counted(p.mean, bend.as_ref()), p.variance - ROUNDING_DN2);
            for (sum, v) in s.iter_mut().zip([w, w * x, w * x * x, w * y, w * x * y]) {
                *sum += v;
            }
        }
        let determinant = s[0] * s[2] - s[1] * s[1];
        Ok(Self {
            slope: (s[0] * s[4] - s[1] * s[3]) / determinant,
            slope_sigma: (s[0] / determinant).sqrt(),
            intercept: (s[2] * s[3] - s[1] * s[4]) / determinant,
            intercept_sigma: (s[2] / determinant).sqrt(),
            bend,
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
    let fitted = |p: &Summary| {
        let line = |t: &Transfer| t.slope * counted(p.mean, t.bend.as_ref()) + t.intercept + ROUNDING_DN2;
        transfer.as_ref().map_or(p.variance, line)
    };
    Array2::from_shape_fn((points.len(), 3), |(i, c)| {
        [points[i].mean, points[i].variance, fitted(&points[i])][c] as f32
    })
}
