//! Wiener deconvolution with the point-spread function of the whole array at the field's centre.
//!
//! In closed form, `X = conj(H) Y / (|H|^2 + K)`: the best linear shift-invariant answer. It knows every lens, and pretends that
//! each shows the whole field as it shows the centre. K is chosen on simulated scenes, never on those that it is judged on.

use super::frame::FrameCorrection;
use super::{MethodError, Reconstruct};
use crate::evaluate::compare;
use crate::fft2::{RealFft2, fast_size};
use crate::forward::Forward;
use crate::instrument::Instrument;
use crate::rng;
use crate::scene::SceneConfig;
use ndarray::{Array2, ArrayView2, s};
use rustfft::num_complex::Complex32;
use serde::{Deserialize, Serialize};

/// How strongly to regularise.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct WienerConfig {
    /// K relative to the mean of |H|^2; None: the best on simulated scenes.
    pub relative_k: Option<f64>,
}

/// Scenes that K is chosen on.
const EXAMPLES: u64 = 12;

impl WienerConfig {
    /// Plans the filter for an instrument: the PSF is that of its model at the object's centre.
    ///
    /// Where K is not given it is the best on synthetic scenes that the instrument's own model and noise turn into frames, with
    /// brightest pixels between a tenth and four fifths of full scale.
    ///
    /// # Errors
    /// The instrument's model cannot be planned, its PSF is dark, or K is no positive number.
    pub fn build(&self, instrument: &Instrument, seed: u64) -> anyhow::Result<Wiener> {
        let forward = Forward::new(instrument)?;
        let grid = &instrument.manifest.object;
        let source = (grid.rows / 2, grid.cols / 2);
        let mut point = Array2::zeros((grid.rows, grid.cols));
        point[source] = 1.0;
        let psf_dn = forward.operator().apply(point.view())?;
        let filter = Wiener::new(instrument, psf_dn.view(), source, self.relative_k.unwrap_or(0.1))?;
        if self.relative_k.is_some() {
            return Ok(filter);
        }
        let scenes = SceneConfig::default().build()?;
        let cx = forward.context();
        let example = |i: u64| -> anyhow::Result<Option<Example>> {
            let mut object = scenes.draw(grid, seed, "wiener", i);
            let peak_e = forward.expected_e(object.view(), &cx)?.iter().fold(0.0f32, |m, &v| m.max(v));
            if peak_e <= 0.0 {
                return Ok(None);
            }
            let full_scale = 0.1 + 0.7 * i as f64 / (EXAMPLES - 1) as f64;
            let factor = (full_scale * cx.full_scale_e / f64::from(peak_e)) as f32;
            object.mapv_inplace(|v| v * factor);
            let light_e = forward.expected_e(object.view(), &cx)?;
            let frame_dn = forward.draw_dn(light_e, &cx, &mut rng::stream(seed, "wiener noise", i));
            Ok(Some(Example { frame_dn, object }))
        };
        let examples = (0..EXAMPLES).filter_map(|i| example(i).transpose()).collect::<anyhow::Result<Vec<_>>>()?;
        filter.tuned(&examples)
    }
}

/// A scene whose object is known: what K is chosen on.
#[derive(Clone, Debug)]
pub struct Example {
    /// Raw frame, DN, [sensor rows, sensor cols].
    pub frame_dn: Array2<f32>,
    /// Its object, [object rows, object cols].
    pub object: Array2<f32>,
}

/// The planned filter.
#[derive(Clone, Debug)]
pub struct Wiener {
    correction: FrameCorrection,
    fft: RealFft2,
    /// Spectrum H of the array's PSF.
    transfer: Vec<Complex32>,
    /// Mean of |H|^2: the unit of K.
    mean_power: f64,
    relative_k: f64,
    object: (usize, usize),
    /// Object pixel whose PSF was taken.
    source: (usize, usize),
}

impl Wiener {
    /// Plans the filter from the light, DN, that a unit source at object pixel `source` throws onto the sensor.
    ///
    /// # Errors
    /// The PSF has another shape than the sensor or is dark, or K is no positive number.
    pub fn new(
        instrument: &Instrument,
        psf_dn: ArrayView2<'_, f32>,
        source: (usize, usize),
        relative_k: f64,
    ) -> Result<Self, MethodError> {
        let (sensor, object) = (&instrument.manifest.sensor, &instrument.manifest.object);
        let shape = (sensor.rows, sensor.cols);
        if psf_dn.dim() != shape {
            return Err(MethodError::FrameShape { expected: shape, found: psf_dn.dim() });
        }
        if !(relative_k > 0.0 && relative_k.is_finite()) {
            return Err(MethodError::Regularisation(relative_k));
        }
        // Room for the object beyond the sensor, so that one side of the field does not wrap round to the other.
        let fft = RealFft2::new(fast_size(shape.0 + object.rows), fast_size(shape.1 + object.cols));
        let transfer = padded_spectrum(&fft, psf_dn);
        let mean_power = transfer.iter().map(|h| f64::from(h.norm_sqr())).sum::<f64>() / transfer.len() as f64;
        if !(mean_power > 0.0 && mean_power.is_finite()) {
            return Err(MethodError::DarkPsf);
        }
        let correction = FrameCorrection::new(instrument);
        Ok(Self { correction, fft, transfer, mean_power, relative_k, object: (object.rows, object.cols), source })
    }

    /// K in units of the mean of |H|^2.
    pub fn relative_k(&self) -> f64 {
        self.relative_k
    }

    /// The same filter with the K that gives the highest mean PSNR on `examples`: a scan in half decades from 1e-5 to 1e2,
    /// then a golden-section search in the best bracket, on a logarithmic scale.
    ///
    /// # Errors
    /// There is no example, or one does not fit the instrument.
    pub fn tuned(mut self, examples: &[Example]) -> anyhow::Result<Self> {
        anyhow::ensure!(!examples.is_empty(), "no example to choose the Wiener filter's K on");
        let spectra = examples
            .iter()
            .map(|e| Ok((self.spectrum(e.frame_dn.view())?, &e.object)))
            .collect::<Result<Vec<_>, MethodError>>()?;
        let mean_psnr = |log_k: f64| -> anyhow::Result<f64> {
            let mut sum = 0.0;
            for (spectrum, object) in &spectra {
                sum += compare(self.solve(spectrum, 10f64.powf(log_k)).view(), object.view())?.psnr_db;
            }
            Ok(sum / spectra.len() as f64)
        };
        let mut best = (f64::NEG_INFINITY, 0.0);
        for step in 0..15 {
            let log_k = -5.0 + 0.5 * f64::from(step);
            best = match mean_psnr(log_k)? {
                psnr if psnr > best.0 => (psnr, log_k),
                _ => best,
            };
        }
        let log_k = golden_section(mean_psnr, best.1 - 0.5, best.1 + 0.5)?;
        self.relative_k = 10f64.powf(log_k);
        Ok(self)
    }

    fn spectrum(&self, frame_dn: ArrayView2<'_, f32>) -> Result<Vec<Complex32>, MethodError> {
        Ok(padded_spectrum(&self.fft, self.correction.light_dn(frame_dn)?.view()))
    }

    /// The spectrum of X, from that of Y.
    fn filter(&self, frame: &[Complex32], relative_k: f64) -> Vec<Complex32> {
        let k = (relative_k * self.mean_power) as f32;
        frame.iter().zip(&self.transfer).map(|(y, h)| h.conj() * y / (h.norm_sqr() + k)).collect()
    }

    fn solve(&self, frame: &[Complex32], relative_k: f64) -> Array2<f32> {
        let image = image_of(&self.fft, self.filter(frame, relative_k));
        // Frame = object convolved with the PSF of pixel `source`: object pixel r lies at r - source, modulo the period.
        let [rows, cols] = self.fft.shape();
        let at = |i: usize, source: usize, period: usize| (i + period - source) % period;
        Array2::from_shape_fn(self.object, |(r, c)| {
            image[[at(r, self.source.0, rows), at(c, self.source.1, cols)]].max(0.0)
        })
    }
}

impl Reconstruct for Wiener {
    fn name(&self) -> &str {
        "wiener"
    }

    fn reconstruct(&self, frame_dn: ArrayView2<'_, f32>) -> anyhow::Result<Array2<f32>> {
        Ok(self.solve(&self.spectrum(frame_dn)?, self.relative_k))
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

/// The maximum of a function with one peak in `[low, high]`, to a hundredth.
fn golden_section(f: impl Fn(f64) -> anyhow::Result<f64>, mut low: f64, mut high: f64) -> anyhow::Result<f64> {
    let ratio = (5f64.sqrt() - 1.0) / 2.0;
    let (mut a, mut b) = (high - ratio * (high - low), low + ratio * (high - low));
    let (mut fa, mut fb) = (f(a)?, f(b)?);
    while high - low > 0.01 {
        if fa > fb {
            (high, b, fb) = (b, a, fa);
            a = high - ratio * (high - low);
            fa = f(a)?;
        } else {
            (low, a, fa) = (a, b, fb);
            b = low + ratio * (high - low);
            fb = f(b)?;
        }
    }
    Ok((low + high) / 2.0)
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use crate::testing::square_array as instrument;
    use rand::RngExt;
    use rand_distr::{Distribution, Normal};

    const SOURCE: (usize, usize) = (8, 8);

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
                frame[[p + r - SOURCE.0, q + c - SOURCE.1]] += o * h;
            }
        }
        let (mut random, normal) =
            (rng::stream(seed, "wiener noise", 0), Normal::new(0.0, noise_dn.max(1e-9)).unwrap());
        frame.mapv(|v| v + normal.sample(&mut random) as f32)
    }

    fn wiener(relative_k: f64) -> Wiener {
        Wiener::new(&instrument(1, [64, 64], [16, 16]), psf().view(), SOURCE, relative_k).unwrap()
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
        let examples = |noise, first| -> Vec<Example> {
            let example = |i| Example { frame_dn: frame(&object(i), noise, i), object: object(i) };
            (first..first + 4).map(example).collect()
        };
        let psnr = |w: &Wiener, examples: &[Example]| -> f64 {
            let one = |e: &Example| compare(w.reconstruct(e.frame_dn.view()).unwrap().view(), e.object.view()).unwrap();
            examples.iter().map(|e| one(e).psnr_db).sum::<f64>() / examples.len() as f64
        };
        let (quiet, loud) =
            (wiener(1.0).tuned(&examples(1.0, 10)).unwrap(), wiener(1.0).tuned(&examples(20.0, 10)).unwrap());
        assert!(loud.relative_k() > 3.0 * quiet.relative_k(), "{} {}", loud.relative_k(), quiet.relative_k());
        let others = examples(20.0, 50);
        let best = (0..30).map(|i| psnr(&wiener(10f64.powf(-4.0 + 0.2 * f64::from(i))), &others)).fold(0.0, f64::max);
        assert!(psnr(&loud, &others) > best - 0.3, "{} {best}", psnr(&loud, &others));
    }

    #[test]
    fn bad_configurations_are_refused() {
        let instrument = instrument(1, [64, 64], [16, 16]);
        let k = |k| Wiener::new(&instrument, psf().view(), SOURCE, k).map(|_| ()).unwrap_err();
        assert!(
            matches!(k(0.0), MethodError::Regularisation(_)) && matches!(k(f64::NAN), MethodError::Regularisation(_))
        );
        let dark = Wiener::new(&instrument, Array2::zeros((64, 64)).view(), SOURCE, 1.0);
        assert!(matches!(dark, Err(MethodError::DarkPsf)));
    }
}
