//! Choice of the lags that the filters keep.

use super::{QuantizeConfig, QuantizeError};
use crate::train::ops::fourier::FourierSizes;
use crate::train::{Checkpoint, FilterMask, block_lags, tap_lags};
use ommatidia_shared::blob::MAX_TAPS;

/// Fraction of the energy that taps keep by default.
const ENERGY: f64 = 0.95;

/// Side of the blocks that kernels are pruned to, lags. At a tenth of the bytes, blocks of 4 keep more of the
/// pseudo-inverses of the PSFs, and more of the quality after training, than blocks of 8 or 16 (docs/networks.md).
pub const BLOCK: usize = 4;

/// The lags to keep of kernels [channels][T, T]; None: all.
///
/// # Errors
/// The tile is not a side that devices support, the taps cannot keep the energy that `config` asks for, or the bytes do
/// not hold one block for each channel.
pub fn choose(
    checkpoint: &Checkpoint,
    kernels: &[Vec<f32>],
    config: &QuantizeConfig,
) -> Result<Option<FilterMask>, QuantizeError> {
    let sizes = checkpoint.body.network.fourier();
    let t = sizes.filter_size;
    match (&checkpoint.body.filter_mask, config.tile, config.prune) {
        (mask, None, None) => Ok(mask.clone()),
        (Some(FilterMask::Taps { tile, taps }), Some(asked), _) if *tile == asked && config.energy.is_none() => {
            Ok(Some(FilterMask::Taps { tile: asked, taps: taps.clone() }))
        }
        (_, Some(tile), _) => {
            if !tile.is_power_of_two() || tile > t || tile < 8 {
                let expected = format!("a power of two from 8 to {t}");
                return Err(QuantizeError::Size { field: "tile", expected, found: tile });
            }
            let energy = config.energy.unwrap_or(ENERGY);
            if tile == t { Ok(None) } else { taps(t, tile, kernels, energy).map(Some) }
        }
        (_, None, Some(part)) => {
            let dense = (kernels.len() * t * (t + 2) * 2) as f64;
            blocks(&sizes, kernels, (part * dense) as usize).map(Some)
        }
    }
}

/// Cuts each kernel into blocks of `tile / 2` lags and keeps the blocks with the most energy.
fn taps(t: usize, tile: usize, kernels: &[Vec<f32>], least: f64) -> Result<FilterMask, QuantizeError> {
    let step = tile / 2;
    let reach = (t / 2 / step) as i32;
    let mut parts = Vec::new();
    for (channel, kernel) in (0u8..).zip(kernels) {
        for (dy, dx) in (-reach..=reach).flat_map(|dy| (-reach..=reach).map(move |dx| (dy as i8, dx as i8))) {
            parts.push((energy(tap_lags(t, step, [dy, dx]).map(|(at, _)| kernel[at])), (channel, dy, dx)));
        }
    }
    let total: f64 = parts.iter().map(|p| p.0).sum();
    let (taps, kept) =
        strongest(parts, |tap| tap.0, kernels.len(), |count, kept| count < MAX_TAPS && kept < least * total);
    if kept < least * total {
        return Err(QuantizeError::Energy { tile, expected: least, found: kept / total, most: MAX_TAPS });
    }
    Ok(FilterMask::Taps { tile, taps })
}

/// Keeps the blocks with the most energy: as many as fit into `bytes`, index included.
fn blocks(sizes: &FourierSizes, kernels: &[Vec<f32>], bytes: usize) -> Result<FilterMask, QuantizeError> {
    let across = sizes.filter_size / BLOCK;
    let fixed = 2 * (kernels.len() * across + 1);
    let most = (bytes.saturating_sub(fixed) / (2 * BLOCK * BLOCK + 2)).min(usize::from(u16::MAX));
    if most < kernels.len() {
        let least = fixed + kernels.len() * (2 * BLOCK * BLOCK + 2);
        let expected = format!("{least} bytes or more, for a block a channel");
        return Err(QuantizeError::Size { field: "filters", expected, found: bytes });
    }
    let mut parts = Vec::new();
    for (channel, kernel) in (0u8..).zip(kernels) {
        for (row, col) in (0..across as u16).flat_map(|row| (0..across as u16).map(move |col| (row, col))) {
            parts.push((energy(block_lags(sizes, BLOCK, [row, col]).map(|at| kernel[at])), (channel, row, col)));
        }
    }
    let (mut blocks, _) = strongest(parts, |block| block.0, kernels.len(), |count, _| count < most);
    blocks.sort_unstable();
    Ok(FilterMask::Blocks { side: BLOCK, blocks })
}

/// Sum of squares.
fn energy(values: impl Iterator<Item = f32>) -> f64 {
    values.map(|v| f64::from(v).powi(2)).sum()
}

/// The parts with the most energy, and the energy that they keep, taken while `more(count, energy so far)`. The
/// strongest part of each channel is always taken.
fn strongest<P: Copy>(
    mut parts: Vec<(f64, P)>,
    channel: impl Fn(&P) -> u8,
    channels: usize,
    more: impl Fn(usize, f64) -> bool,
) -> (Vec<P>, f64) {
    parts.sort_by(|a, b| b.0.total_cmp(&a.0));
    let mut seen = vec![false; channels];
    let (best, rest): (Vec<_>, Vec<_>) =
        parts.into_iter().partition(|(_, p)| !std::mem::replace(&mut seen[usize::from(channel(p))], true));
    let (mut taken, mut kept) = (Vec::new(), 0.0);
    for (energy, part) in best.into_iter().chain(rest) {
        if taken.len() >= channels && !more(taken.len(), kept) {
            break;
        }
        kept += energy;
        taken.push(part);
    }
    (taken, kept)
}
