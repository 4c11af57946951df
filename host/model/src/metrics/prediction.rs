//! How well a model predicts frames: against noise-free expectations where they are known, and against measured frames.
//!
//! Model and session may count light in different units, so a whole stack is judged after one free scale of the light.
//! It acts on the light that falls on the sensor, before full scale clips it. The scale is 1 for a model that was
//! calibrated in the session's own unit.

use super::background::{FrameBackground, PlaneFit, add_background};
use super::figures::{MetricError, Moments, squared_error};
use super::frames::{FrameComparison, SensorNoise};
use super::residual::{ResidualRing, Rings, chi_squared, each, least_lit_dn};
use crate::slopes::{Slopes, slope_value};
use ndarray::Zip;
use serde::{Deserialize, Serialize};

/// How well a model predicts a stack of frames.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct PredictionFigures {
    /// Number of frames compared.
    pub frames: usize,
    /// The free scale of the predicted light.
    pub scale: f64,
    /// `||s p - e|| / ||e||` of the light above black over all frames: prediction p, reference e, scale s.
    pub nrmse: f64,
    /// Pearson correlation coefficient over all pixels of all frames.
    pub pcc: f64,
    /// Chi-squared per degree of freedom of the *measured* frames against the scaled prediction, over lit pixels.
    pub chi2_ndf: f64,
    /// The same against the noise-free expected frames: the value that a perfect optical model reaches with this noise
    /// model; 0 where expected frames are unknown.
    pub chi2_ndf_expected: f64,
    /// Number of lit pixels.
    pub lit_pixels: u64,
    /// The residual by distance from the centre of the sensor.
    #[serde(default)]
    pub by_radius: Vec<ResidualRing>,
    /// The background of the measured frames; None where too few pixels show it.
    #[serde(default)]
    pub background: Option<FrameBackground>,
}

/// Light, relative to the model's own, from which the fit of the scale begins where every lit pixel of the model's own
/// light clips.
const DIM: f64 = 1.0 / 1024.0;
/// The scale is fitted again until it changes by less than this fraction: pixels that no longer clip join the fit.
const SETTLED: f64 = 1e-5;
/// Most passes over the frames.
const PASSES: usize = 12;

/// A background whose level and slopes change by less than this, DN, is settled.
const SETTLED_DN: f64 = 1e-3;

/// The figures of a stack of `count` frames. `frame(i, light)` returns the i-th as predicted for `light` times the
/// model's own light: the sensor clips what is brighter than full scale, so the scale must act before the sensor does.
/// It is called twice or so for each frame, and memory holds one at a time.
///
/// A background that all frames share is fitted, and added to the prediction where it is significant: it says nothing
/// about the optics. Against expected frames, which need not have it, one of their own is fitted.
///
/// # Errors
/// `frame` fails, shapes differ, a value is not finite, or all expectations are 0.
pub fn prediction_figures(
    count: usize,
    sensor: SensorNoise<'_>,
    mut frame: impl FnMut(usize, f64) -> anyhow::Result<FrameComparison>,
) -> anyhow::Result<PredictionFigures> {
    let start = Free { scale: 1.0, measured_dn: [0.0; 3], reference_dn: [0.0; 3] };
    let (mut figures, free, found) = settled(start, false, (count, sensor), &mut frame)?;
    let Some(Plane { value_dn: plane_dn, sigma_dn, light_dn }) = found else { return Ok(figures) };
    let gain = sensor.noise.gain_dn_per_e;
    let mut background = FrameBackground {
        mean_e: plane_dn.map(|v| v / gain),
        sigma_e: sigma_dn.map(|v| v / gain),
        added: false,
        nrmse_without: figures.nrmse,
        chi2_ndf_without: figures.chi2_ndf,
    };
    if background.is_seen(sensor.noise.read_noise_e, light_dn / gain) {
        let (with, free, found) = settled(free, true, (count, sensor), &mut frame)?;
        background.mean_e = free.measured_dn.map(|v| v / gain);
        background.sigma_e = found.map_or(background.sigma_e, |p| p.sigma_dn.map(|v| v / gain));
        background.added = true;
        figures = with;
    }
    Ok(PredictionFigures { background: Some(background), ..figures })
}

/// What is fitted: the scale of the light, and the backgrounds of measured and of reference frames, DN.
#[derive(Clone, Copy, Debug)]
struct Free {
    scale: f64,
    measured_dn: Slopes,
    reference_dn: Slopes,
}

/// A plane, its standard errors, and the mean of the predicted light, DN.
#[derive(Clone, Copy, Debug)]
struct Plane {
    value_dn: Slopes,
    sigma_dn: Slopes,
    light_dn: f64,
}

impl Plane {
    fn of(fit: &PlaneFit) -> Option<Self> {
        let light_dn = fit.mean_light_dn();
        fit.plane().map(|(value_dn, sigma_dn)| Self { value_dn, sigma_dn, light_dn })
    }
}

/// Fits until nothing changes: the figures, what was fitted, and the background that the measured frames show beyond
/// it. Backgrounds stay as they are unless `with_background`.
fn settled(
    mut free: Free,
    with_background: bool,
    (count, sensor): (usize, SensorNoise<'_>),
    frame: &mut dyn FnMut(usize, f64) -> anyhow::Result<FrameComparison>,
) -> anyhow::Result<(PredictionFigures, Free, Option<Plane>)> {
    for _ in 1..PASSES {
        let Pass { figures, more, measured, reference } = figures_at(free, count, sensor, frame)?;
        let mut moved = 0.0f64;
        if with_background {
            for (plane, found) in [(&mut free.measured_dn, measured), (&mut free.reference_dn, reference)] {
                for (v, d) in plane.iter_mut().zip(found.map_or([0.0; 3], |p| p.value_dn)) {
                    *v += d;
                    moved = moved.max(d.abs());
                }
            }
        }
        match more {
            Some(more) if (more - 1.0).abs() < SETTLED && moved < SETTLED_DN => return Ok((figures, free, measured)),
            Some(more) => free.scale *= more,
            None if free.scale == 1.0 => free.scale = DIM,
            None => return Ok((figures, free, measured)),
        }
    }
    let Pass { figures, measured, .. } = figures_at(free, count, sensor, frame)?;
    Ok((figures, free, measured))
}

/// One pass over the frames.
struct Pass {
    figures: PredictionFigures,
    /// The factor by which the light of the frames differs from the scale; None where no pixel shows it.
    more: Option<f64>,
    /// The background of the measured frames beyond the one that was taken into account.
    measured: Option<Plane>,
    /// The same of what the prediction is judged against.
    reference: Option<Plane>,
}

fn figures_at(
    free: Free,
    count: usize,
    sensor: SensorNoise<'_>,
    frame: &mut dyn FnMut(usize, f64) -> anyhow::Result<FrameComparison>,
) -> anyhow::Result<Pass> {
    let (black, top) = (sensor.noise.black_level_dn as f32, sensor.noise.saturation_dn);
    let (mut sums, mut fit) = (Moments::default(), Moments::default());
    let (mut error, mut model, mut truth, mut lit, mut lit_truth) = (0.0, 0.0, 0.0, 0u64, 0u64);
    let mut rings: Option<Rings> = None;
    let mut planes = [PlaneFit::default(); 2];
    for i in 0..count {
        let f = frame(i, free.scale)?;
        let with = |plane: &Slopes| {
            let mut predicted = f.predicted.clone();
            if *plane != [0.0; 3] {
                add_background(&mut predicted, plane, top);
            }
            FrameComparison { predicted, ..f.clone() }
        };
        let judged = if f.expected.is_some() { with(&free.reference_dn) } else { with(&free.measured_dn) };
        let light = &judged.predicted - black;
        let reference = judged.reference() - black;
        sums.add(&Moments::of(light.view(), reference.view())?);
        let bare = if f.expected.is_some() { &free.reference_dn } else { &free.measured_dn };
        fit.add(&unclipped(&judged, bare, sensor)?);
        error += squared_error(light.view(), reference.view(), 1.0);
        planes[1].add(&judged, judged.reference().view(), sensor)?;
        let seen = with(&free.measured_dn);
        planes[0].add(&seen, seen.measured.view(), sensor)?;
        let rings = rings.get_or_insert_with(|| Rings::new(light.dim()));
        let dim = seen.predicted.dim();
        each(seen.measured.view(), seen.predicted.view(), sensor, |at, residual| {
            // Lit by the object: a background does not count.
            if residual.light_dn - slope_value(&free.measured_dn, dim, [at.0, at.1]) > least_lit_dn(sensor) {
                (model, lit) = (model + residual.chi2(), lit + 1);
                rings.add(at, &residual);
            }
        })?;
        if let Some(expected) = &f.expected {
            let chi2 = chi_squared(f.measured.view(), expected.view(), sensor)?;
            (truth, lit_truth) = (truth + chi2.sum, lit_truth + chi2.pixels);
        }
    }
    let figures = PredictionFigures {
        frames: count,
        scale: free.scale,
        nrmse: error.sqrt() / sums.reference_norm(),
        pcc: sums.pcc(),
        chi2_ndf: model / lit.max(1) as f64,
        chi2_ndf_expected: truth / lit_truth.max(1) as f64,
        lit_pixels: lit,
        by_radius: rings.map_or_else(Vec::new, |r| r.figures()),
        background: None,
    };
    sums.scale()?;
    let more = fit.scale().ok().filter(|more| *more > 0.0);
    Ok(Pass { figures, more, measured: Plane::of(&planes[0]), reference: Plane::of(&planes[1]) })
}

/// The sums from which the scale is fitted: light above black level, fixed pattern and `background_dn`, of pixels that
/// clip neither in the prediction nor in the reference.
fn unclipped(f: &FrameComparison, background_dn: &Slopes, sensor: SensorNoise<'_>) -> Result<Moments, MetricError> {
    let (black, top) = (sensor.noise.black_level_dn as f32, sensor.noise.saturation_dn as f32);
    let (mut light, mut reference) = (&f.predicted - black, f.reference() - black);
    if let Some(offset) = sensor.offset_dn.filter(|offset| offset.dim() == light.dim()) {
        light -= offset;
        reference -= offset;
    }
    if *background_dn != [0.0; 3] {
        let less = background_dn.map(|v| -v);
        add_background(&mut light, &less, f64::INFINITY);
        add_background(&mut reference, &less, f64::INFINITY);
    }
    let clips = |v: f32| v >= top - 0.5;
    Zip::from(&mut light).and(&mut reference).and(&f.predicted).and(f.reference()).for_each(|l, r, &p, &e| {
        if clips(p) || clips(e) {
            (*l, *r) = (0.0, 0.0);
        }
    });
    Moments::of(light.view(), reference.view())
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::super::residual::ChiSquared;
    use super::*;
    use ndarray::Array2;
    use ommatidia_physics::noise::NoiseModel;
    use ommatidia_session::rng;
    use rand_distr::{Distribution, Normal, Poisson};

    fn sensor(noise: &NoiseModel) -> SensorNoise<'_> {
        SensorNoise { noise, offset_dn: None, reading_dn2: None }
    }

    /// A scene whose model predicts `unit` times the light, at a light level.
    fn scene_in(unit: f64, i: usize, light: f64) -> FrameComparison {
        let mut f = scene(i);
        let noise = NoiseModel::nominal();
        f.predicted.mapv_inplace(|v| (64.0 + (v - 64.0) * (unit * light) as f32).min(noise.saturation_dn as f32));
        f
    }

    fn scene(i: usize) -> FrameComparison {
        let noise = NoiseModel::nominal();
        let electrons = |r: usize, c: usize| 40.0 + (r * c) as f64 * 0.5;
        let expected = Array2::from_shape_fn((40, 50), |(r, c)| (64.0 + 0.4 * electrons(r, c)) as f32);
        let mut random = rng::stream(11, "prediction test", i as u64);
        let read = Normal::new(0.0, noise.read_noise_e).unwrap();
        let measured = Array2::from_shape_fn((40, 50), |(r, c)| {
            let e = Poisson::new(electrons(r, c)).unwrap().sample(&mut random) + read.sample(&mut random);
            (64.0 + 0.4 * e).round() as f32
        });
        FrameComparison { predicted: expected.clone(), expected: Some(expected), measured }
    }

    #[test]
    fn a_perfect_model_has_chi_squared_one() {
        let f = prediction_figures(5, sensor(&NoiseModel::nominal()), |i, light| Ok(scene_in(1.0, i, light))).unwrap();
        assert!((f.scale - 1.0).abs() < 1e-5 && f.nrmse < 1e-5 && f.pcc > 1.0 - 1e-9);
        // chi2/ndf of n pixels scatters by sqrt(2/n): 0.014 for 10,000.
        // The rings share all lit pixels, and none shows a bias where there is none.
        assert_eq!(f.by_radius.iter().map(|r| r.pixels).sum::<u64>(), f.lit_pixels);
        assert!(f.by_radius.iter().all(|r| r.bias.abs() < 0.01), "{:?}", f.by_radius);
        assert!(f.lit_pixels == 10_000 && (f.chi2_ndf - 1.0).abs() < 0.06, "{f:?}");
        assert!((f.chi2_ndf - f.chi2_ndf_expected).abs() < 1e-4);
    }

    #[test]
    fn a_wrong_model_shows_in_each_figure_and_a_wrong_unit_in_the_scale_alone() {
        let wrong = |i, light| {
            let mut t = scene_in(1.0, i, light);
            t.predicted.slice_mut(ndarray::s![..20, ..]).mapv_inplace(|v| 64.0 + (v - 64.0) * 1.2);
            Ok(t)
        };
        let f = prediction_figures(2, sensor(&NoiseModel::nominal()), wrong).unwrap();
        assert!(f.nrmse > 0.02 && f.chi2_ndf > 1.2, "{f:?}");
        // At 50 times the light most of the frame clips, and the figures are those of the right unit.
        for unit in [4.0, 50.0] {
            let f = prediction_figures(2, sensor(&NoiseModel::nominal()), |i, l| Ok(scene_in(unit, i, l))).unwrap();
            assert!((f.scale * unit - 1.0).abs() < 1e-4 && f.nrmse < 1e-4 && f.chi2_ndf < 1.1, "{f:?}");
        }
    }

    /// Measured frames with a plane of light that neither prediction nor expectation has; half of them has no object.
    fn with_background(i: usize, light: f64, plane_e: Slopes, expected: bool) -> FrameComparison {
        let mut f = scene_in(1.0, i, light);
        let dim = f.measured.dim();
        let mut random = rng::stream(12, "background test", i as u64);
        for ((r, c), v) in f.measured.indexed_iter_mut() {
            let e: f64 = Poisson::new(slope_value(&plane_e, dim, [r, c])).unwrap().sample(&mut random);
            *v = (*v + (0.4 * e) as f32).round();
        }
        if !expected {
            f.expected = None;
        }
        f
    }

    #[test]
    fn a_background_of_the_measured_frames_is_fitted_and_is_no_fault_of_the_model() {
        let noise = NoiseModel::nominal();
        for expected in [true, false] {
            let plane = [12.0, 6.0, -9.0];
            let f = prediction_figures(6, sensor(&noise), |i, l| Ok(with_background(i, l, plane, expected))).unwrap();
            let b = f.background.unwrap();
            assert!(b.added && b.chi2_ndf_without > 1.2 && (f.chi2_ndf - 1.0).abs() < 0.06, "{f:?}");
            for ((found, sigma), want) in b.mean_e.iter().zip(&b.sigma_e).zip(plane) {
                assert!((found - want).abs() < 4.0 * sigma && *sigma < 1.0, "{b:?}");
            }
            assert!((f.scale - 1.0).abs() < 0.003, "{f:?}");
            assert!(if expected { f.nrmse < 0.003 } else { f.nrmse < b.nrmse_without }, "{f:?}");
        }
    }

    #[test]
    fn noise_makes_no_background() {
        let noise = NoiseModel::nominal();
        for seed in 0..12 {
            let f = prediction_figures(2, sensor(&noise), |i, l| Ok(scene_in(1.0, 100 * seed + i, l))).unwrap();
            let b = f.background.unwrap();
            assert!(!b.added && b.nrmse_without == f.nrmse, "{b:?}");
            let pulls: Vec<f64> = b.mean_e.iter().zip(&b.sigma_e).map(|(m, s)| (m / s).abs()).collect();
            assert!(pulls.iter().all(|p| *p < 4.5), "{pulls:?}");
        }
    }

    #[test]
    fn only_lit_pixels_count() {
        let expected = ndarray::array![[64.0f32, 66.3, 66.5]];
        let measured = ndarray::array![[164.0f32, 64.0, 66.5 + 1.0]];
        let ChiSquared { sum: chi, pixels: n } =
            chi_squared(measured.view(), expected.view(), sensor(&NoiseModel::nominal())).unwrap();
        // Lit above 64 + 3 * 2 * 0.4 = 66.4 DN; there the variance is 0.4 * 2.5 + 0.64 + 1/12.
        assert!(n == 1 && (chi - 1.0 / (1.0 + 0.64 + 1.0 / 12.0)).abs() < 1e-5, "{chi} {n}");
    }

    #[test]
    fn a_fixed_pattern_makes_no_noise_and_no_light() {
        let noise = NoiseModel::nominal();
        let offset = ndarray::array![[10.0f32, 10.0]];
        let expected = ndarray::array![[74.0f32, 84.0]];
        let sensor = SensorNoise { noise: &noise, offset_dn: Some(&offset), reading_dn2: None };
        let ChiSquared { sum: chi, pixels: n } =
            chi_squared((&expected + 1.0).view(), expected.view(), sensor).unwrap();
        // The first pixel is dark; the second has 10 DN of light: variance 0.4 * 10 + 0.64 + 1/12.
        assert!(n == 1 && (chi - 1.0 / (4.0 + 0.64 + 1.0 / 12.0)).abs() < 1e-9, "{chi} {n}");
        let wrong = Array2::zeros((3, 3));
        let sensor = SensorNoise { noise: &noise, offset_dn: Some(&wrong), reading_dn2: None };
        assert!(chi_squared(expected.view(), expected.view(), sensor).is_err());
    }
}
