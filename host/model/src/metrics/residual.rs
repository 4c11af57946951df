//! The residual of single pixels: measured minus expected, against the noise, summed over lit pixels and over rings.

use super::figures::MetricError;
use super::frames::SensorNoise;
use ndarray::{Array2, ArrayView2, Zip};
use serde::{Deserialize, Serialize};

/// Pixels are *lit* where the expected signal exceeds this many times the read noise.
const LIT_READ_NOISES: f64 = 3.0;

/// The residual of the lit pixels in one ring around the centre of the sensor.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct ResidualRing {
    /// Inner radius, px.
    pub inner_px: f64,
    /// Outer radius, px.
    pub outer_px: f64,
    /// Number of lit pixels.
    pub pixels: u64,
    /// Chi-squared per degree of freedom of the measured frames against the prediction; 0 without lit pixels.
    pub chi2_ndf: f64,
    /// Mean of (measured - predicted) relative to the mean light of the ring; 0 without lit pixels.
    pub bias: f64,
}

/// Number of rings between the centre of the sensor and its corner.
const RINGS: usize = 8;

/// Sums over the lit pixels of each ring.
pub(super) struct Rings {
    /// Of each ring: light above black, (measured - predicted), chi-squared, number of pixels.
    sums: Vec<[f64; 4]>,
    width_px: f64,
    centre: [f64; 2],
}

impl Rings {
    pub(super) fn new((rows, cols): (usize, usize)) -> Self {
        let centre = [rows, cols].map(|n| (n as f64 - 1.0) / 2.0);
        let corner = centre[0].hypot(centre[1]) + 0.5;
        Self { sums: vec![[0.0; 4]; RINGS], width_px: corner / RINGS as f64, centre }
    }

    pub(super) fn add(&mut self, (r, c): (usize, usize), residual: &Residual) {
        let radius = (r as f64 - self.centre[0]).hypot(c as f64 - self.centre[1]);
        let ring = ((radius / self.width_px) as usize).min(RINGS - 1);
        let values = [residual.light_dn, residual.off_dn, residual.chi2(), 1.0];
        self.sums[ring].iter_mut().zip(values).for_each(|(sum, v)| *sum += v);
    }

    pub(super) fn figures(&self) -> Vec<ResidualRing> {
        let ring = |(i, [light, off, chi2, pixels]): (usize, &[f64; 4])| ResidualRing {
            inner_px: i as f64 * self.width_px,
            outer_px: (i + 1) as f64 * self.width_px,
            pixels: *pixels as u64,
            chi2_ndf: chi2 / pixels.max(1.0),
            bias: if *light > 0.0 { off / light } else { 0.0 },
        };
        self.sums.iter().enumerate().map(ring).collect()
    }
}

/// A measured pixel against its expectation.
pub(super) struct Residual {
    /// Expected light above black and offset, DN.
    pub light_dn: f64,
    /// Measured minus expected, DN.
    pub off_dn: f64,
    /// Variance of the noise model, DN^2.
    variance_dn2: f64,
}

impl Residual {
    pub(super) fn chi2(&self) -> f64 {
        self.off_dn * self.off_dn / self.variance_dn2
    }
}

/// Chi-squared and the pixels that it was summed over.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct ChiSquared {
    /// `sum((y - mu)^2 / var(mu))`.
    pub sum: f64,
    /// Number of pixels summed over: the degrees of freedom where nothing is fitted.
    pub pixels: u64,
}

/// Chi-squared of a measured frame against its expectation over lit pixels; both DN, [sensor rows, sensor cols].
///
/// `chi2 = sum((y - mu)^2 / var(mu))` with the variance of the noise model at the expectation, over pixels whose
/// expected light exceeds three times the read noise. The fixed pattern of `sensor` is part of `mu` but adds no photon
/// noise.
///
/// # Errors
/// The shapes differ.
pub fn chi_squared(
    measured_dn: ArrayView2<'_, f32>,
    expected_dn: ArrayView2<'_, f32>,
    sensor: SensorNoise<'_>,
) -> Result<ChiSquared, MetricError> {
    let mut chi2 = ChiSquared::default();
    each_lit(measured_dn, expected_dn, sensor, |_, residual| {
        chi2.sum += residual.chi2();
        chi2.pixels += 1;
    })?;
    Ok(chi2)
}

/// Light above which a pixel is lit, DN.
pub(super) fn least_lit_dn(sensor: SensorNoise<'_>) -> f64 {
    LIT_READ_NOISES * sensor.noise.read_noise_e * sensor.noise.gain_dn_per_e
}

/// Calls `take` with the position and the residual of each lit pixel.
fn each_lit(
    measured_dn: ArrayView2<'_, f32>,
    expected_dn: ArrayView2<'_, f32>,
    sensor: SensorNoise<'_>,
    mut take: impl FnMut((usize, usize), Residual),
) -> Result<(), MetricError> {
    each(measured_dn, expected_dn, sensor, |at, residual| {
        if residual.light_dn > least_lit_dn(sensor) {
            take(at, residual);
        }
    })
}

/// Calls `take` with the position and the residual of each pixel.
pub(super) fn each(
    measured_dn: ArrayView2<'_, f32>,
    expected_dn: ArrayView2<'_, f32>,
    sensor: SensorNoise<'_>,
    mut take: impl FnMut((usize, usize), Residual),
) -> Result<(), MetricError> {
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
    if let Some(map) = sensor.reading_dn2 {
        same_shape(map.dim())?;
    }
    let noise = sensor.noise;
    Zip::indexed(measured_dn).and(expected_dn).and(offset).for_each(|at, &y, &mu, &offset| {
        let level_dn = f64::from(mu) - f64::from(offset);
        let (light_dn, off_dn) = (level_dn - noise.black_level_dn, f64::from(y) - f64::from(mu));
        take(at, Residual { light_dn, off_dn, variance_dn2: sensor.variance_dn2(at, level_dn) });
    });
    Ok(())
}

/// `(measured - expected)` of each pixel in standard deviations of the noise model at the expectation; frames and
/// result [sensor rows, sensor cols].
///
/// # Errors
/// The shapes differ.
pub fn in_sigmas(
    measured_dn: ArrayView2<'_, f32>,
    expected_dn: ArrayView2<'_, f32>,
    sensor: SensorNoise<'_>,
) -> Result<Array2<f32>, MetricError> {
    let mut out = Array2::zeros(expected_dn.dim());
    each(measured_dn, expected_dn, sensor, |at, r| out[at] = (r.off_dn / r.variance_dn2.sqrt()) as f32)?;
    Ok(out)
}
