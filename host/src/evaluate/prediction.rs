//! How well a model predicts frames: against noise-free expectations where they are known, and against measured frames.
//!
//! Model and session may count light in different units, so a whole stack is judged after one free scale of the light above black;
//! for a model calibrated in the session's own unit it comes out as 1.

use super::metrics::{MetricError, Moments, squared_error};
use crate::noise::NoiseModel;
use ndarray::{Array2, ArrayView2, Zip};
use serde::{Deserialize, Serialize};

/// Pixels are *lit* where the expected signal exceeds this many times the read noise.
const LIT_READ_NOISES: f64 = 3.0;

/// How well a model predicts a stack of frames.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct PredictionFigures {
    /// Frames compared.
    pub frames: usize,
    /// The free scale of the predicted light.
    pub scale: f64,
    /// `||s p - e|| / ||e||` of the light above black, over all frames.
    pub nrmse: f64,
    /// Pearson correlation coefficient over all pixels of all frames.
    pub pcc: f64,
    /// Chi-squared per degree of freedom of the *measured* frames against the scaled prediction over lit pixels.
    pub chi2_ndf: f64,
    /// The same against the expected frames: what chi-squared is with a perfect model and this noise model; 0 where unknown.
    pub chi2_ndf_expected: f64,
    /// Lit pixels.
    pub lit_pixels: u64,
}

/// Frames of one scene, DN, each [sensor rows, sensor cols].
#[derive(Clone, Debug)]
pub struct Triple {
    /// As the model predicts it, black level included, noise-free.
    pub predicted: Array2<f32>,
    /// As it is truly expected, noise-free; None where only a measured frame exists.
    pub expected: Option<Array2<f32>>,
    /// As it was measured.
    pub measured: Array2<f32>,
}

/// Chi-squared of a measured frame against its expectation, and the lit pixels that it was summed over.
///
/// `chi2 = sum((y - mu)^2 / var(mu))`, variance from the model at the expectation, over pixels whose expected light exceeds
/// three times the read noise. Nothing is fitted, so the pixels are the degrees of freedom. `offset_dn` is the fixed pattern
/// relative to the black level: it is part of `mu` but makes no noise.
///
/// # Errors
/// Shapes differ.
pub fn chi_squared(
    measured_dn: ArrayView2<'_, f32>,
    expected_dn: ArrayView2<'_, f32>,
    sensor: Sensor<'_>,
) -> Result<(f64, u64), MetricError> {
    let same_shape = |found: (usize, usize)| match expected_dn.dim() {
        expected if expected == found => Ok(()),
        expected => Err(MetricError::Shape { expected, found }),
    };
    same_shape(measured_dn.dim())?;
    let dark = Array2::zeros((1, 1));
    let offset = match sensor.offset_dn {
        Some(map) => same_shape(map.dim()).map(|()| map.view())?,
        None => dark.broadcast(expected_dn.dim()).unwrap_or(dark.view()),
    };
    let noise = sensor.noise;
    let lit_dn = noise.black_level_dn + LIT_READ_NOISES * noise.read_noise_e * noise.gain_dn_per_e;
    Ok(Zip::from(measured_dn).and(expected_dn).and(offset).fold((0.0, 0), |(sum, n), &y, &mu, &offset| {
        let (y, mu, light) = (f64::from(y), f64::from(mu), f64::from(mu) - f64::from(offset));
        if light > lit_dn { (sum + (y - mu) * (y - mu) / noise.variance_dn2(light), n + 1) } else { (sum, n) }
    }))
}

/// What of a sensor the likelihood of a frame depends on.
#[derive(Clone, Copy, Debug)]
pub struct Sensor<'a> {
    /// Its noise.
    pub noise: &'a NoiseModel,
    /// Its fixed pattern relative to the black level, DN, [sensor rows, sensor cols]; None: none is known.
    pub offset_dn: Option<&'a Array2<f32>>,
}

/// The figures of a stack. `frame(i)` gives the i-th of `count` frames; it is called twice for each, so that memory holds one.
///
/// # Errors
/// A frame cannot be had, shapes differ, a value is no number, or all expectations are dark.
pub fn predict_figures(
    count: usize,
    sensor: Sensor<'_>,
    mut frame: impl FnMut(usize) -> anyhow::Result<Triple>,
) -> anyhow::Result<PredictionFigures> {
    let black = sensor.noise.black_level_dn as f32;
    let mut sums = Moments::default();
    for i in 0..count {
        let f = frame(i)?;
        let reference = f.expected.as_ref().unwrap_or(&f.measured);
        sums.add(&Moments::of((&f.predicted - black).view(), (reference - black).view())?);
    }
    let scale = sums.scale()?;
    let (mut error, mut model, mut truth, mut lit, mut lit_truth) = (0.0, 0.0, 0.0, 0u64, 0u64);
    for i in 0..count {
        let f = frame(i)?;
        let light = &f.predicted - black;
        let reference = f.expected.as_ref().unwrap_or(&f.measured);
        error += squared_error(light.view(), (reference - black).view(), scale);
        let scaled = light.mapv(|v| (f64::from(v) * scale) as f32 + black);
        let (chi, n) = chi_squared(f.measured.view(), scaled.view(), sensor)?;
        (model, lit) = (model + chi, lit + n);
        if let Some(expected) = &f.expected {
            let (chi, n) = chi_squared(f.measured.view(), expected.view(), sensor)?;
            (truth, lit_truth) = (truth + chi, lit_truth + n);
        }
    }
    Ok(PredictionFigures {
        frames: count,
        scale,
        nrmse: error.sqrt() / sums.reference_norm(),
        pcc: sums.pcc(),
        chi2_ndf: model / lit.max(1) as f64,
        chi2_ndf_expected: truth / lit_truth.max(1) as f64,
        lit_pixels: lit,
    })
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use crate::noise::Sources;
    use crate::rng;
    use rand_distr::{Distribution, Normal, Poisson};

    fn noise() -> NoiseModel {
        NoiseModel {
            black_level_dn: 64.0,
            gain_dn_per_e: 0.4,
            gain_sigma: 0.0,
            read_noise_e: 2.0,
            read_noise_sigma: 0.0,
            saturation_dn: 4095.0,
            sources: Sources::default(),
        }
    }

    fn sensor(noise: &NoiseModel) -> Sensor<'_> {
        Sensor { noise, offset_dn: None }
    }

    fn scene(i: usize) -> Triple {
        let noise = noise();
        let electrons = |r: usize, c: usize| 40.0 + (r * c) as f64 * 0.5;
        let expected = Array2::from_shape_fn((40, 50), |(r, c)| (64.0 + 0.4 * electrons(r, c)) as f32);
        let mut random = rng::stream(11, "prediction test", i as u64);
        let read = Normal::new(0.0, noise.read_noise_e).unwrap();
        let measured = Array2::from_shape_fn((40, 50), |(r, c)| {
            let e = Poisson::new(electrons(r, c)).unwrap().sample(&mut random) + read.sample(&mut random);
            (64.0 + 0.4 * e).round() as f32
        });
        Triple { predicted: expected.clone(), expected: Some(expected), measured }
    }

    #[test]
    fn a_perfect_model_has_chi_squared_one() {
        let f = predict_figures(5, sensor(&noise()), |i| Ok(scene(i))).unwrap();
        assert!((f.scale - 1.0).abs() < 1e-12 && f.nrmse < 1e-6 && f.pcc > 1.0 - 1e-9);
        // chi2/ndf of n pixels scatters by sqrt(2/n): 0.014 for 10,000.
        assert!(f.lit_pixels == 10_000 && (f.chi2_ndf - 1.0).abs() < 0.06, "{f:?}");
        assert!((f.chi2_ndf - f.chi2_ndf_expected).abs() < 1e-4);
    }

    #[test]
    fn a_wrong_model_shows_in_each_figure_and_a_wrong_unit_in_the_scale_alone() {
        let wrong = |i| {
            let mut t = scene(i);
            t.predicted.slice_mut(ndarray::s![..20, ..]).mapv_inplace(|v| 64.0 + (v - 64.0) * 1.2);
            Ok(t)
        };
        let f = predict_figures(2, sensor(&noise()), wrong).unwrap();
        assert!(f.nrmse > 0.02 && f.chi2_ndf > 1.2, "{f:?}");
        let unit = |i| {
            let mut t = scene(i);
            t.predicted.mapv_inplace(|v| 64.0 + (v - 64.0) * 4.0);
            Ok(t)
        };
        let f = predict_figures(2, sensor(&noise()), unit).unwrap();
        assert!((f.scale - 0.25).abs() < 1e-6 && f.nrmse < 1e-5, "{f:?}");
    }

    #[test]
    fn only_lit_pixels_count() {
        let expected = ndarray::array![[64.0f32, 66.3, 66.5]];
        let measured = ndarray::array![[164.0f32, 64.0, 66.5 + 1.0]];
        let (chi, n) = chi_squared(measured.view(), expected.view(), sensor(&noise())).unwrap();
        // Lit above 64 + 3 * 2 * 0.4 = 66.4 DN; there the variance is 0.4 * 2.5 + 0.64 + 1/12.
        assert!(n == 1 && (chi - 1.0 / (1.0 + 0.64 + 1.0 / 12.0)).abs() < 1e-5, "{chi} {n}");
    }

    #[test]
    fn a_fixed_pattern_makes_no_noise_and_no_light() {
        let noise = noise();
        let offset = ndarray::array![[10.0f32, 10.0]];
        let expected = ndarray::array![[74.0f32, 84.0]];
        let sensor = Sensor { noise: &noise, offset_dn: Some(&offset) };
        let (chi, n) = chi_squared((&expected + 1.0).view(), expected.view(), sensor).unwrap();
        // The first pixel is dark; the second has 10 DN of light: variance 0.4 * 10 + 0.64 + 1/12.
        assert!(n == 1 && (chi - 1.0 / (4.0 + 0.64 + 1.0 / 12.0)).abs() < 1e-9, "{chi} {n}");
        let wrong = Array2::zeros((3, 3));
        let sensor = Sensor { noise: &noise, offset_dn: Some(&wrong) };
        assert!(chi_squared(expected.view(), expected.view(), sensor).is_err());
    }
}
