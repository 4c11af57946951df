//! The filters as the bank of a device: one transform of the whole padded frame, or small transforms and taps.

use super::{QuantizeConfig, QuantizeError, narrow, pack};
use crate::artifact::Tensors;
use crate::evaluate::Case;
use crate::train::ops::fourier::Fourier;
use crate::train::weights::FILTERS;
use crate::train::{Checkpoint, Sight, Support, lags};
use ndarray::ArrayD;
use ommatidia_shared::blob::{Bank, MAX_TAPS, Tap};
use ommatidia_shared::num::f16;
use rustfft::num_complex::Complex32;
use rustfft::{Fft, FftPlanner};
use std::sync::Arc;

/// Part of the energy that taps keep where nothing else is asked for.
const ENERGY: f64 = 0.95;

/// A filter bank, ready to be written down.
pub struct PlannedBank {
    tile: usize,
    step: usize,
    channels: usize,
    taps: Vec<(Tap, Vec<Complex32>)>,
    /// Part of the filters' energy that the taps keep.
    pub energy_kept: f64,
    /// All spectra are multiplied by two to this power, so that the largest output is near 1.
    pub scale_log2: i32,
    /// The filters that the taps stand for, by the names of the checkpoint.
    pub filters: Tensors,
}

impl PlannedBank {
    /// Plans the bank of a checkpoint.
    ///
    /// # Errors
    /// The transform's side is no power of two, or the taps cannot keep the energy that is asked for.
    pub fn new(checkpoint: &Checkpoint, config: &QuantizeConfig) -> Result<Self, QuantizeError> {
        let t = checkpoint.body.network.filter_size;
        let tile = config.tile.unwrap_or(t);
        if !tile.is_power_of_two() || tile > t || tile < 8 {
            return Err(QuantizeError::Size {
                field: "tile",
                expected: format!("a power of two from 8 to {t}"),
                found: tile,
            });
        }
        if !t.is_power_of_two() {
            return Err(QuantizeError::Size { field: "filter_size", expected: "a power of two".into(), found: t });
        }
        let spectra: Vec<Vec<Complex32>> = spectra(checkpoint).into_iter().map(|s| hermitian(s, t)).collect();
        // Filters that were held to these taps keep all of them.
        let held = checkpoint.body.support.as_ref().is_some_and(|s| s.tile == tile);
        let energy = config.energy.unwrap_or(if held { 1.0 - 1e-6 } else { ENERGY });
        let mut bank = if tile == t { dense(t, spectra) } else { tapped(t, tile, &spectra, energy)? };
        bank.scale_log2 = scale_log2(checkpoint, &bank.filters);
        Ok(bank)
    }

    /// The spectra in the order of the taps, scaled, each T rows of T/2+1 complex halves.
    ///
    /// # Errors
    /// A value leaves the range of halves.
    pub fn spectra(&self) -> Result<Vec<f16>, QuantizeError> {
        let scale = 2f32.powi(self.scale_log2);
        let values = self.taps.iter().flat_map(|(_, s)| s).flat_map(|v| [v.re * scale, v.im * scale]);
        pack::halves("spectra", values)
    }

    /// Its shape.
    ///
    /// # Errors
    /// A size is too large.
    pub fn describe(&self) -> Result<Bank, QuantizeError> {
        let channels = narrow("channels", self.channels)?;
        let mut bank = Bank {
            tile: narrow("tile", self.tile)?,
            step: narrow("step", self.step)?,
            channels,
            taps: Default::default(),
        };
        for (tap, _) in &self.taps {
            let found = self.taps.len();
            bank.taps.push(*tap).map_err(|_| QuantizeError::Size {
                field: "taps",
                expected: format!("at most {MAX_TAPS}"),
                found,
            })?;
        }
        Ok(bank)
    }

    /// The lags that the taps hold.
    pub fn support(&self) -> Support {
        let taps = self.taps.iter().map(|(tap, _)| (tap.channel, tap.dy, tap.dx)).collect();
        Support { tile: self.tile, taps }
    }

    /// Number of taps.
    pub fn taps(&self) -> usize {
        self.taps.len()
    }
}

/// The filters of a checkpoint, [channel][T rows of T/2+1].
fn spectra(checkpoint: &Checkpoint) -> Vec<Vec<Complex32>> {
    let part = |name| checkpoint.weights.get(name).map_or_else(Vec::new, |t: &ArrayD<f32>| t.iter().copied().collect());
    let [re, im]: [Vec<f32>; 2] = FILTERS.map(part);
    let all: Vec<Complex32> = re.iter().zip(&im).map(|(&re, &im)| Complex32::new(re, im)).collect();
    let t = checkpoint.body.network.filter_size;
    all.chunks_exact(t * (t / 2 + 1)).map(<[Complex32]>::to_vec).collect()
}

/// The same filter with columns of frequency zero and Nyquist made those of a real kernel. Only this part of them reaches a real image,
/// since the frame's spectrum has the same symmetry.
fn hermitian(mut spectrum: Vec<Complex32>, t: usize) -> Vec<Complex32> {
    let bins = t / 2 + 1;
    for col in [0, t / 2] {
        let column: Vec<Complex32> = (0..t).map(|row| spectrum[row * bins + col]).collect();
        for row in 0..t {
            spectrum[row * bins + col] = 0.5 * (column[row] + column[(t - row) % t].conj());
        }
    }
    spectrum
}

fn dense(t: usize, spectra: Vec<Vec<Complex32>>) -> PlannedBank {
    let filters = tensors(t, &spectra);
    let taps: Vec<_> = (0u8..).zip(spectra).map(|(channel, s)| (Tap { channel, dy: 0, dx: 0 }, s)).collect();
    PlannedBank { tile: t, step: t, channels: taps.len(), taps, energy_kept: 1.0, scale_log2: 0, filters }
}

/// Cuts each filter's kernel into blocks of `tile / 2` lags and keeps the blocks with the most energy.
///
/// A tap (dy, dx) covers the lags `l - dy S`, `-S/2 <= l < S/2`, of its channel's kernel ([`ommatidia_shared::filter`]).
fn tapped(t: usize, tile: usize, spectra: &[Vec<Complex32>], energy: f64) -> Result<PlannedBank, QuantizeError> {
    let (full, small, step) = (Plane::new(t), Plane::new(tile), tile / 2);
    let mut kernels: Vec<Vec<f32>> = spectra.iter().map(|s| full.inverse(s)).collect();
    let reach = (t / 2 / step) as i32;
    let mut blocks: Vec<(f64, Tap)> = Vec::new();
    for (channel, kernel) in (0u8..).zip(&kernels) {
        for (dy, dx) in (-reach..=reach).flat_map(|dy| (-reach..=reach).map(move |dx| (dy as i8, dx as i8))) {
            let tap = Tap { channel, dy, dx };
            blocks.push((lags(t, step, [dy, dx]).map(|(at, _)| f64::from(kernel[at]).powi(2)).sum(), tap));
        }
    }
    let total: f64 = blocks.iter().map(|b| b.0).sum();
    blocks.sort_by(|a, b| b.0.total_cmp(&a.0));
    // No channel may go without a tap: the best of each comes first.
    let mut seen = vec![false; spectra.len()];
    let (best, rest): (Vec<_>, Vec<_>) =
        blocks.into_iter().partition(|(_, tap)| !std::mem::replace(&mut seen[usize::from(tap.channel)], true));
    let mut blocks = [best, rest].concat();
    let (mut kept, mut count) = (0.0, 0);
    while count < spectra.len().min(MAX_TAPS) || (kept < energy * total && count < blocks.len().min(MAX_TAPS)) {
        kept += blocks[count].0;
        count += 1;
    }
    if kept < energy * total {
        return Err(QuantizeError::Energy { tile, expected: energy, found: kept / total, most: MAX_TAPS });
    }
    for (_, tap) in blocks.drain(count..) {
        lags(t, step, [tap.dy, tap.dx]).for_each(|(at, _)| kernels[usize::from(tap.channel)][at] = 0.0);
    }
    let mut taps: Vec<_> =
        blocks.iter().map(|&(_, tap)| (tap, cut(&kernels[usize::from(tap.channel)], t, &small, step, tap))).collect();
    taps.sort_by_key(|(tap, _)| tap.order());
    let pruned: Vec<_> = kernels.iter().map(|k| full.forward(k)).collect();
    let filters = tensors(t, &pruned);
    Ok(PlannedBank { tile, step, channels: spectra.len(), taps, energy_kept: kept / total, scale_log2: 0, filters })
}

/// The spectrum of one tap.
fn cut(kernel: &[f32], t: usize, small: &Plane, step: usize, tap: Tap) -> Vec<Complex32> {
    let tile = small.side as i32;
    let mut block = vec![0.0; small.side * small.side];
    for (at, [y, x]) in lags(t, step, [tap.dy, tap.dx]) {
        block[(y.rem_euclid(tile) * tile + x.rem_euclid(tile)) as usize] = kernel[at];
    }
    small.forward(&block)
}

fn tensors(t: usize, spectra: &[Vec<Complex32>]) -> Tensors {
    let shape = [spectra.len(), t, t / 2 + 1];
    let part = |of: fn(&Complex32) -> f32| {
        let values: Vec<f32> = spectra.iter().flatten().map(of).collect();
        ArrayD::from_shape_vec(shape.to_vec(), values).unwrap_or_default()
    };
    FILTERS.map(String::from).into_iter().zip([part(|v| v.re), part(|v| v.im)]).collect()
}

/// The power of two that brings the largest output over the held-out frames near 1.
fn scale_log2(checkpoint: &Checkpoint, filters: &Tensors) -> i32 {
    let sight = Sight::new(&checkpoint.body, &checkpoint.maps);
    let plan = Fourier::new(checkpoint.body.network.fourier());
    let [re, im]: [Vec<f32>; 2] =
        FILTERS.map(|f| filters.get(f).map_or_else(Vec::new, |t| t.iter().copied().collect()));
    let filters = plan.filters(&re, &im);
    let largest = |case: &Case| {
        let x = plan.rfft2(&sight.normalised(case.frame_dn.view()), checkpoint.body.network.frame);
        plan.forward(&[x], &filters).iter().fold(0.0f32, |max, y| max.max(y.abs()))
    };
    let max = checkpoint.cases.iter().map(largest).fold(0.0, f32::max);
    if max > 0.0 { -(max.log2().round() as i32) } else { 0 }
}

/// Real 2-D transforms of one side, half spectra as T rows of T/2+1; not scaled forward, by 1/T^2 inverse.
struct Plane {
    side: usize,
    forward: Arc<dyn Fft<f32>>,
    inverse: Arc<dyn Fft<f32>>,
}

impl Plane {
    fn new(side: usize) -> Self {
        let mut planner = FftPlanner::new();
        Self { side, forward: planner.plan_fft_forward(side), inverse: planner.plan_fft_inverse(side) }
    }

    fn forward(&self, image: &[f32]) -> Vec<Complex32> {
        let full = self.both(&self.forward, image.iter().map(|&v| Complex32::new(v, 0.0)).collect());
        full.chunks_exact(self.side).flat_map(|row| row[..self.side / 2 + 1].to_vec()).collect()
    }

    fn inverse(&self, spectrum: &[Complex32]) -> Vec<f32> {
        let (t, bins) = (self.side, self.side / 2 + 1);
        let at = |row: usize, col: usize| {
            if col < bins { spectrum[row * bins + col] } else { spectrum[(t - row) % t * bins + t - col].conj() }
        };
        let full = (0..t * t).map(|i| at(i / t, i % t)).collect();
        let scale = 1.0 / (t * t) as f32;
        self.both(&self.inverse, full).iter().map(|v| v.re * scale).collect()
    }

    /// Along the rows, then along the columns.
    fn both(&self, fft: &Arc<dyn Fft<f32>>, mut plane: Vec<Complex32>) -> Vec<Complex32> {
        let t = self.side;
        for _ in 0..2 {
            fft.process(&mut plane);
            plane = (0..t * t).map(|i| plane[i % t * t + i / t]).collect();
        }
        plane
    }
}
