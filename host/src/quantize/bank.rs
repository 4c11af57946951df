//! The filter bank of a device: one transform of the whole padded frame, with spectra or pruned kernels as filters, or
//! small transforms with taps.

use super::choose::choose;
use super::pack::{self, narrow};
use super::plane::Plane;
use super::{QuantizeConfig, QuantizeError};
use crate::artifact::Tensors;
use crate::metrics::Case;
use crate::sensor::FrameError;
use crate::train::ops::fourier::Fourier;
use crate::train::weights::FILTERS;
use crate::train::{Checkpoint, FilterMask, block_lags, normalised, tap_lags};
use ndarray::ArrayD;
use ommatidia_shared::blob::{Bank, Blocks, MAX_TAPS, Tap};
use ommatidia_shared::num::f16;
use rustfft::num_complex::Complex32;

/// A filter bank, ready to be encoded.
pub struct PlannedBank {
    tile: usize,
    step: usize,
    channels: usize,
    taps: Vec<Tap>,
    form: Form,
    /// Lags that the filters keep; None: all.
    pub mask: Option<FilterMask>,
    /// Fraction of the filters' energy that is kept.
    pub energy_kept: f64,
    /// All filters are multiplied by 2 to this power, which brings the largest output near 1.
    pub scale_log2: i32,
    /// The filters after pruning, by their names in the checkpoint.
    pub filters: Tensors,
}

/// The form in which the file stores the filters.
enum Form {
    /// One spectrum for each tap.
    Spectra(Vec<Vec<Complex32>>),
    /// Blocks of lags of the kernels.
    Kernels { blocks: Blocks, lags: Vec<f32>, index: Vec<u16> },
}

impl PlannedBank {
    /// Plans the bank of a checkpoint.
    ///
    /// # Errors
    /// The side of the transform is not a power of two, or the filters cannot be kept as `config` asks.
    pub fn new(checkpoint: &Checkpoint, config: &QuantizeConfig) -> Result<Self, QuantizeError> {
        let sizes = checkpoint.body.network.fourier();
        let t = sizes.filter_size;
        if !t.is_power_of_two() {
            return Err(QuantizeError::Size { field: "filter_size", expected: "a power of two".into(), found: t });
        }
        let full = Plane::new(t);
        let spectra: Vec<Vec<Complex32>> = spectra(checkpoint).into_iter().map(|s| hermitian(s, t)).collect();
        let mut kernels: Vec<Vec<f32>> = spectra.iter().map(|s| full.inverse(s)).collect();
        let mask = choose(checkpoint, &kernels, config)?;
        let mut energy_kept = 1.0;
        if let Some(mask) = &mask {
            let energy = |kernels: &[Vec<f32>]| kernels.iter().flatten().map(|v| f64::from(*v).powi(2)).sum::<f64>();
            let all = energy(&kernels);
            let lags = kernels.iter_mut().flatten();
            lags.zip(mask.kept(&sizes)).filter(|(_, kept)| !kept).for_each(|(lag, _)| *lag = 0.0);
            energy_kept = if all > 0.0 { energy(&kernels) / all } else { 1.0 };
        }
        let pruned = || -> Vec<_> { kernels.iter().map(|k| full.forward(k)).collect() };
        let dense: Vec<Tap> = (0..sizes.channels as u8).map(|channel| Tap { channel, dy: 0, dx: 0 }).collect();
        let (tile, step, taps, form, filters) = match &mask {
            None => (t, t, dense, Form::Spectra(spectra.clone()), tensors(t, &spectra)),
            Some(FilterMask::Blocks { side, blocks }) => {
                let lags = blocks.iter().flat_map(|&(channel, row, col)| {
                    let kernel = &kernels[usize::from(channel)];
                    block_lags(&sizes, *side, [row, col]).map(|at| kernel[at])
                });
                let count = Blocks { side: narrow("block", *side)?, count: narrow("blocks", blocks.len())? };
                let index = index(blocks, sizes.channels, t / side);
                let form = Form::Kernels { blocks: count, lags: lags.collect(), index };
                (t, t, dense, form, tensors(t, &pruned()))
            }
            Some(FilterMask::Taps { tile, taps }) => {
                let (small, step) = (Plane::new(*tile), tile / 2);
                let mut taps: Vec<Tap> = taps.iter().map(|&(channel, dy, dx)| Tap { channel, dy, dx }).collect();
                taps.sort_by_key(|tap| tap.order());
                let spectra = taps.iter().map(|&tap| cut(&kernels[usize::from(tap.channel)], t, &small, step, tap));
                (*tile, step, taps.clone(), Form::Spectra(spectra.collect()), tensors(t, &pruned()))
            }
        };
        let mut bank =
            Self { tile, step, channels: sizes.channels, taps, form, mask, energy_kept, scale_log2: 0, filters };
        bank.scale_log2 = scale_log2(checkpoint, &bank.filters)?;
        Ok(bank)
    }

    /// The filters as the file stores them, and the index of the blocks: spectra in the order of the taps, each T rows
    /// of T/2+1 complex halves, with an empty index; or blocks of lags.
    ///
    /// # Errors
    /// A value is too large for a half.
    pub fn filters(&self) -> Result<(Vec<f16>, &[u16]), QuantizeError> {
        let scale = 2f32.powi(self.scale_log2);
        match &self.form {
            Form::Spectra(spectra) => {
                let values = spectra.iter().flatten().flat_map(|v| [v.re * scale, v.im * scale]);
                Ok((pack::halves("filters", values)?, &[]))
            }
            Form::Kernels { lags, index, .. } => {
                // The device scales the transform of a kernel by 1/T.
                let scale = scale * self.tile as f32;
                Ok((pack::halves("filters", lags.iter().map(|v| v * scale))?, index))
            }
        }
    }

    /// Shape of the bank, as the header stores it.
    ///
    /// # Errors
    /// A size is too large.
    pub fn describe(&self) -> Result<Bank, QuantizeError> {
        let mut bank = Bank {
            tile: narrow("tile", self.tile)?,
            step: narrow("step", self.step)?,
            channels: narrow("channels", self.channels)?,
            taps: Default::default(),
            blocks: match self.form {
                Form::Spectra(_) => None,
                Form::Kernels { blocks, .. } => Some(blocks),
            },
        };
        for tap in &self.taps {
            let found = self.taps.len();
            bank.taps.push(*tap).map_err(|_| QuantizeError::Size {
                field: "taps",
                expected: format!("at most {MAX_TAPS}"),
                found,
            })?;
        }
        Ok(bank)
    }
}

/// The filters of a checkpoint as spectra, [channel][T rows of T/2+1].
fn spectra(checkpoint: &Checkpoint) -> Vec<Vec<Complex32>> {
    let part = |name| checkpoint.weights.get(name).map_or_else(Vec::new, |t: &ArrayD<f32>| t.iter().copied().collect());
    let [re, im]: [Vec<f32>; 2] = FILTERS.map(part);
    let all: Vec<Complex32> = re.iter().zip(&im).map(|(&re, &im)| Complex32::new(re, im)).collect();
    let t = checkpoint.body.network.filter_size;
    all.chunks_exact(t * (t / 2 + 1)).map(<[Complex32]>::to_vec).collect()
}

/// The same filter with the columns of frequency zero and Nyquist made Hermitian, like those of a real kernel. The rest
/// of them does not contribute to a real image, since the frame's spectrum has the same symmetry.
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

/// Positions of sorted blocks as a compressed sparse row matrix of `rows` rows a channel
/// ([`ommatidia_shared::blob::Weights::index`]).
fn index(blocks: &[(u8, u16, u16)], channels: usize, rows: usize) -> Vec<u16> {
    let row_of = |&(channel, row, _): &(u8, u16, u16)| usize::from(channel) * rows + usize::from(row);
    let starts = (0..=channels * rows).map(|row| blocks.partition_point(|block| row_of(block) < row) as u16);
    starts.chain(blocks.iter().map(|block| block.2)).collect()
}

/// The spectrum of one tap of a kernel of side `t`.
fn cut(kernel: &[f32], t: usize, small: &Plane, step: usize, tap: Tap) -> Vec<Complex32> {
    let tile = small.side as i32;
    let mut block = vec![0.0; small.side * small.side];
    for (at, [y, x]) in tap_lags(t, step, [tap.dy, tap.dx]) {
        block[(y.rem_euclid(tile) * tile + x.rem_euclid(tile)) as usize] = kernel[at];
    }
    small.forward(&block)
}

/// Spectra as tensors with the names and the layout of the checkpoint.
fn tensors(t: usize, spectra: &[Vec<Complex32>]) -> Tensors {
    let shape = [spectra.len(), t, t / 2 + 1];
    let part = |of: fn(&Complex32) -> f32| {
        let values: Vec<f32> = spectra.iter().flatten().map(of).collect();
        ArrayD::from_shape_vec(shape.to_vec(), values).unwrap_or_default()
    };
    FILTERS.map(String::from).into_iter().zip([part(|v| v.re), part(|v| v.im)]).collect()
}

/// The exponent of the power of two that brings the largest output over the held-out frames near 1.
fn scale_log2(checkpoint: &Checkpoint, filters: &Tensors) -> Result<i32, QuantizeError> {
    let input = checkpoint.frame_input()?;
    let plan = Fourier::new(checkpoint.body.network.fourier());
    let [re, im]: [Vec<f32>; 2] =
        FILTERS.map(|f| filters.get(f).map_or_else(Vec::new, |t| t.iter().copied().collect()));
    let filters = plan.filters(&re, &im);
    let largest = |(index, case): (usize, &Case)| {
        let refused = |error: FrameError| QuantizeError::Case { index, detail: error.to_string() };
        let frame = normalised(&input, case.frame_dn.view()).map_err(refused)?;
        let x = plan.rfft2(&frame, checkpoint.body.network.frame);
        Ok(plan.forward(&[x], &filters).iter().fold(0.0f32, |max, y| max.max(y.abs())))
    };
    let all = checkpoint.cases.iter().enumerate().map(largest).collect::<Result<Vec<f32>, QuantizeError>>()?;
    let max = all.into_iter().fold(0.0, f32::max);
    Ok(if max > 0.0 { -(max.log2().round() as i32) } else { 0 })
}
