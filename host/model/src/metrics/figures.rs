//! Figures of merit of a reconstruction against its truth.
//!
//! A reconstruction and its truth have different units, so each frame is judged after **one free scale**:
//! `s = <x, t> / <x, x>`, the least-squares fit of the reconstruction `x` to the truth `t`. There is no free offset:
//! background that a method does not remove counts against it. All sums are computed in f64.

use super::ssim::{self, SsimError};
use ndarray::{Array2, ArrayView2, Zip};
use serde::{Deserialize, Serialize};
use thiserror::Error;

/// Why two images cannot be compared.
#[derive(Clone, Debug, PartialEq, Error)]
pub enum MetricError {
    /// The images differ in shape.
    #[error("expected an image with the truth's shape, {expected:?} (rows, cols), found {found:?}")]
    Shape {
        /// Shape of the truth.
        expected: (usize, usize),
        /// Shape of the other image.
        found: (usize, usize),
    },
    /// The truth is 0 everywhere, so relative figures do not exist.
    #[error("expected a truth with at least one pixel above 0, found 0 everywhere")]
    DarkTruth,
    /// A value is infinite or not a number.
    #[error("expected finite values, found {found} at row {row}, column {col}")]
    NotFinite {
        /// Row of the value.
        row: usize,
        /// Column of the value.
        col: usize,
        /// The value.
        found: f32,
    },
    /// The structural similarity cannot be computed.
    #[error(transparent)]
    Ssim(#[from] SsimError),
}

/// How well one reconstruction shows its truth.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Figures {
    /// Peak signal-to-noise ratio, dB: `10 log10(max(t)^2 / mean((s x - t)^2))`.
    pub psnr_db: f64,
    /// Mean structural similarity, data range = max(t).
    pub ssim: f64,
    /// `||s x - t|| / ||t||`.
    pub nrmse: f64,
    /// Pearson correlation coefficient.
    pub pcc: f64,
    /// The free scale s.
    pub scale: f64,
}

/// Compares a reconstruction `x` with its truth `t`, both [rows, cols] and each in any unit.
///
/// A reconstruction that is 0 everywhere has scale 0, NRMSE 1 and PCC 0.
///
/// # Errors
/// [`MetricError`]: the shapes differ, a value is not finite, the truth is 0 everywhere, or the images are smaller than
/// the window of the SSIM.
pub fn compare(x: ArrayView2<'_, f32>, truth: ArrayView2<'_, f32>) -> Result<Figures, MetricError> {
    let sums = Moments::of(x, truth)?;
    let scale = sums.scale()?;
    let peak = truth.iter().fold(0.0f64, |m, &v| m.max(f64::from(v)));
    let mse = squared_error(x, truth, scale) / sums.n;
    let scaled = x.mapv(|v| (scale * f64::from(v)) as f32);
    Ok(Figures {
        psnr_db: psnr_db(peak, mse),
        ssim: ssim::ssim(scaled.view(), truth, peak)?,
        nrmse: (mse * sums.n / sums.tt).sqrt(),
        pcc: sums.pcc(),
        scale,
    })
}

/// The peak signal-to-noise ratio alone, dB, as in [`compare`] but without its other figures, which take longer.
///
/// # Errors
/// [`MetricError`]: the shapes differ, a value is not finite, or the truth is 0 everywhere.
pub fn psnr(x: ArrayView2<'_, f32>, truth: ArrayView2<'_, f32>) -> Result<f64, MetricError> {
    let sums = Moments::of(x, truth)?;
    let peak = truth.iter().fold(0.0f64, |m, &v| m.max(f64::from(v)));
    Ok(psnr_db(peak, squared_error(x, truth, sums.scale()?) / sums.n))
}

/// Peak signal-to-noise ratio, dB, of a mean squared error `mse` with signal maximum `peak` (in the same unit):
/// `10 log10(peak^2 / mse)`, at most 200 dB so that a perfect image has a finite figure.
///
/// ```
/// use ommatidia_model::metrics::psnr_db;
///
/// assert_eq!(psnr_db(1.0, 0.01), 20.0);
/// assert_eq!(psnr_db(1.0, 0.0), 200.0);
/// ```
pub fn psnr_db(peak: f64, mse: f64) -> f64 {
    (10.0 * (peak * peak / mse).log10()).min(200.0)
}

/// `sum((s x - t)^2)` with scale s. It is summed directly, because the closed form from [`Moments`] loses all digits
/// where the images agree.
pub(super) fn squared_error(x: ArrayView2<'_, f32>, truth: ArrayView2<'_, f32>, scale: f64) -> f64 {
    Zip::from(x).and(truth).fold(0.0, |sum, &x, &t| {
        let d = scale * f64::from(x) - f64::from(t);
        sum + d * d
    })
}

/// Sums over the pixels of two images from which their scale and correlation follow. Sums of several frames add up to
/// the sums of their stack.
#[derive(Clone, Copy, Debug, Default)]
pub struct Moments {
    n: f64,
    x: f64,
    t: f64,
    xx: f64,
    tt: f64,
    xt: f64,
}

impl Moments {
    /// The sums over one image `x` and its reference `t`, both [rows, cols].
    ///
    /// # Errors
    /// The shapes differ, or a value is not finite.
    pub fn of(x: ArrayView2<'_, f32>, t: ArrayView2<'_, f32>) -> Result<Self, MetricError> {
        if x.dim() != t.dim() {
            return Err(MetricError::Shape { expected: t.dim(), found: x.dim() });
        }
        for image in [&x, &t] {
            if let Some(((row, col), &found)) = image.indexed_iter().find(|(_, v)| !v.is_finite()) {
                return Err(MetricError::NotFinite { row, col, found });
            }
        }
        let start = Self { n: x.len() as f64, ..Self::default() };
        Ok(Zip::from(x).and(t).fold(start, |m, &x, &t| {
            let (x, t) = (f64::from(x), f64::from(t));
            Self { n: m.n, x: m.x + x, t: m.t + t, xx: m.xx + x * x, tt: m.tt + t * t, xt: m.xt + x * t }
        }))
    }

    /// Adds the sums of another pair of images.
    pub fn add(&mut self, other: &Self) {
        self.n += other.n;
        self.x += other.x;
        self.t += other.t;
        self.xx += other.xx;
        self.tt += other.tt;
        self.xt += other.xt;
    }

    /// The least-squares scale of x to t, `<x, t> / <x, x>`; 0 where x is 0 everywhere.
    ///
    /// # Errors
    /// The reference is 0 everywhere.
    pub fn scale(&self) -> Result<f64, MetricError> {
        match (self.tt > 0.0, self.xx > 0.0) {
            (false, _) => Err(MetricError::DarkTruth),
            (true, false) => Ok(0.0),
            (true, true) => Ok(self.xt / self.xx),
        }
    }

    /// Pearson correlation coefficient; 0 where one of the images is uniform.
    pub fn pcc(&self) -> f64 {
        let covariance = self.xt - self.x * self.t / self.n;
        let variances = (self.xx - self.x * self.x / self.n) * (self.tt - self.t * self.t / self.n);
        if variances > 0.0 { covariance / variances.sqrt() } else { 0.0 }
    }

    /// Norm of the reference, `sqrt(sum t^2)`.
    pub fn reference_norm(&self) -> f64 {
        self.tt.sqrt()
    }
}

/// An image times a factor (computed in f64): a reconstruction in the unit of its truth.
pub fn scaled(x: &Array2<f32>, scale: f64) -> Array2<f32> {
    x.mapv(|v| (scale * f64::from(v)) as f32)
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use ndarray::array;

    fn ramp(rows: usize, cols: usize) -> Array2<f32> {
        Array2::from_shape_fn((rows, cols), |(r, c)| (r * cols + c) as f32)
    }

    #[test]
    fn a_scaled_truth_is_perfect() {
        let truth = ramp(16, 20);
        let f = compare(truth.mapv(|v| 0.25 * v).view(), truth.view()).unwrap();
        assert!((f.scale - 4.0).abs() < 1e-12 && f.nrmse == 0.0 && f.psnr_db == 200.0);
        assert!((f.pcc - 1.0).abs() < 1e-12 && (f.ssim - 1.0).abs() < 1e-12);
    }

    #[test]
    fn figures_by_hand() {
        // <x,t> = 2*1 + 1*2 = 4, <x,x> = 5: s = 0.8; s x - t = (0.6, -1.2): squares 0.36 + 1.44 = 1.8 = <t,t> -
        // <x,t>^2/<x,x>.
        let (x, t) = (array![[2.0f32, 1.0]], array![[1.0f32, 2.0]]);
        let m = Moments::of(x.view(), t.view()).unwrap();
        let s = m.scale().unwrap();
        assert!((s - 0.8).abs() < 1e-15);
        assert!((squared_error(x.view(), t.view(), s) - 1.8).abs() < 1e-12);
        assert!((m.pcc() + 1.0).abs() < 1e-12);
        // peak 2, mse 0.9: 10 log10(4/0.9) = 6.4782 dB
        assert!((psnr_db(2.0, 0.9) - 6.478_174_818_886_375).abs() < 1e-12);
    }

    #[test]
    fn the_scale_is_the_best_one() {
        let truth = ramp(12, 12);
        let x = truth.mapv(|v| 3.0 + v.sqrt());
        let s = Moments::of(x.view(), truth.view()).unwrap().scale().unwrap();
        let at = |s| squared_error(x.view(), truth.view(), s);
        assert!(at(s) < at(s * 1.001) && at(s) < at(s * 0.999));
    }

    #[test]
    fn an_offset_counts() {
        let truth = ramp(16, 16);
        let f = compare(truth.mapv(|v| v + 100.0).view(), truth.view()).unwrap();
        assert!(f.nrmse > 0.2 && (f.pcc - 1.0).abs() < 1e-6);
    }

    #[test]
    fn nothing_reconstructed_is_an_error_of_one() {
        let f = compare(Array2::zeros((16, 16)).view(), ramp(16, 16).view()).unwrap();
        assert!((f.nrmse - 1.0).abs() < 1e-12 && f.pcc == 0.0 && f.scale == 0.0);
    }

    #[test]
    fn what_cannot_be_compared_is_refused() {
        let truth = ramp(16, 16);
        let refuse = |x: &Array2<f32>, t: &Array2<f32>| compare(x.view(), t.view()).unwrap_err();
        assert_eq!(refuse(&ramp(16, 17), &truth), MetricError::Shape { expected: (16, 16), found: (16, 17) });
        assert_eq!(refuse(&truth, &Array2::zeros((16, 16))), MetricError::DarkTruth);
        let mut bad = truth.clone();
        bad[[3, 4]] = f32::INFINITY;
        assert_eq!(refuse(&bad, &truth), MetricError::NotFinite { row: 3, col: 4, found: f32::INFINITY });
    }
}
