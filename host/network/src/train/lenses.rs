//! Calibrated lenses for training: PSFs that filters start from, and the image that each lens alone would give.

use super::ops::fourier::{Fourier, Spectrum};
use super::weights::{BASIS, COEFFICIENTS, FILTERS, KERNELS, LOG_K, NODES, PSFS, array};
use super::{Architecture, Feedback, NetworkConfig, TrainError};
use ndarray::{Array1, Array2, ArrayView2, Axis, s};
use ommatidia_model::forward::{Forward, ForwardError};
use ommatidia_model::instrument::Instrument;
use ommatidia_model::psf::{LowRankOperator, LowRankPsf, OperatorError};
use ommatidia_session::artifact::Tensors;
use rustfft::num_complex::Complex32;

/// K of the pseudo-inverses `conj(H) / (|H|^2 + K)`, where the mean of |H|^2 is 1.
const K: f32 = 0.1;

/// Root mean square of the values of a filter with a random start as in the paper: U[0, 1] x 0.001.
const RMS: f32 = 5.8e-4;

/// The calibrated lenses of an instrument.
#[derive(Clone, Debug)]
pub struct Lenses {
    operator: LowRankOperator,
    psf: LowRankPsf,
    depth: usize,
}

impl Lenses {
    /// The lenses of an instrument.
    ///
    /// # Errors
    /// The instrument's model cannot be planned.
    pub fn of(instrument: &Instrument) -> Result<Self, ForwardError> {
        let depth = instrument.psf.depth_nearest(0.0);
        Ok(Self { operator: Forward::new(instrument)?.operator().clone(), psf: instrument.psf.clone(), depth })
    }

    /// `network` with `passes` passes in all, the first of them after `iterations` Richardson-Lucy iterations, with
    /// predictions from at most `terms` terms of each lens.
    pub fn with_feedback(
        &self,
        network: NetworkConfig,
        [passes, iterations]: [usize; 2],
        terms: usize,
    ) -> NetworkConfig {
        let corners = self.operator.corners().into_iter().flatten().map(|c| c.map(|v| v as i32)).collect();
        let (_, rank, window, _) = self.psf.basis.dim();
        let nodes = [self.psf.node_rows_px.len(), self.psf.node_cols_px.len()];
        let (passes, terms) = (passes.saturating_sub(1), terms.min(rank));
        let feedback = Feedback { passes, iterations, corners, terms, window, nodes };
        NetworkConfig { feedback: (passes + iterations > 0).then_some(feedback), ..network }
    }

    /// The calibrated tensors of a network with feedback: the strongest terms of each living lens. Predictions are
    /// scaled so that the largest coefficient is 1.
    pub fn feedback(&self, feedback: &Feedback) -> Tensors {
        let living: Vec<usize> =
            (0..self.operator.lenses()).filter(|l| self.operator.corners()[*l].is_some()).collect();
        let terms = feedback.terms;
        let basis = self.psf.basis.select(Axis(0), &living).slice(s![.., ..terms, .., ..]).to_owned();
        let coefficients = self.psf.coefficients.select(Axis(0), &living);
        let mut coefficients = coefficients.slice(s![.., ..terms, self.depth, .., ..]).to_owned();
        let most = coefficients.fold(0.0f32, |m, v| m.max(v.abs()));
        coefficients.mapv_inplace(|v| if most > 0.0 { v / most } else { v });
        let nodes = |nodes: &[f64]| nodes.iter().map(|&v| v as f32).collect::<Array1<f32>>().into_dyn();
        let [rows, cols] = NODES;
        Tensors::from([
            (BASIS.into(), basis.into_dyn()),
            (COEFFICIENTS.into(), coefficients.into_dyn()),
            (rows.into(), nodes(&self.psf.node_rows_px)),
            (cols.into(), nodes(&self.psf.node_cols_px)),
        ])
    }

    /// A CM2Net that crops the views of these lenses, with the other sizes of `network`.
    pub fn cm2net(&self, network: NetworkConfig) -> NetworkConfig {
        let crops: Vec<[i32; 2]> = self.operator.corners().into_iter().flatten().map(|c| c.map(|v| v as i32)).collect();
        NetworkConfig { channels: crops.len(), architecture: Architecture::Cm2Net { crops }, ..network }
    }

    /// The image that each living lens alone would give of an object, at the pixels of its crop: [lens, object rows,
    /// object cols] in C order, 0 off the sensor, divided by the largest value.
    ///
    /// # Errors
    /// The object has another shape than the instrument's.
    pub fn views(&self, object: ArrayView2<'_, f32>) -> Result<Vec<f32>, OperatorError> {
        let ([rows, cols], sensor) = (self.operator.object_shape(), self.operator.sensor_shape());
        let corners = self.operator.corners();
        let mut views = Vec::new();
        self.operator.each_lens(object, |l, image| {
            let corner = corners[l].unwrap_or([0, 0]);
            for (r, c) in (0..rows).flat_map(|r| (0..cols).map(move |c| (r, c))) {
                let at = [corner[0] + r as isize, corner[1] + c as isize];
                let inside = (0..2).all(|a| (0..sensor[a] as isize).contains(&at[a]));
                let from = [at[0] - image.origin[0], at[1] - image.origin[1]].map(|v| v as usize);
                views.push(if inside { image.light[from].max(0.0) } else { 0.0 });
            }
        })?;
        let most = views.iter().copied().fold(0.0, f32::max);
        if most > 0.0 {
            views.iter_mut().for_each(|v| *v /= most);
        }
        Ok(views)
    }

    /// PSFs of `channels` object pixels spread evenly over the field, as kernels [channels, T, T] with origin at
    /// element (0, 0). An object pixel and its image have the same position in the padded field, and the squares of
    /// each kernel sum to 1.
    ///
    /// # Errors
    /// The network has another size than the instrument.
    pub fn kernels(&self, network: &NetworkConfig) -> Result<Vec<f32>, OperatorError> {
        let t = network.filter_size;
        let [rows, cols] = self.operator.object_shape();
        let mut kernels = vec![0.0; network.channels * t * t];
        for ([r, c], kernel) in places(network.channels, [rows, cols]).into_iter().zip(kernels.chunks_exact_mut(t * t))
        {
            let mut point = Array2::zeros((rows, cols));
            point[[r, c]] = 1.0;
            let psf = self.operator.apply(point.view())?;
            let margin = |side: usize| (t - side) / 2;
            let lag =
                |p: usize, frame: usize, s: usize, object: usize| (p + margin(frame) + t - s - margin(object)) % t;
            for ((p, q), &v) in psf.indexed_iter() {
                kernel[lag(p, psf.nrows(), r, rows) * t + lag(q, psf.ncols(), c, cols)] += v;
            }
            let norm = kernel.iter().map(|v| v * v).sum::<f32>().sqrt();
            if norm > 0.0 {
                kernel.iter_mut().for_each(|v| *v /= norm);
            }
        }
        Ok(kernels)
    }

    /// Replaces the first layer among `tensors` by calibrated PSFs, or by their pseudo-inverses for architectures that
    /// learn filters.
    ///
    /// # Errors
    /// The network has another size than the instrument.
    pub fn start(&self, network: &NetworkConfig, plan: &Fourier, tensors: &mut Tensors) -> Result<(), TrainError> {
        let (t, bins, channels) = (network.filter_size, network.filter_size / 2 + 1, network.channels);
        let kernels = self.kernels(network).map_err(|source| TrainError::Config {
            field: "instrument",
            expected: "an instrument with the frame and object size of the network".into(),
            found: source.to_string(),
        })?;
        if network.architecture == Architecture::MultiWienerNet {
            tensors.insert(PSFS.into(), array(&[channels, t, t], kernels));
            tensors.insert(LOG_K.into(), array(&[channels], vec![K.ln(); channels]));
            return Ok(());
        }
        let inverse: Vec<Spectrum> = kernels.chunks_exact(t * t).map(|k| pseudo_inverse(plan, k, t)).collect();
        let mean =
            inverse.iter().flatten().map(|v| f64::from(v.norm_sqr())).sum::<f64>() / (channels * t * bins) as f64;
        let scale = if mean > 0.0 { RMS * std::f32::consts::SQRT_2 / mean.sqrt() as f32 } else { 1.0 };
        if network.architecture == Architecture::MultiFlatNet {
            let space = inverse.into_iter().flat_map(|s| plan.whole(s.into_iter().map(|v| v * scale).collect()));
            tensors.insert(KERNELS.into(), array(&[channels, t, t], space.collect()));
            return Ok(());
        }
        let (re, im) = plan.parts(&inverse);
        for (name, mut values) in FILTERS.into_iter().zip([re, im]) {
            values.iter_mut().for_each(|v| *v *= scale);
            tensors.insert(name.into(), array(&[channels, t, bins], values));
        }
        Ok(())
    }
}

/// Spectrum of the pseudo-inverse `conj(H) / (|H|^2 + K)`, K = 0.1, of a kernel [T, T] with transform H.
pub fn pseudo_inverse(plan: &Fourier, kernel: &[f32], t: usize) -> Spectrum {
    let h = plan.rfft2(kernel, [t, t]);
    h.iter().map(|h: &Complex32| h.conj() / (h.norm_sqr() + K)).collect()
}

/// Centres, [row, col], of `count` equal parts of a field of [rows, cols]: a grid that is as square as `count` allows.
fn places(count: usize, [rows, cols]: [usize; 2]) -> Vec<[usize; 2]> {
    let down = (1..=count).filter(|d| count.is_multiple_of(*d) && d * d <= count).max().unwrap_or(1);
    let across = count / down;
    let centre = |i: usize, of: usize, n: usize| ((2 * i + 1) * n) / (2 * of);
    (0..count).map(|i| [centre(i / across, down, rows), centre(i % across, across, cols)]).collect()
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use crate::train::Preset;

    #[test]
    fn places_are_spread_over_the_field() {
        assert_eq!(places(1, [10, 20]), [[5, 10]]);
        assert_eq!(places(6, [12, 12]), [[3, 2], [3, 6], [3, 10], [9, 2], [9, 6], [9, 10]]);
        assert_eq!(places(9, [96, 96])[4], [48, 48]);
    }

    /// Where the PSF does not vary, a frame is the object convolved with the kernel, and each view is the object
    /// itself.
    #[test]
    fn kernels_and_views_are_those_of_the_instrument() {
        let instrument = ommatidia_model::testing::square_array(3, [60, 60], [20, 20]);
        let lenses = Lenses::of(&instrument).unwrap();
        let network = NetworkConfig { channels: 1, ..Preset::Nano.network([60, 60], [20, 20]) };
        let plan = Fourier::new(network.fourier());
        let mut object = Array2::<f32>::zeros((20, 20));
        (object[[3, 4]], object[[15, 9]]) = (2.0, 1.0);
        let kernel = lenses.kernels(&network).unwrap();
        let k = plan.rfft2(&kernel, [64, 64]);
        let o = plan.rfft2(object.as_slice().unwrap(), [20, 20]);
        let image = plan.whole(k.iter().zip(&o).map(|(k, o)| k * o).collect());
        let frame = lenses.operator.apply(object.view()).unwrap();
        for ((r, c), v) in frame.indexed_iter() {
            assert!((image[(r + 2) * 64 + c + 2] * 3.0 - v).abs() < 1e-4, "{r} {c}");
        }
        let views = lenses.views(object.view()).unwrap();
        assert_eq!(views.len(), 9 * 400);
        for lens in 0..9 {
            assert!((views[lens * 400 + 3 * 20 + 4] - 1.0).abs() < 1e-5);
            assert!((views[lens * 400 + 15 * 20 + 9] - 0.5).abs() < 1e-5);
        }
        assert_eq!(lenses.cm2net(network).channels, 9);
    }
}
