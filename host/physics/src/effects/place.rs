//! Where the light of frames lies, as compared with what is expected of them.

use super::evidence::EvidenceFrame;
use super::smooth::gaussian_blur;
use crate::fft2::{RealFft2, fast_size};
use ndarray::{Array2, s};
use rustfft::num_complex::Complex32;

/// Largest displacement that is looked for, along each axis, pixels: beyond that the foci of one lens meet those of
/// others.
const MOST_PX: usize = 16;
/// The frames must fit so many times better there (sum of products) than where they are expected.
const BETTER: f32 = 1.2;
/// Width of the blur that is subtracted from the light, pixels: what is broad has no place.
const BROAD_PX: f64 = 5.0;

/// Foci are a few pixels wide: frames are linear in displacements below this, pixels.
const FAR_PX: f64 = 2.0;

/// The displacement (row, col), px, of frames from what is expected of them; None: none is clear, or it is too small
/// for frames to be far from linear in it.
pub(super) fn far_displacement_px<'f, 'a: 'f>(frames: impl Iterator<Item = &'f EvidenceFrame<'a>>) -> Option<[f64; 2]> {
    let pair = |f: &EvidenceFrame<'_>| {
        let expected = f.light_e.mapv(|e| e * f.cx.gain_dn_per_e as f32);
        [&expected + &f.residual_dn, expected]
    };
    let found = displacement_px(frames.map(pair)).map(|d| d.map(|v| v as f64));
    found.filter(|d| d[0].hypot(d[1]) >= FAR_PX)
}

/// The displacement (row, col), whole pixels, at which measured frames fit the expected ones best: the maximum of their
/// cross-correlation, summed over the `pairs` of a measured and an expected frame, [rows, cols], in one unit. Frames of
/// another shape than the first do not count. None: none is clearly better than no displacement.
pub fn displacement_px(pairs: impl IntoIterator<Item = [Array2<f32>; 2]>) -> Option<[isize; 2]> {
    let mut pairs = pairs.into_iter().peekable();
    let (rows, cols) = pairs.peek().map(|[_, expected]| expected.dim()).filter(|(r, c)| *r > 1 && *c > 1)?;
    let size = [rows, cols].map(|n| fast_size(n + MOST_PX));
    let fft = RealFft2::new(size[0], size[1]);
    let mut work = fft.scratch();
    let mut spectrum = |image: &Array2<f32>| {
        let mut padded = Array2::zeros((size[0], size[1]));
        padded.slice_mut(s![..rows, ..cols]).assign(image);
        let mut out = vec![Complex32::default(); fft.spectrum_len()];
        if let Some(padded) = padded.as_slice() {
            fft.forward(padded, &mut out, &mut work);
        }
        out
    };
    let mut sum = vec![Complex32::default(); fft.spectrum_len()];
    for pair in pairs.filter(|pair| pair.iter().all(|image| image.dim() == (rows, cols))) {
        let sharp = |image: Array2<f32>| &image - &gaussian_blur(&image, BROAD_PX);
        let [measured, expected] = pair.map(|image| spectrum(&sharp(image)));
        sum.iter_mut().zip(measured.iter().zip(&expected)).for_each(|(s, (m, e))| *s += m * e.conj());
    }
    let mut fits = vec![0.0f32; size[0] * size[1]];
    fft.inverse(&sum, &mut fits, &mut work);
    let within = MOST_PX.min(rows / 2).min(cols / 2) as isize;
    let at = |d: [isize; 2]| {
        let [r, c] = [0, 1].map(|a| d[a].rem_euclid(size[a] as isize) as usize);
        fits[r * size[1] + c]
    };
    let all = (-within..=within).flat_map(|r| (-within..=within).map(move |c| [r, c]));
    let best = all.max_by(|a, b| at(*a).total_cmp(&at(*b)))?;
    (at(best) > BETTER * at([0, 0]).max(0.0)).then_some(best)
}

/// Light for tests.
#[cfg(test)]
pub(super) mod testing {
    use ndarray::Array2;

    /// Nine foci on [60, 72] pixels, displaced by (row, col) pixels.
    pub(in super::super) fn foci(moved: [f32; 2]) -> Array2<f32> {
        Array2::from_shape_fn((60, 72), |(r, c)| {
            let light = |i: usize| {
                let [y, x] = [(i * 23 % 44 + 8) as f32 + moved[0], (i * 31 % 56 + 8) as f32 + moved[1]];
                (-((r as f32 - y).powi(2) + (c as f32 - x).powi(2)) / 3.0).exp()
            };
            (0..9).map(|i| 300.0 * light(i)).sum::<f32>()
        })
    }
}
