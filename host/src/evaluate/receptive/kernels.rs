//! Learned filters in real space, and how they relate to pseudo-inverses of calibrated PSFs.

use super::artifact::FilterFigures;
use super::images::{pcc, to_one};
use crate::instrument::Instrument;
use crate::train::network::{Network, values};
use crate::train::ops::fourier::Fourier;
use crate::train::{Architecture, Checkpoint, Lenses, Mode, pseudo_inverse};
use ndarray::{Array2, Array3, ArrayView2};
use std::sync::Arc;

/// Learned filters, and pseudo-inverses of as many calibrated PSFs, in space: each [filter, T, T] with lag 0 in the
/// middle and the largest magnitude 1. Empty for a network without filters.
///
/// # Errors
/// The instrument has another size than the network.
pub(super) fn kernels(checkpoint: &Checkpoint, instrument: &Instrument) -> anyhow::Result<(Array3<f32>, Array3<f32>)> {
    let config = &checkpoint.body.network;
    if matches!(config.architecture, Architecture::Cm2Net { .. }) {
        return Ok((Array3::zeros((0, 0, 0)), Array3::zeros((0, 0, 0))));
    }
    let t = config.filter_size;
    let plan = Arc::new(Fourier::new(config.fourier()));
    let network = Network::new(config, &plan, &checkpoint.weights, Mode::Infer)?;
    let [re, im] = network.filters().map(values);
    let centred = |spectra: Vec<Vec<rustfft::num_complex::Complex32>>| {
        let mut out = Array3::zeros((spectra.len(), t, t));
        for (mut target, spectrum) in out.outer_iter_mut().zip(spectra) {
            let kernel = plan.whole(spectrum);
            let image = Array2::from_shape_fn((t, t), |(r, c)| kernel[(r + t / 2) % t * t + (c + t / 2) % t]);
            target.assign(&to_one(image));
        }
        out
    };
    let starts = Lenses::of(instrument)?.kernels(config)?;
    let inverses = starts.chunks_exact(t * t).map(|k| pseudo_inverse(&plan, k, t)).collect();
    Ok((centred(plan.filters(&re, &im)), centred(inverses)))
}

/// Figures of one filter in space, for lenses with this pitch.
pub(super) fn filter_figures(kernel: ArrayView2<'_, f32>, inverses: &Array3<f32>, pitch_px: f64) -> FilterFigures {
    let best = inverses.outer_iter().map(|i| pcc(kernel.iter(), i.iter()).abs()).fold(0.0, f64::max);
    let middle = (kernel.nrows() / 2) as f64;
    // Distance to the nearest multiple of the pitch, where that is at most two away.
    let off = |i: usize| {
        let lag = (i as f64 - middle) / pitch_px;
        (lag - lag.round().clamp(-2.0, 2.0)).abs() * pitch_px
    };
    let energy = |v: f32| f64::from(v).powi(2);
    let near = |r: usize, c: usize| off(r) <= pitch_px / 4.0 && off(c) <= pitch_px / 4.0;
    let on: f64 = kernel.indexed_iter().filter(|((r, c), _)| near(*r, *c)).map(|(_, v)| energy(*v)).sum();
    FilterFigures { pcc: best, on_lattice: on / kernel.iter().map(|v| energy(*v)).sum::<f64>().max(f64::MIN_POSITIVE) }
}

/// Share of the energy of the images `of` (each scaled to unit energy) that lies in the span of the images `by`, by
/// Gram-Schmidt orthogonalisation.
pub(super) fn share_in_span(of: &Array3<f32>, by: &Array3<f32>) -> f64 {
    let flat = |a: &Array3<f32>| -> Vec<Vec<f64>> {
        a.outer_iter().map(|i| i.iter().map(|&v| f64::from(v)).collect()).collect()
    };
    let dot = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
    let mut basis: Vec<Vec<f64>> = Vec::new();
    for mut v in flat(by) {
        let before = dot(&v, &v);
        for b in &basis {
            let part = dot(&v, b);
            v.iter_mut().zip(b).for_each(|(v, b)| *v -= part * b);
        }
        let left = dot(&v, &v);
        if left > 1e-9 * before {
            basis.push(v.into_iter().map(|x| x / left.sqrt()).collect());
        }
    }
    let all = flat(of);
    let inside = |v: &Vec<f64>| basis.iter().map(|b| dot(v, b).powi(2)).sum::<f64>() / dot(v, v).max(f64::MIN_POSITIVE);
    all.iter().map(inside).sum::<f64>() / all.len().max(1) as f64
}
