//! Wiener deconvolution with the point-spread function of the whole array at the centre of the field.
//!
//! `X = conj(H) Y / (|H|^2 + K)` in frequency (N. Wiener, "Extrapolation, Interpolation, and Smoothing of Stationary
//! Time Series" (1949)): the best linear shift-invariant estimate. It uses every lens, but assumes that each images the
//! whole field as it images the centre. K is chosen on simulated scenes, never on those that the method is judged on.

use super::frame::frame_input;
use super::{MethodError, Reconstruct};
use ndarray::{Array2, ArrayView2, s};
use ommatidia_model::forward::Forward;
use ommatidia_model::instrument::Instrument;
use ommatidia_model::metrics::{Case, psnr};
use ommatidia_physics::fft2::{RealFft2, fast_size};
use ommatidia_physics::scene::SceneConfig;
use ommatidia_physics::sensor::{FrameError, FrameInput};
use ommatidia_session::rng;
use rayon::prelude::*;
use rustfft::num_complex::Complex32;
use serde::{Deserialize, Serialize};

/// Settings of the Wiener filter.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct WienerConfig {
    /// K relative to the mean of |H|^2; None: the value with the highest PSNR on simulated scenes.
    pub relative_k: Option<f64>,
}

/// Number of simulated scenes that K is chosen on.
const SCENES: u64 = 12;
/// Every third of them serves for the coarse scan.
const THIRD: usize = 3;
/// Most steps from the best value of the coarse scan to that of all scenes.
const MOVES: usize = 4;

impl WienerConfig {
    /// Plans the filter for an instrument, with the PSF of its model at the centre of the object.
    ///
    /// Where K is not given, it is chosen on synthetic scenes. The instrument's own model and noise make their frames,
    /// with brightest pixels between a tenth and four fifths of full scale; `seed` draws scenes and noise.
    ///
    /// # Errors
    /// The instrument's model cannot be planned, its PSF holds no light, or K is not a positive number.
    pub fn build(&self, instrument: &Instrument, seed: u64) -> anyhow::Result<Wiener> {
        let forward = Forward::new(instrument)?;
        let grid = &instrument.manifest.object;
        let source = [grid.rows / 2, grid.cols / 2];
        let mut point = Array2::zeros((grid.rows, grid.cols));
        point[source] = 1.0;
        let psf_dn = forward.operator().apply(point.view())?;
        let setup = WienerSetup { object: [grid.rows, grid.cols], source, relative_k: self.relative_k.unwrap_or(0.1) };
        let filter = Wiener::new(frame_input(instrument)?, psf_dn.view(), setup)?;
        if self.relative_k.is_some() {
            return Ok(filter);
        }
        let scenes = SceneConfig::default().build()?;
        let cx = forward.context();
        // Without effects the light is linear in the object: it need not be computed again.
        let linear = instrument.effects.is_empty();
        let case = |i: u64| -> anyhow::Result<Option<Case>> {
            let mut object = scenes.draw(grid, seed, "wiener", i);
            let mut light_e = forward.expected_e(object.view(), &cx)?;
            let peak_e = light_e.iter().fold(0.0f32, |m, &v| m.max(v));
            if peak_e <= 0.0 {
                return Ok(None);
            }
            let full_scale = 0.1 + 0.7 * i as f64 / (SCENES - 1) as f64;
            let factor = (full_scale * cx.full_scale_e / f64::from(peak_e)) as f32;
            object.mapv_inplace(|v| v * factor);
            if linear {
                light_e.mapv_inplace(|v| v * factor);
            } else {
                light_e = forward.expected_e(object.view(), &cx)?;
            }
            let frame_dn = forward.draw_dn(light_e, &cx, &mut rng::stream(seed, "wiener noise", i));
            Ok(Some(Case { frame_dn, truth: object }))
        };
        let cases = (0..SCENES).filter_map(|i| case(i).transpose()).collect::<anyhow::Result<Vec<_>>>()?;
        filter.tuned(&cases)
    }
}

/// Geometry and regularisation of a Wiener filter.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct WienerSetup {
    /// Rows and columns of the object, pixels.
    pub object: [usize; 2],
    /// Object pixel, [row, col], whose point-spread function the filter uses.
    pub source: [usize; 2],
    /// K relative to the mean of |H|^2, > 0.
    pub relative_k: f64,
}

/// The planned filter.
#[derive(Clone, Debug)]
pub struct Wiener {
    input: FrameInput,
    fft: RealFft2,
    /// Spectrum H of the array's PSF.
    transfer: Vec<Complex32>,
    /// Mean of |H|^2: the unit of K.
    mean_power: f64,
    setup: WienerSetup,
}

impl Wiener {
    /// Plans the filter from the array's point-spread function: the light, DN, [sensor rows, sensor cols], of a unit
    /// source at object pixel `setup.source`.
    ///
    /// # Errors
    /// The PSF has another shape than the sensor or holds no light, or K is not a positive number.
    pub fn new(input: FrameInput, psf_dn: ArrayView2<'_, f32>, setup: WienerSetup) -> Result<Self, MethodError> {
        let (expected, found) = (input.shape(), [psf_dn.nrows(), psf_dn.ncols()]);
        if found != expected {
            return Err(MethodError::PsfShape { expected, found });
        }
        if !(setup.relative_k > 0.0 && setup.relative_k.is_finite()) {
            return Err(MethodError::Regularisation(setup.relative_k));
        }
        // Room for the object beyond the sensor, so that one side of the field does not wrap round to the other.
        let [rows, cols] = [0, 1].map(|axis| fast_size(expected[axis] + setup.object[axis]));
        let fft = RealFft2::new(rows, cols);
        let transfer = padded_spectrum(&fft, psf_dn);
        let mean_power = transfer.iter().map(|h| f64::from(h.norm_sqr())).sum::<f64>() / transfer.len() as f64;
        if !(mean_power > 0.0 && mean_power.is_finite()) {
            return Err(MethodError::DarkPsf);
        }
        Ok(Self { input, fft, transfer, mean_power, setup })
    }

    /// K in units of the mean of |H|^2.
    pub fn relative_k(&self) -> f64 {
        self.setup.relative_k
    }

    /// The same filter with the K that gives the highest mean PSNR on `cases`: a scan in half decades from 1e-5 to 1e2
    /// on every third case, then the vertex of the parabola through the best value and its neighbours on all cases, on
    /// a logarithmic scale.
    ///
    /// # Errors
    /// There are no cases, or one does not fit the sensor or the object.
    pub fn tuned(mut self, cases: &[Case]) -> anyhow::Result<Self> {
        anyhow::ensure!(
            !cases.is_empty(),
            "expected at least one scene to choose the Wiener filter's K on, found none"
        );
        let spectra = cases
            .par_iter()
            .map(|case| Ok((self.spectrum(case.frame_dn.view())?, &case.truth)))
            .collect::<Result<Vec<_>, FrameError>>()?;
        let mean_psnr = |log_k: f64, every: usize| -> anyhow::Result<f64> {
            let used: Vec<_> = spectra.iter().step_by(every).collect();
            let one = |(spectrum, object): &&(Vec<Complex32>, &Array2<f32>)| {
                psnr(self.solve(spectrum, 10f64.powf(log_k)).view(), object.view())
            };
            let each = used.par_iter().map(one).collect::<Result<Vec<_>, _>>()?;
            Ok(each.iter().sum::<f64>() / each.len() as f64)
        };
        let mut best = (f64::NEG_INFINITY, 0.0);
        for step in 0..15 {
            let log_k = -5.0 + 0.5 * f64::from(step);
            best = match mean_psnr(log_k, THIRD)? {
                psnr if psnr > best.0 => (psnr, log_k),
                _ => best,
            };
        }
        let log_k = vertex(|log_k| mean_psnr(log_k, 1), best.1, 0.5)?;
        self.setup.relative_k = 10f64.powf(log_k);
        Ok(self)
    }

    fn spectrum(&self, frame_dn: ArrayView2<'_, f32>) -> Result<Vec<Complex32>, FrameError> {
        Ok(padded_spectrum(&self.fft, self.input.light_dn(frame_dn)?.view()))
    }

    /// The spectrum of X from the spectrum of Y.
    fn filter(&self, frame: &[Complex32], relative_k: f64) -> Vec<Complex32> {
        let k = (relative_k * self.mean_power) as f32;
        frame.iter().zip(&self.transfer).map(|(y, h)| h.conj() * y / (h.norm_sqr() + k)).collect()
    }

    fn solve(&self, frame: &[Complex32], relative_k: f64) -> Array2<f32> {
        let image = image_of(&self.fft, self.filter(frame, relative_k));
        // Frame = object convolved with the PSF of pixel `source`: object pixel r lies at r - source, modulo the
        // period.
        let [rows, cols] = self.fft.shape();
        let at = |i: usize, source: usize, period: usize| (i + period - source) % period;
        let WienerSetup { object, source, .. } = self.setup;
        Array2::from_shape_fn((object[0], object[1]), |(r, c)| {
            image[[at(r, source[0], rows), at(c, source[1], cols)]].max(0.0)
        })
    }
}

impl Reconstruct for Wiener {
    fn name(&self) -> &str {
        "wiener"
    }

    fn reconstruct(&self, frame_dn: ArrayView2<'_, f32>) -> anyhow::Result<Array2<f32>> {
        Ok(self.solve(&self.spectrum(frame_dn)?, self.setup.relative_k))
    }
}

/// The spectrum of an image that is zero-padded at its far sides to the planned size.
fn padded_spectrum(fft: &RealFft2, image: ArrayView2<'_, f32>) -> Vec<Complex32> {
    let mut padded = Array2::zeros(fft.shape());
    padded.slice_mut(s![..image.nrows(), ..image.ncols()]).assign(&image);
    let mut spectrum = vec![Complex32::default(); fft.spectrum_len()];
    fft.forward(&padded.into_raw_vec_and_offset().0, &mut spectrum, &mut fft.scratch());
    spectrum
}

/// The image of a spectrum, normalised.
fn image_of(fft: &RealFft2, spectrum: Vec<Complex32>) -> Array2<f32> {
    let [rows, cols] = fft.shape();
    let norm = 1.0 / (rows * cols) as f32;
    let mut image = vec![0.0; rows * cols];
    fft.inverse(&spectrum, &mut image, &mut fft.scratch());
    Array2::from_shape_fn((rows, cols), |(r, c)| image[r * cols + c] * norm)
}

/// Position of the maximum of a function with one peak near `at`: the vertex of the parabola through it and two values
/// `step` away. Where one of the neighbours is higher, it moves there first.
fn vertex(f: impl Fn(f64) -> anyhow::Result<f64>, mut at: f64, step: f64) -> anyhow::Result<f64> {
    let [mut low, mut middle, mut high] = [f(at - step)?, f(at)?, f(at + step)?];
    for _ in 0..MOVES {
        if low > middle && low >= high {
            (at, high, middle) = (at - step, middle, low);
            low = f(at - step)?;
        } else if high > middle {
            (at, low, middle) = (at + step, middle, high);
            high = f(at + step)?;
        } else {
            break;
        }
    }
    let bend = low - 2.0 * middle + high;
    let off = if bend < 0.0 { (0.5 * (low - high) / bend).clamp(-1.0, 1.0) } else { 0.0 };
    Ok(at + off * step)
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use ommatidia_model::metrics::compare;
    use ommatidia_physics::sensor::SensorMaps;
    use rand::RngExt;
    use rand_distr::{Distribution, Normal};

    const SOURCE: [usize; 2] = [8, 8];

    /// A PSF with three unequal blurred foci: the light of a unit source at object pixel SOURCE.
    fn psf() -> Array2<f32> {
        let mut psf = Array2::zeros((64, 64));
        for (row, col, weight) in [(14, 14, 1.0f32), (31, 30, 0.8), (45, 47, 0.6)] {
            for (dr, dc, w) in [(0, 0, 0.5), (0, 1, 0.125), (1, 0, 0.125), (0, -1, 0.125), (-1, 0, 0.125)] {
                psf[[(row + dr) as usize, (col + dc) as usize]] += weight * w as f32;
            }
        }
        psf
    }

    fn object(seed: u64) -> Array2<f32> {
        let mut random = rng::stream(seed, "wiener test", 0);
        let mut object = Array2::zeros((16, 16));
        for _ in 0..12 {
            object[[random.random_range(0..16), random.random_range(0..16)]] += random.random_range(50.0..200.0f32);
        }
        object
    }

    /// The convolution as it is defined, on a black level of 64 DN.
    fn frame(object: &Array2<f32>, noise_dn: f64, seed: u64) -> Array2<f32> {
        let (psf, mut frame) = (psf(), Array2::from_elem((64, 64), 64.0f32));
        for ((r, c), &o) in object.indexed_iter() {
            for ((p, q), &h) in psf.indexed_iter().filter(|(_, h)| **h > 0.0) {
                frame[[p + r - SOURCE[0], q + c - SOURCE[1]]] += o * h;
            }
        }
        let (mut random, normal) =
            (rng::stream(seed, "wiener noise", 0), Normal::new(0.0, noise_dn.max(1e-9)).unwrap());
        frame.mapv(|v| v + normal.sample(&mut random) as f32)
    }

    fn wiener(relative_k: f64) -> Wiener {
        planned(psf(), relative_k).unwrap()
    }

    fn planned(psf_dn: Array2<f32>, relative_k: f64) -> Result<Wiener, MethodError> {
        let input = FrameInput::new(64.0, SensorMaps::default(), [64, 64]).unwrap();
        Wiener::new(input, psf_dn.view(), WienerSetup { object: [16, 16], source: SOURCE, relative_k })
    }

    #[test]
    fn a_shift_invariant_scene_without_noise_comes_back() {
        let truth = object(1);
        let found = wiener(1e-6).reconstruct(frame(&truth, 0.0, 1).view()).unwrap();
        let figures = compare(found.view(), truth.view()).unwrap();
        assert!(figures.nrmse < 0.01 && (figures.scale - 1.0).abs() < 0.01, "{figures:?}");
    }

    #[test]
    fn it_equals_the_closed_form_solution_of_its_least_squares_problem() {
        // X minimises ||H X - Y||^2 + K ||X||^2, so H'(H X - Y) + K X = 0 in every pixel of the period.
        let w = wiener(0.1);
        let y = w.spectrum(frame(&object(2), 1.0, 2).view()).unwrap();
        let k = (0.1 * w.mean_power) as f32;
        let x = w.filter(&y, 0.1);
        let gradient = x.iter().zip(&w.transfer).zip(&y).map(|((x, h), y)| h.conj() * (h * x - y) + x * k).collect();
        let scale = image_of(&w.fft, x).iter().fold(0.0f32, |m, v| m.max(v.abs())) * k;
        assert!(image_of(&w.fft, gradient).iter().all(|g| g.abs() < 1e-4 * scale));
    }

    #[test]
    fn the_tuned_k_is_near_the_best_on_other_scenes_and_grows_with_noise() {
        let cases = |noise, first| -> Vec<Case> {
            let case = |i| Case { frame_dn: frame(&object(i), noise, i), truth: object(i) };
            (first..first + 4).map(case).collect()
        };
        let psnr = |w: &Wiener, cases: &[Case]| -> f64 {
            let one = |e: &Case| compare(w.reconstruct(e.frame_dn.view()).unwrap().view(), e.truth.view()).unwrap();
            cases.iter().map(|e| one(e).psnr_db).sum::<f64>() / cases.len() as f64
        };
        let (quiet, loud) = (wiener(1.0).tuned(&cases(1.0, 10)).unwrap(), wiener(1.0).tuned(&cases(20.0, 10)).unwrap());
        assert!(loud.relative_k() > 3.0 * quiet.relative_k(), "{} {}", loud.relative_k(), quiet.relative_k());
        let others = cases(20.0, 50);
        let best = (0..30).map(|i| psnr(&wiener(10f64.powf(-4.0 + 0.2 * f64::from(i))), &others)).fold(0.0, f64::max);
        assert!(psnr(&loud, &others) > best - 0.3, "{} {best}", psnr(&loud, &others));
    }

    #[test]
    fn the_vertex_of_a_parabola_is_found_from_anywhere_near() {
        for start in [-1.0, 0.0, 0.5, 1.5] {
            let found = vertex(|x| Ok(-3.0 * (x - 0.3f64).powi(2)), start, 0.5).unwrap();
            assert!((found - 0.3).abs() < 1e-9, "{start}: {found}");
        }
        assert_eq!(vertex(|_| Ok(1.0), 0.5, 0.5).unwrap(), 0.5);
    }

    #[test]
    fn bad_configurations_are_refused() {
        let k = |k| planned(psf(), k).map(|_| ()).unwrap_err();
        assert!(
            matches!(k(0.0), MethodError::Regularisation(_)) && matches!(k(f64::NAN), MethodError::Regularisation(_))
        );
        assert!(matches!(planned(Array2::zeros((64, 64)), 1.0), Err(MethodError::DarkPsf)));
        assert!(matches!(planned(psf().slice_move(s![.., 1..]), 1.0), Err(MethodError::PsfShape { .. })));
    }
}
