//! Start of the filters from the training pairs: the best linear filters by regression.
//!
//! Weights `m_c` that add up to one at each pixel divide the field into parts, one for each filter. Filter c is the
//! ridge regression, frequency by frequency, of the weighted object on the frame over all pairs:
//!
//! ```text
//! K_c = sum conj(X) F(m_c O) / (sum |X|^2 + lambda)
//! ```
//!
//! Where the parts of the field are uncorrelated this tends to `conj(H_c) S_c / (sum_r |H_r|^2 S_r + N)`: the Wiener
//! filter for the PSF of that part (S: power spectra of the object, N: of the noise), learned without any PSF. The
//! enhancement network then only has to join the parts.

use super::TrainError;
use super::loader::{Draw, Loader};
use super::weights::{FILTERS, array};
use crate::artifact::Tensors;
use rustfft::num_complex::Complex32;

/// Ridge parameter: the fraction of the frames' mean power that is added to the power at every frequency.
const RIDGE: f32 = 1e-4;

/// Root mean square of the values of a filter with a random start as in the paper: U[0, 1] x 0.001.
const RMS: f32 = 5.8e-4;

/// Number of pairs that are transformed at a time.
const CHUNK: usize = 16;

/// Replaces the filters among `tensors` by filters fitted to the given pairs; other tensors stay.
///
/// # Errors
/// A pair cannot be loaded or does not fit the network.
pub fn fit(loader: &Loader<'_>, pairs: &[usize], tensors: &mut Tensors) -> Result<(), TrainError> {
    let network = loader.network();
    let parts = parts(network.channels, network.object);
    let (t, bins) = (network.filter_size, network.filter_size / 2 + 1);
    let mut power = vec![0.0f32; t * bins];
    let mut cross = vec![vec![Complex32::default(); t * bins]; parts.len()];
    for (i, chunk) in pairs.chunks(CHUNK).enumerate() {
        for example in loader.examples(chunk, Draw { name: "regression", index: i as u64 })? {
            power.iter_mut().zip(example.input.spectrum()).for_each(|(p, x)| *p += x.norm_sqr());
            add_cross(loader, example.input.spectrum(), &example.target, &parts, &mut cross);
        }
    }
    let ridge = RIDGE * power.iter().sum::<f32>() / power.len() as f32;
    let (mut re, mut im) = (vec![0.0; parts.len() * t * bins], vec![0.0; parts.len() * t * bins]);
    for (c, cross) in cross.iter().enumerate() {
        for (i, (x, p)) in cross.iter().zip(&power).enumerate() {
            let k = x / (p + ridge);
            // Spectra lie [col frequency, row frequency], parameters the other way round.
            let at = (c * t + i % t) * bins + i / t;
            (re[at], im[at]) = (k.re, k.im);
        }
    }
    let mean = re.iter().chain(&im).map(|v| f64::from(*v).powi(2)).sum::<f64>() / (2 * re.len()) as f64;
    let scale = if mean > 0.0 { RMS / mean.sqrt() as f32 } else { 1.0 };
    for (name, mut values) in FILTERS.into_iter().zip([re, im]) {
        values.iter_mut().for_each(|v| *v *= scale);
        tensors.insert(name.into(), array(&[parts.len(), t, bins], values));
    }
    Ok(())
}

fn add_cross(loader: &Loader<'_>, x: &[Complex32], target: &[f32], parts: &[Vec<f32>], cross: &mut [Vec<Complex32>]) {
    use rayon::prelude::*;
    cross.par_iter_mut().zip(parts).for_each(|(cross, part)| {
        let object: Vec<f32> = target.iter().zip(part).map(|(o, m)| o * m).collect();
        let o = loader.plan.rfft2(&object, loader.network().object);
        cross.iter_mut().zip(x).zip(&o).for_each(|((sum, x), o)| *sum += x.conj() * o);
    });
}

/// Weights of the parts of the field, [part][object pixel]: bilinear interpolation weights of the centres of a grid of
/// `count` cells (the last row of the grid may have fewer); they add up to one at each pixel.
fn parts(count: usize, [rows, cols]: [usize; 2]) -> Vec<Vec<f32>> {
    let across = (count as f64).sqrt().ceil() as usize;
    let down = count.div_ceil(across);
    let mut parts = Vec::with_capacity(count);
    for i in 0..down {
        let in_row = if i + 1 < down { across } else { count - across * (down - 1) };
        for j in 0..in_row {
            let weight = |r: usize, c: usize| tent(r, rows, i, down) * tent(c, cols, j, in_row);
            parts.push((0..rows * cols).map(|p| weight(p / cols, p % cols)).collect());
        }
    }
    parts
}

/// Linear interpolation weight of cell `which` of `count` cells over `len` pixels: 1 at the centre of the cell (and
/// beyond the outermost centres), 0 at the centres of its neighbours.
fn tent(at: usize, len: usize, which: usize, count: usize) -> f32 {
    let x = ((at as f32 + 0.5) * count as f32 / len as f32 - 0.5).clamp(0.0, (count - 1) as f32);
    (1.0 - (x - which as f32).abs()).max(0.0)
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::super::ops::fourier::Fourier;
    use super::super::testing::foci;
    use super::super::{Preset, Task, weights};
    use super::*;
    use crate::noise::NoiseModel;
    use crate::sensor::SensorMaps;

    #[test]
    fn parts_add_up_to_one() {
        for count in [1, 2, 6, 7, 9] {
            let parts = parts(count, [12, 10]);
            assert_eq!(parts.len(), count);
            for p in 0..120 {
                assert!((parts.iter().map(|part| part[p]).sum::<f32>() - 1.0).abs() < 1e-6, "{count} parts, pixel {p}");
            }
        }
    }

    /// The summed output of the fitted filters resembles the object, although the frames do not.
    #[test]
    fn fitted_filters_deconvolve() {
        let pairs = foci(24, 40, 16, 10);
        let network = Preset::Nano.network([40, 40], [16, 16]);
        let plan = Fourier::new(network.fourier());
        let task = Task {
            source: &pairs,
            network: network.clone(),
            noise: NoiseModel::nominal(),
            maps: SensorMaps::default(),
        };
        let loader = Loader::new(&task, &plan, [4000.0, 5000.0], 3);
        let mut tensors = weights::random(&network, 1);
        fit(&loader, &(0..20).collect::<Vec<_>>(), &mut tensors).unwrap();
        let filters = plan.filters(tensors[FILTERS[0]].as_slice().unwrap(), tensors[FILTERS[1]].as_slice().unwrap());
        let example = loader.examples(&[22], Draw { name: "test", index: 0 }).unwrap().remove(0);
        let y = plan.forward(&[example.input.spectrum().to_vec()], &filters);
        let sum: Vec<f64> = (0..256).map(|p| (0..6).map(|c| f64::from(y[c * 256 + p])).sum()).collect();
        let truth: Vec<f64> = example.target.iter().map(|&v| f64::from(v)).collect();
        let mean = |v: &[f64]| v.iter().sum::<f64>() / v.len() as f64;
        let (ms, mt) = (mean(&sum), mean(&truth));
        let cov =
            |a: &[f64], ma: f64, b: &[f64], mb: f64| a.iter().zip(b).map(|(a, b)| (a - ma) * (b - mb)).sum::<f64>();
        let correlation = cov(&sum, ms, &truth, mt) / (cov(&sum, ms, &sum, ms) * cov(&truth, mt, &truth, mt)).sqrt();
        assert!(correlation > 0.5, "{correlation}");
    }
}
