//! Where the light of frames lies, as compared with what is expected of them.

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
