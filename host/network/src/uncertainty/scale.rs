//! The scale of errors: the expected size of the error of a pixel from what is seen without the truth.
//!
//! `ln scale = b . q(f)`, where q are the features of [`super::observer`] in standard deviations, limited to the range
//! that was seen, their squares and their products. The coefficients are least squares of
//! `ln |truth - reconstruction|`. The scale need not be right: conformal calibration makes up for a wrong one, and only
//! widths grow by it.

use super::UncertaintyError;
use super::observer::PIXEL;
use ndarray::Array2;
use ommatidia_physics::linalg::symmetric_eigen;

/// Number of terms: constant, linear, squares and products.
pub(super) const TERMS: usize = 1 + PIXEL + PIXEL * (PIXEL + 1) / 2;

/// Share of the samples beyond the limits of a feature, on each side.
const BEYOND: f64 = 5e-4;

/// A fitted scale.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Scale {
    /// Mean, standard deviation, least and largest value of each feature.
    pub ranges: [[f32; 4]; PIXEL],
    /// Coefficients of the terms.
    pub coefficients: [f32; TERMS],
}

impl Scale {
    /// Fits a scale to samples: features of a pixel, and the size of its error, above 0.
    ///
    /// # Errors
    /// The samples hold values that are not finite.
    pub fn fit(samples: &[([f32; PIXEL], f32)]) -> Result<Self, UncertaintyError> {
        let mut scale = Self { ranges: ranges(samples), coefficients: [0.0; TERMS] };
        let mut normal = Array2::<f64>::zeros((TERMS, TERMS));
        let mut right = [0.0f64; TERMS];
        for (features, error) in samples {
            let (terms, wanted) = (scale.terms(features).map(f64::from), f64::from(error.ln()));
            for i in 0..TERMS {
                right[i] += terms[i] * wanted;
                for j in 0..=i {
                    normal[[i, j]] += terms[i] * terms[j];
                }
            }
        }
        // A little ridge: features that are alike share their coefficient.
        let ridge = 1e-4 * samples.len() as f64;
        (1..TERMS).for_each(|i| normal[[i, i]] += ridge);
        let eigen = symmetric_eigen(&normal)?;
        let floor = 1e-12 * eigen.values.iter().fold(0.0f64, |m, v| m.max(*v));
        for (k, value) in eigen.values.iter().enumerate().filter(|(_, v)| **v > floor) {
            let vector = eigen.vectors.column(k);
            let share = vector.iter().zip(&right).map(|(v, r)| v * r).sum::<f64>() / value;
            scale.coefficients.iter_mut().zip(vector).for_each(|(c, v)| *c += (share * v) as f32);
        }
        Ok(scale)
    }

    fn terms(&self, features: &[f32; PIXEL]) -> [f32; TERMS] {
        let mut z = [0.0f32; PIXEL];
        for ((z, f), [mean, sigma, low, high]) in z.iter_mut().zip(features).zip(self.ranges) {
            *z = (f.clamp(low, high) - mean) / sigma;
        }
        let mut terms = [1.0f32; TERMS];
        terms[1..=PIXEL].copy_from_slice(&z);
        let mut k = 1 + PIXEL;
        for i in 0..PIXEL {
            for j in 0..=i {
                terms[k] = z[i] * z[j];
                k += 1;
            }
        }
        terms
    }

    /// The scale of a pixel, in the unit of the errors that it was fitted to; finite and above 0.
    pub fn of(&self, features: &[f32; PIXEL]) -> f32 {
        let log: f32 = self.terms(features).iter().zip(&self.coefficients).map(|(t, c)| t * c).sum();
        log.clamp(-60.0, 60.0).exp()
    }
}

fn ranges(samples: &[([f32; PIXEL], f32)]) -> [[f32; 4]; PIXEL] {
    std::array::from_fn(|k| {
        let mut all: Vec<f32> = samples.iter().map(|(f, _)| f[k]).collect();
        all.sort_unstable_by(f32::total_cmp);
        let n = all.len().max(1) as f64;
        let mean = all.iter().map(|v| f64::from(*v)).sum::<f64>() / n;
        let variance = all.iter().map(|v| (f64::from(*v) - mean).powi(2)).sum::<f64>() / n;
        let beyond = (BEYOND * n) as usize;
        let (low, high) = (all.get(beyond), all.get((n as usize - 1).saturating_sub(beyond)));
        let [low, high] = [low, high].map(|v| v.copied().unwrap_or(0.0));
        [mean as f32, (variance.sqrt() as f32).max(1e-3), low, high]
    })
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use ommatidia_session::rng;
    use rand::RngExt;

    #[test]
    fn a_scale_that_is_a_product_of_powers_comes_back() {
        let mut rng = rng::stream(1, "scale", 0);
        let samples: Vec<_> = (0..4000)
            .map(|_| {
                let features: [f32; PIXEL] = std::array::from_fn(|_| rng.random_range(-2.0..2.0));
                (features, (0.5 * features[0] - 0.25 * features[3] * features[1] - 1.0).exp())
            })
            .collect();
        let scale = Scale::fit(&samples).unwrap();
        let inside = samples.iter().filter(|(f, _)| f.iter().all(|v| v.abs() < 1.9));
        for (features, error) in inside {
            assert!((scale.of(features) / error - 1.0).abs() < 0.02, "{} {error}", scale.of(features));
        }
    }

    #[test]
    fn features_beyond_what_was_seen_count_as_the_limit() {
        let samples: Vec<_> = (0..1000).map(|i| ([i as f32 / 1000.0; PIXEL], 1.0 + i as f32)).collect();
        let scale = Scale::fit(&samples).unwrap();
        assert_eq!(scale.of(&[1e6; PIXEL]), scale.of(&[2.0; PIXEL]));
        assert!(scale.of(&[-1e6; PIXEL]) > 0.0);
    }
}
