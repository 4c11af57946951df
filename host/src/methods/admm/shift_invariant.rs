//! ADMM with one PSF for the whole field, where every step has a closed form.
//!
//! The splits are v = H x (the light, also beyond the edge of the sensor), u = grad x and w = x, with scaled duals. On
//! a periodic grid with room for sensor and object, the x-step is diagonal in frequency and the v-step in space (N.
//! Antipa et al., Optica 5, 1 (2018), supplement).

use super::tv::{Edge, gradient, gradient_transposed, shrink};
use super::{AdmmConfig, scaled};
use crate::fft2::{RealFft2, fast_size};
use crate::instrument::Instrument;
use crate::methods::frame::frame_input;
use crate::methods::{MethodError, Reconstruct};
use crate::noise::NoiseModel;
use crate::sensor::FrameInput;
use ndarray::{Array2, ArrayView2, Zip, s};
use rustfft::num_complex::Complex32;

/// ADMM with one PSF, planned for one instrument.
#[derive(Clone, Debug)]
pub struct ShiftInvariantAdmm {
    config: AdmmConfig,
    input: FrameInput,
    noise: NoiseModel,
    fft: RealFft2,
    /// Spectrum H of the PSF, its largest magnitude 1; [cols/2 + 1, rows] in the layout of [`RealFft2`].
    transfer: Vec<Complex32>,
    /// Denominator of the x-step, in the same layout.
    denominator: Vec<f32>,
    sensor: (usize, usize),
    object: (usize, usize),
}

impl ShiftInvariantAdmm {
    /// Plans the method from the array's point-spread function: the light, DN, [sensor rows, sensor cols], of a unit
    /// source at object pixel `source`, [row, col].
    ///
    /// # Errors
    /// The PSF has another shape than the sensor or holds no light.
    pub fn new(
        config: AdmmConfig,
        instrument: &Instrument,
        psf_dn: ArrayView2<'_, f32>,
        source: [usize; 2],
    ) -> Result<Self, MethodError> {
        let (sensor, object) = (&instrument.manifest.sensor, &instrument.manifest.object);
        let shape = (sensor.rows, sensor.cols);
        if psf_dn.dim() != shape {
            let found = [psf_dn.nrows(), psf_dn.ncols()];
            return Err(MethodError::PsfShape { expected: [shape.0, shape.1], found });
        }
        let fft = RealFft2::new(fast_size(shape.0 + object.rows), fast_size(shape.1 + object.cols));
        let [rows, cols] = fft.shape();
        // Object pixel (r, c) of the grid is element (r, c): the kernel is the PSF moved back by its source.
        let mut kernel = Array2::zeros((rows, cols));
        for ((r, c), &v) in psf_dn.indexed_iter() {
            kernel[[(r + rows - source[0]) % rows, (c + cols - source[1]) % cols]] = v;
        }
        let mut transfer = spectrum(&fft, &kernel);
        let norm = transfer.iter().map(|h| h.norm()).fold(0.0, f32::max);
        if norm.is_nan() || norm <= 0.0 {
            return Err(MethodError::DarkPsf);
        }
        transfer.iter_mut().for_each(|h| *h /= norm);
        let mu = config.penalty as f32;
        // |exp(i k) - 1|^2 = 2 - 2 cos k along each axis.
        let square = |k: usize, n: usize| 2.0 - 2.0 * (std::f32::consts::TAU * k as f32 / n as f32).cos();
        let denominator = transfer
            .iter()
            .enumerate()
            .map(|(i, h)| mu * (h.norm_sqr() + square(i % rows, rows) + square(i / rows, cols) + 1.0))
            .collect();
        let input = frame_input(instrument)?;
        Ok(Self {
            config,
            input,
            noise: instrument.noise,
            fft,
            transfer,
            denominator,
            sensor: shape,
            object: (object.rows, object.cols),
        })
    }

    /// Solves for the object of scaled light `y`, [sensor rows, sensor cols]; `watch` receives w, [object rows, object
    /// cols], after each iteration.
    pub(super) fn solve(&self, y: &Array2<f32>, tau: f32, mut watch: impl FnMut(ArrayView2<'_, f32>)) -> Array2<f32> {
        let mu = self.config.penalty as f32;
        let [rows, cols] = self.fft.shape();
        let zero = || Array2::<f32>::zeros((rows, cols));
        let on_sensor = s![..self.sensor.0, ..self.sensor.1];
        let on_object = s![..self.object.0, ..self.object.1];
        let (mut v, mut dual_v, mut w, mut dual) = (zero(), zero(), zero(), zero());
        let (mut u, mut dual_u) = ([zero(), zero()], [zero(), zero()]);
        // At the start, the light is that of the frame, and 0 beyond the sensor.
        v.slice_mut(on_sensor).assign(y);
        for _ in 0..self.config.iterations.max(1) {
            let difference = [&u[0] - &dual_u[0], &u[1] - &dual_u[1]];
            let near = gradient_transposed(&difference, Edge::Wrap) + &w - &dual;
            let (near, light) = (spectrum(&self.fft, &near), spectrum(&self.fft, &(&v - &dual_v)));
            let found: Vec<Complex32> = near
                .iter()
                .zip(&light)
                .zip(self.transfer.iter().zip(&self.denominator))
                .map(|((n, l), (h, d))| (n + h.conj() * l) * mu / d)
                .collect();
            let image = found.iter().zip(&self.transfer).map(|(x, h)| x * h).collect();
            let (x, image) = (image_of(&self.fft, found), image_of(&self.fft, image));
            v = &image + &dual_v;
            // Off the sensor nothing was measured: v keeps the value of the model.
            Zip::from(v.slice_mut(on_sensor)).and(y).for_each(|v, &y| *v = (mu * *v + y) / (mu + 1.0));
            dual_v += &(&image - &v);
            let slope = gradient(x.view(), Edge::Wrap);
            for a in 0..2 {
                u[a] = &slope[a] + &dual_u[a];
            }
            shrink(&mut u, tau / mu);
            for a in 0..2 {
                dual_u[a] += &(&slope[a] - &u[a]);
            }
            let raised = &x + &dual;
            let before = w.slice(on_object).to_owned();
            w.fill(0.0);
            // Outside the object grid, w is 0.
            Zip::from(w.slice_mut(on_object)).and(raised.slice(on_object)).for_each(|w, &r| *w = r.max(0.0));
            dual = raised - &w;
            watch(w.slice(on_object));
            if self.config.has_settled(before.view(), w.slice(on_object)) {
                break;
            }
        }
        w.slice(on_object).to_owned()
    }
}

impl Reconstruct for ShiftInvariantAdmm {
    fn name(&self) -> &str {
        "admm-lsi"
    }

    fn reconstruct(&self, frame_dn: ArrayView2<'_, f32>) -> anyhow::Result<Array2<f32>> {
        Ok(match scaled(&self.input, &self.noise, self.config.tv, frame_dn)? {
            None => Array2::zeros(self.object),
            Some(s) => self.solve(&s.y, s.tau, |_| ()),
        })
    }
}

fn spectrum(fft: &RealFft2, image: &Array2<f32>) -> Vec<Complex32> {
    let mut out = vec![Complex32::default(); fft.spectrum_len()];
    let values: Vec<f32> = image.iter().copied().collect();
    fft.forward(&values, &mut out, &mut fft.scratch());
    out
}

fn image_of(fft: &RealFft2, spectrum: Vec<Complex32>) -> Array2<f32> {
    let [rows, cols] = fft.shape();
    let mut image = vec![0.0; rows * cols];
    fft.inverse(&spectrum, &mut image, &mut fft.scratch());
    let scale = 1.0 / (rows * cols) as f32;
    Array2::from_shape_fn((rows, cols), |(r, c)| image[r * cols + c] * scale)
}
