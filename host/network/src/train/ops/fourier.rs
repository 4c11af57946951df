//! The Fourier filter bank, cropped to the object: `y_c = crop(irfft2(rfft2(pad(x)) K_c))`, and its gradient.
//!
//! Only rows that matter are transformed: rows of the frame forward, rows of the object backward. Spectra are stored
//! transposed, [col frequency, row frequency], so that transforms along rows and along columns both run over contiguous
//! memory.

use rayon::prelude::*;
use realfft::{ComplexToReal, RealFftPlanner, RealToComplex};
use rustfft::num_complex::Complex32;
use rustfft::{Fft, FftPlanner};
use std::sync::Arc;

/// Sizes of a filter bank. Frame and object lie in the middle of the transform, from `floor((filter_size - side) / 2)`
/// on.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct FourierSizes {
    /// Rows and columns of a frame.
    pub frame: [usize; 2],
    /// Rows and columns of the crop.
    pub object: [usize; 2],
    /// Side T of the transform; any length.
    pub filter_size: usize,
    /// Number C of filters.
    pub channels: usize,
}

/// The planned transforms of one filter bank.
pub struct Fourier {
    pub(super) sizes: FourierSizes,
    pub(super) rows_forward: Arc<dyn RealToComplex<f32>>,
    pub(super) rows_inverse: Arc<dyn ComplexToReal<f32>>,
    pub(super) cols_forward: Arc<dyn Fft<f32>>,
    pub(super) cols_inverse: Arc<dyn Fft<f32>>,
}

impl std::fmt::Debug for Fourier {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        self.sizes.fmt(f)
    }
}

/// A half spectrum, [T/2+1 col frequencies, T row frequencies].
pub type Spectrum = Vec<Complex32>;

impl Fourier {
    /// Plans the transforms. Frame and object must fit into `filter_size`.
    pub fn new(sizes: FourierSizes) -> Self {
        let t = sizes.filter_size;
        let (mut real, mut complex) = (RealFftPlanner::new(), FftPlanner::new());
        Self {
            sizes,
            rows_forward: real.plan_fft_forward(t),
            rows_inverse: real.plan_fft_inverse(t),
            cols_forward: complex.plan_fft_forward(t),
            cols_inverse: complex.plan_fft_inverse(t),
        }
    }

    /// Sizes of the filter bank.
    pub fn sizes(&self) -> FourierSizes {
        self.sizes
    }

    pub(super) fn bins(&self) -> usize {
        self.sizes.filter_size / 2 + 1
    }

    /// Spectra of frames, `x` [batch, frame rows, frame cols].
    pub fn spectra(&self, x: &[f32]) -> Vec<Spectrum> {
        let [rows, cols] = self.sizes.frame;
        x.par_chunks_exact(rows * cols).map(|x| self.rfft2(x, self.sizes.frame)).collect()
    }

    /// Filters as spectra, from their real and imaginary parts [channels, T, T/2+1] in PyTorch's layout.
    pub fn filters(&self, re: &[f32], im: &[f32]) -> Vec<Spectrum> {
        let (t, bins) = (self.sizes.filter_size, self.bins());
        let one = |(re, im): (&[f32], &[f32])| {
            let rows: Vec<Complex32> = re.iter().zip(im).map(|(&re, &im)| Complex32::new(re, im)).collect();
            let mut spectrum = vec![Complex32::default(); rows.len()];
            transpose(&rows, &mut spectrum, t, bins);
            spectrum
        };
        re.par_chunks_exact(t * bins).zip(im.par_chunks_exact(t * bins)).map(one).collect()
    }

    /// Frames, filtered and cropped: [batch, channels, object rows, object cols].
    pub fn forward(&self, spectra: &[Spectrum], filters: &[Spectrum]) -> Vec<f32> {
        let [rows, cols] = self.sizes.object;
        let mut y = vec![0.0; spectra.len() * filters.len() * rows * cols];
        y.par_chunks_exact_mut(rows * cols).enumerate().for_each(|(i, y)| {
            let (x, k) = (&spectra[i / filters.len()], &filters[i % filters.len()]);
            self.irfft2(x.iter().zip(k).map(|(x, k)| x * k).collect(), self.sizes.object, y);
        });
        y
    }

    /// Gradient of a loss with respect to the real and imaginary parts of the filters, each [channels, T, T/2+1], from
    /// its gradient `g` with respect to the output.
    ///
    /// `irfft2` uses each inner column twice (for itself and its mirror image), so
    /// `dK = w / T^2 sum_b conj(X_b) rfft2(pad(g_b))` with w = 1 in the columns of frequency zero and Nyquist, and w =
    /// 2 elsewhere.
    pub fn backward(&self, spectra: &[Spectrum], g: &[f32]) -> (Vec<f32>, Vec<f32>) {
        let (t, bins, channels) = (self.sizes.filter_size, self.bins(), self.sizes.channels);
        let plane = self.sizes.object[0] * self.sizes.object[1];
        let one = |c: usize| {
            let mut sum = vec![Complex32::default(); t * bins];
            for (b, x) in spectra.iter().enumerate() {
                let g = self.rfft2(&g[(b * channels + c) * plane..][..plane], self.sizes.object);
                for ((s, x), g) in sum.iter_mut().zip(x).zip(g) {
                    *s += x.conj() * g;
                }
            }
            for (col, bins) in sum.chunks_exact_mut(t).enumerate() {
                let weight = if col == 0 || 2 * col == t { 1.0 } else { 2.0 } / (t * t) as f32;
                bins.iter_mut().for_each(|s| *s *= weight);
            }
            let mut rows = vec![Complex32::default(); t * bins];
            transpose(&sum, &mut rows, bins, t);
            rows
        };
        let sums: Vec<Vec<Complex32>> = (0..channels).into_par_iter().map(one).collect();
        (sums.iter().flatten().map(|s| s.re).collect(), sums.iter().flatten().map(|s| s.im).collect())
    }

    /// Real and imaginary parts of spectra in PyTorch's layout, each [channels, T, T/2+1].
    pub fn parts(&self, spectra: &[Spectrum]) -> (Vec<f32>, Vec<f32>) {
        let (t, bins) = (self.sizes.filter_size, self.bins());
        let mut rows = vec![Complex32::default(); spectra.len() * t * bins];
        rows.par_chunks_exact_mut(t * bins).zip(spectra).for_each(|(out, s)| transpose(s, out, bins, t));
        (rows.iter().map(|v| v.re).collect(), rows.iter().map(|v| v.im).collect())
    }

    /// Spectra of kernels [channels, T, T] in the layout of [`Fourier::parts`].
    pub fn kernel_parts(&self, kernels: &[f32]) -> (Vec<f32>, Vec<f32>) {
        let t = self.sizes.filter_size;
        let spectra: Vec<Spectrum> = kernels.par_chunks_exact(t * t).map(|k| self.rfft2(k, [t, t])).collect();
        self.parts(&spectra)
    }

    /// Gradient of a loss with respect to kernels, [channels, T, T], from its gradients with respect to
    /// [`Fourier::kernel_parts`]: `dh = Re sum (g_re + i g_im) exp(i k
    /// n)` over the stored half, whose inner columns `irfft2` would count twice.
    pub fn kernel_gradient(&self, re: &[f32], im: &[f32]) -> Vec<f32> {
        let t = self.sizes.filter_size;
        let one = |mut g: Spectrum| {
            for (col, bins) in g.chunks_exact_mut(t).enumerate() {
                let weight = if col == 0 || 2 * col == t { 1.0 } else { 0.5 } * (t * t) as f32;
                bins.iter_mut().for_each(|g| *g *= weight);
            }
            self.whole(g)
        };
        self.filters(re, im).into_par_iter().flat_map_iter(one).collect()
    }

    /// The whole image, [T, T], of a half spectrum.
    pub fn whole(&self, spectrum: Spectrum) -> Vec<f32> {
        let t = self.sizes.filter_size;
        let mut out = vec![0.0; t * t];
        self.irfft2(spectrum, [t, t], &mut out);
        out
    }

    /// Gradient of a loss with respect to a frame, [frame rows, frame cols], from its gradient `g` with respect to the
    /// output, [channels, object rows, object cols]: the transpose of the bank,
    /// `crop(irfft2(sum_c conj(K_c) rfft2(pad(g_c))))`.
    pub fn backward_to_frame(&self, filters: &[Spectrum], g: &[f32]) -> Vec<f32> {
        let ([rows, cols], plane) = (self.sizes.frame, self.sizes.object[0] * self.sizes.object[1]);
        let mut sum = vec![Complex32::default(); self.sizes.filter_size * self.bins()];
        for (k, g) in filters.iter().zip(g.chunks_exact(plane)) {
            let g = self.rfft2(g, self.sizes.object);
            sum.iter_mut().zip(k).zip(g).for_each(|((s, k), g)| *s += k.conj() * g);
        }
        let mut out = vec![0.0; rows * cols];
        self.irfft2(sum, self.sizes.frame, &mut out);
        out
    }

    /// Half spectrum of an image of `size` in the middle of a T x T field of zeros.
    pub fn rfft2(&self, image: &[f32], size: [usize; 2]) -> Spectrum {
        let (t, bins) = (self.sizes.filter_size, self.bins());
        let [top, left] = size.map(|side| (t - side) / 2);
        let mut row = vec![0.0; t];
        let mut scratch = self.rows_forward.make_scratch_vec();
        let mut rows = vec![Complex32::default(); size[0] * bins];
        for (image, out) in image.chunks_exact(size[1]).zip(rows.chunks_exact_mut(bins)) {
            // The transform overwrites `row`, so all of it is written again.
            row.fill(0.0);
            row[left..left + size[1]].copy_from_slice(image);
            // The lengths are those of the plan, so this cannot fail.
            let _ = self.rows_forward.process_with_scratch(&mut row, out, &mut scratch);
        }
        let mut spectrum = vec![Complex32::default(); bins * t];
        transpose_into(&rows, &mut spectrum, size[0], bins, t, top);
        self.cols_forward.process(&mut spectrum);
        spectrum
    }

    /// The middle part, of `size`, of the image with this half spectrum.
    ///
    /// As in every real inverse, imaginary parts at column frequencies zero and Nyquist are ignored after the transform
    /// along the columns.
    fn irfft2(&self, mut spectrum: Spectrum, size: [usize; 2], out: &mut [f32]) {
        let (t, bins) = (self.sizes.filter_size, self.bins());
        let [height, width] = size;
        let [top, left] = size.map(|side| (t - side) / 2);
        self.cols_inverse.process(&mut spectrum);
        let mut rows = vec![Complex32::default(); height * bins];
        transpose_from(&spectrum, &mut rows, t, top, height, bins);
        let mut row = vec![0.0; t];
        let mut scratch = self.rows_inverse.make_scratch_vec();
        let scale = 1.0 / (t * t) as f32;
        for (rows, out) in rows.chunks_exact_mut(bins).zip(out.chunks_exact_mut(width)) {
            rows[0].im = 0.0;
            if t.is_multiple_of(2) {
                rows[bins - 1].im = 0.0;
            }
            let _ = self.rows_inverse.process_with_scratch(rows, &mut row, &mut scratch);
            out.iter_mut().zip(&row[left..]).for_each(|(o, v)| *o = v * scale);
        }
    }
}

/// Side of the squares in which matrices are transposed, so that both sides of the copy stay in the cache.
const TILE: usize = 16;

/// [rows, cols] -> [cols, rows].
fn transpose(from: &[Complex32], to: &mut [Complex32], rows: usize, cols: usize) {
    transpose_into(from, to, rows, cols, rows, 0);
}

/// [rows, cols] -> columns `at..at + rows` of [cols, width].
fn transpose_into(from: &[Complex32], to: &mut [Complex32], rows: usize, cols: usize, width: usize, at: usize) {
    for r0 in (0..rows).step_by(TILE) {
        for c0 in (0..cols).step_by(TILE) {
            for c in c0..(c0 + TILE).min(cols) {
                for r in r0..(r0 + TILE).min(rows) {
                    to[c * width + at + r] = from[r * cols + c];
                }
            }
        }
    }
}

/// Columns `at..at + rows` of [cols, width] -> [rows, cols].
fn transpose_from(from: &[Complex32], to: &mut [Complex32], width: usize, at: usize, rows: usize, cols: usize) {
    for r0 in (0..rows).step_by(TILE) {
        for c0 in (0..cols).step_by(TILE) {
            for r in r0..(r0 + TILE).min(rows) {
                for c in c0..(c0 + TILE).min(cols) {
                    to[r * cols + c] = from[c * width + at + r];
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::f64::consts::TAU;

    fn noise(n: usize, seed: u64) -> Vec<f32> {
        let mut state = seed.wrapping_mul(0x9e37_79b9_7f4a_7c15) | 1;
        std::iter::repeat_with(|| {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            (state >> 40) as f32 / (1u64 << 23) as f32 - 1.0
        })
        .take(n)
        .collect()
    }

    /// The definition in f64: the sum over all frequencies, the missing half being the mirror of the half that is
    /// stored; the real part of the sum over the stored half, inner columns counted twice.
    fn naive(s: FourierSizes, x: &[f32], re: &[f32], im: &[f32]) -> Vec<f64> {
        let (t, bins) = (s.filter_size, s.filter_size / 2 + 1);
        let origin = |side: usize| (t - side) / 2;
        let turn = |k: usize, n: usize| TAU * ((k * n) % t) as f64 / t as f64;
        let mut y = Vec::new();
        for c in 0..s.channels {
            let mut z = vec![(0.0, 0.0); t * bins];
            for kr in 0..t {
                for kc in 0..bins {
                    let (mut a, mut b) = (0.0, 0.0);
                    for r in 0..s.frame[0] {
                        for q in 0..s.frame[1] {
                            let angle = turn(kr, r + origin(s.frame[0])) + turn(kc, q + origin(s.frame[1]));
                            let v = f64::from(x[r * s.frame[1] + q]);
                            a += v * angle.cos();
                            b -= v * angle.sin();
                        }
                    }
                    let i = (c * t + kr) * bins + kc;
                    let (kre, kim) = (f64::from(re[i]), f64::from(im[i]));
                    z[kr * bins + kc] = (a * kre - b * kim, a * kim + b * kre);
                }
            }
            for r in 0..s.object[0] {
                for q in 0..s.object[1] {
                    let mut sum = 0.0;
                    for kr in 0..t {
                        for kc in 0..bins {
                            let angle = turn(kr, r + origin(s.object[0])) + turn(kc, q + origin(s.object[1]));
                            let (a, b) = z[kr * bins + kc];
                            let count = if kc == 0 || 2 * kc == t { 1.0 } else { 2.0 };
                            sum += count * (a * angle.cos() - b * angle.sin());
                        }
                    }
                    y.push(sum / (t * t) as f64);
                }
            }
        }
        y
    }

    /// Even, odd, power of two, neither; frames and objects of even and odd sides.
    fn cases() -> [FourierSizes; 4] {
        let s = |frame, object, filter_size, channels| FourierSizes { frame, object, filter_size, channels };
        [s([6, 7], [4, 2], 8, 2), s([5, 9], [4, 4], 9, 1), s([12, 10], [6, 8], 12, 2), s([7, 7], [7, 7], 7, 3)]
    }

    #[test]
    fn forward_is_the_definition() {
        for s in cases() {
            let plan = Fourier::new(s);
            let n = s.channels * s.filter_size * (s.filter_size / 2 + 1);
            let (x, re, im) = (noise(s.frame[0] * s.frame[1], 1), noise(n, 2), noise(n, 3));
            let y = plan.forward(&plan.spectra(&x), &plan.filters(&re, &im));
            for (a, b) in y.iter().zip(naive(s, &x, &re, &im)) {
                assert!((f64::from(*a) - b).abs() < 1e-5, "{s:?}: {a} {b}");
            }
        }
    }

    /// Both directions of a linear map: `<g, F h> = <F' g, h>`.
    #[test]
    fn transposes_are_transposes() {
        let dot = |a: &[f32], b: &[f32]| a.iter().zip(b).map(|(&a, &b)| f64::from(a) * f64::from(b)).sum::<f64>();
        for s in cases() {
            let (plan, t) = (Fourier::new(s), s.filter_size);
            let n = s.channels * t * (t / 2 + 1);
            let (h, gr, gi) = (noise(s.channels * t * t, 8), noise(n, 9), noise(n, 10));
            let (re, im) = plan.kernel_parts(&h);
            let (left, right) = (dot(&re, &gr) + dot(&im, &gi), dot(&plan.kernel_gradient(&gr, &gi), &h));
            assert!((left - right).abs() < 1e-4, "{s:?}: {left} {right}");
            let (x, g) = (noise(s.frame[0] * s.frame[1], 11), noise(s.channels * s.object[0] * s.object[1], 12));
            let filters = plan.filters(&gr, &gi);
            let y = plan.forward(&plan.spectra(&x), &filters);
            let (left, right) = (dot(&y, &g), dot(&plan.backward_to_frame(&filters, &g), &x));
            assert!((left - right).abs() < 1e-4, "{s:?}: {left} {right}");
        }
    }

    /// The output is linear in the filters, so a central difference of `<g, y>` is its derivative but for rounding; it
    /// is taken with the f64 definition.
    #[test]
    fn gradient_is_the_central_difference() {
        for s in cases() {
            let plan = Fourier::new(s);
            let n = s.channels * s.filter_size * (s.filter_size / 2 + 1);
            let (x, mut re, mut im) = (noise(s.frame[0] * s.frame[1], 4), noise(n, 5), noise(n, 6));
            let g = noise(s.channels * s.object[0] * s.object[1], 7);
            let (dre, dim) = plan.backward(&plan.spectra(&x), &g);
            let loss = |re: &[f32], im: &[f32]| -> f64 {
                naive(s, &x, re, im).iter().zip(&g).map(|(y, &g)| y * f64::from(g)).sum()
            };
            for i in (0..n).step_by(n / 7) {
                let difference = |plus: f64, minus: f64| (plus - minus) / 0.5;
                let (r, m) = (re[i], im[i]);
                re[i] = r + 0.25;
                let plus = loss(&re, &im);
                re[i] = r - 0.25;
                let minus = loss(&re, &im);
                re[i] = r;
                assert!((difference(plus, minus) - f64::from(dre[i])).abs() < 1e-5, "{s:?} re {i}");
                im[i] = m + 0.25;
                let plus = loss(&re, &im);
                im[i] = m - 0.25;
                let minus = loss(&re, &im);
                im[i] = m;
                assert!((difference(plus, minus) - f64::from(dim[i])).abs() < 1e-5, "{s:?} im {i}");
            }
        }
    }
}
