//! Structural similarity.
//!
//! Z. Wang, A. C. Bovik, H. R. Sheikh, E. P. Simoncelli, "Image quality assessment: from error visibility to structural
//! similarity", IEEE Trans. Image Process. 13, 600 (2004), Eq. 13-16: an 11 x 11 circular Gaussian window of standard
//! deviation 1.5 pixels, normalised to unit sum, K1 = 0.01, K2 = 0.03, and the mean over all positions at which the
//! window lies wholly inside the image.

use ndarray::{Array2, ArrayView2, Zip};
use thiserror::Error;

/// Side of the window, pixels.
pub const WINDOW: usize = 11;
const SIGMA_PX: f64 = 1.5;
const K1: f64 = 0.01;
const K2: f64 = 0.03;

/// Why the structural similarity cannot be computed.
#[derive(Clone, Copy, Debug, PartialEq, Error)]
pub enum SsimError {
    /// The images are smaller than the window; rows and columns.
    #[error("the structural similarity needs images of at least {WINDOW} x {WINDOW} pixels, found {0} x {1}")]
    TooSmall(usize, usize),
}

/// Mean structural similarity of two images of the same shape, [rows, cols]; `range` is the data range L of the paper.
///
/// # Errors
/// The images are smaller than the 11 x 11 window.
///
/// # Panics
/// The shapes differ; [`compare`](crate::metrics::compare) checks them first.
pub fn ssim(x: ArrayView2<'_, f32>, y: ArrayView2<'_, f32>, range: f64) -> Result<f64, SsimError> {
    let (rows, cols) = x.dim();
    if rows < WINDOW || cols < WINDOW {
        return Err(SsimError::TooSmall(rows, cols));
    }
    let (x, y) = (x.mapv(f64::from), y.mapv(f64::from));
    let (mean_x, mean_y) = (smooth(&x), smooth(&y));
    let (xx, yy, xy) = (smooth(&(&x * &x)), smooth(&(&y * &y)), smooth(&(&x * &y)));
    let (c1, c2) = ((K1 * range).powi(2), (K2 * range).powi(2));
    let mut sum = 0.0;
    Zip::from(&mean_x).and(&mean_y).and(&xx).and(&yy).and(&xy).for_each(|&mx, &my, &xx, &yy, &xy| {
        let (vx, vy, cov) = (xx - mx * mx, yy - my * my, xy - mx * my);
        sum += (2.0 * mx * my + c1) * (2.0 * cov + c2) / ((mx * mx + my * my + c1) * (vx + vy + c2));
    });
    Ok(sum / mean_x.len() as f64)
}

/// The window along one axis: it is separable, the outer product of this vector with itself.
fn gaussian() -> [f64; WINDOW] {
    let half = (WINDOW / 2) as f64;
    let raw: [f64; WINDOW] = std::array::from_fn(|i| (-0.5 * ((i as f64 - half) / SIGMA_PX).powi(2)).exp());
    let sum: f64 = raw.iter().sum();
    raw.map(|v| v / sum)
}

/// Weighted mean in the window at each position where it fits inside the image: [rows - 10, cols - 10].
fn smooth(image: &Array2<f64>) -> Array2<f64> {
    let (rows, cols) = image.dim();
    let weights = gaussian();
    let along = |line: &dyn Fn(usize) -> f64| weights.iter().enumerate().map(|(k, w)| w * line(k)).sum::<f64>();
    let wide = Array2::from_shape_fn((rows, cols - WINDOW + 1), |(r, c)| along(&|k| image[[r, c + k]]));
    Array2::from_shape_fn((rows - WINDOW + 1, cols - WINDOW + 1), |(r, c)| along(&|k| wide[[r + k, c]]))
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use crate::rng;
    use rand::RngExt;

    /// Eq. 13-16 as they stand: an explicit 2-D window, two passes (mean, then central moments) at each position.
    fn naive(x: &Array2<f32>, y: &Array2<f32>, range: f64) -> f64 {
        let mut window = Array2::from_shape_fn((11, 11), |(r, c)| {
            let (dr, dc) = (r as f64 - 5.0, c as f64 - 5.0);
            (-(dr * dr + dc * dc) / (2.0 * 1.5 * 1.5)).exp()
        });
        window /= window.sum();
        let (c1, c2) = ((0.01 * range).powi(2), (0.03 * range).powi(2));
        let (mut sum, mut n) = (0.0, 0.0);
        for r0 in 0..=x.nrows() - 11 {
            for c0 in 0..=x.ncols() - 11 {
                let at = |a: &Array2<f32>, r: usize, c: usize| f64::from(a[[r0 + r, c0 + c]]);
                let (mut mx, mut my) = (0.0, 0.0);
                for ((r, c), w) in window.indexed_iter() {
                    mx += w * at(x, r, c);
                    my += w * at(y, r, c);
                }
                let (mut vx, mut vy, mut cov) = (0.0, 0.0, 0.0);
                for ((r, c), w) in window.indexed_iter() {
                    let (dx, dy) = (at(x, r, c) - mx, at(y, r, c) - my);
                    vx += w * dx * dx;
                    vy += w * dy * dy;
                    cov += w * dx * dy;
                }
                sum += (2.0 * mx * my + c1) * (2.0 * cov + c2) / ((mx * mx + my * my + c1) * (vx + vy + c2));
                n += 1.0;
            }
        }
        sum / n
    }

    #[test]
    fn even_images_leave_the_luminance_term() {
        let (a, b) = (Array2::from_elem((11, 14), 0.2f32), Array2::from_elem((11, 14), 0.5f32));
        let c1 = 1e-4;
        let expected = (2.0 * 0.2 * 0.5 + c1) / (0.2 * 0.2 + 0.5 * 0.5 + c1);
        assert!((ssim(a.view(), b.view(), 1.0).unwrap() - expected).abs() < 1e-7);
    }

    #[test]
    fn an_inverted_pattern_has_negative_structure() {
        // A checkerboard about zero and its negative: both means vanish up to the window's response g at the highest
        // frequency, so SSIM = (c2 - 2 v)/(c2 + 2 v) with v = 1 to within that response.
        let a = Array2::from_shape_fn((30, 30), |(r, c)| if (r + c) % 2 == 0 { 1.0f32 } else { -1.0 });
        let c2 = (0.03f64 * 2.0).powi(2);
        let found = ssim(a.view(), a.mapv(|v| -v).view(), 2.0).unwrap();
        assert!((found - (c2 - 2.0) / (c2 + 2.0)).abs() < 1e-3, "{found}");
    }

    #[test]
    fn equals_the_definition() {
        let mut random = rng::stream(3, "ssim", 0);
        let x = Array2::from_shape_fn((23, 17), |_| random.random::<f32>());
        let y = Array2::from_shape_fn((23, 17), |(r, c)| 0.7 * x[[r, c]] + 0.3 * random.random::<f32>());
        let (found, expected) = (ssim(x.view(), y.view(), 0.9).unwrap(), naive(&x, &y, 0.9));
        assert!((found - expected).abs() < 1e-11, "{found} {expected}");
        assert!(expected > 0.3 && expected < 0.95, "the case must not be trivial: {expected}");
    }

    #[test]
    fn it_is_symmetric_and_one_for_equals() {
        let mut random = rng::stream(4, "ssim", 0);
        let x = Array2::from_shape_fn((20, 20), |_| random.random::<f32>());
        let y = Array2::from_shape_fn((20, 20), |_| random.random::<f32>());
        assert_eq!(ssim(x.view(), y.view(), 1.0), ssim(y.view(), x.view(), 1.0));
        assert!((ssim(x.view(), x.view(), 1.0).unwrap() - 1.0).abs() < 1e-12);
    }

    #[test]
    fn small_images_are_refused() {
        let a = Array2::zeros((10, 30));
        assert_eq!(ssim(a.view(), a.view(), 1.0), Err(SsimError::TooSmall(10, 30)));
    }
}
