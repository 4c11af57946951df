//! Masks that limit filters to what a device can store: each kernel is 0 outside some blocks of lags.

use super::TrainError;
use super::ops::fourier::{Fourier, FourierSizes, Spectrum};
use super::weights::FILTERS;
use crate::artifact::Tensors;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

/// The lags at which the kernels of the filters may differ from 0.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(untagged, deny_unknown_fields)]
pub enum FilterMask {
    /// The lags of taps of small transforms. A tap (dy, dx) covers the lags `l - d S`, `-S/2 <= l < S/2`, S = tile / 2,
    /// of its channel's kernel (`ommatidia_shared::filter`).
    Taps {
        /// Side of the device's transforms, pixels.
        tile: usize,
        /// Taps: channel, block row, block column.
        taps: Vec<(u8, i8, i8)>,
    },
    /// The lags of blocks that a dense filter's kernel was pruned to. A block (row, col) covers the lags
    /// `B (row, col) + (0 .. B) - L` of its channel's kernel, L = floor((T - object) / 2): element 0 of the plane that
    /// a device transforms holds lag -L.
    Blocks {
        /// Side of a block, B lags.
        side: usize,
        /// Blocks: channel, block row, block column; sorted.
        blocks: Vec<(u8, u16, u16)>,
    },
}

/// The lags of a tap [dy, dx] with the given `step` in a kernel of side `t`: index in the kernel (T x T), and lag [row,
/// col] relative to the tap.
pub fn tap_lags(t: usize, step: usize, [dy, dx]: [i8; 2]) -> impl Iterator<Item = (usize, [i32; 2])> {
    let (half, t, s) = (step as i32 / 2, t as i32, step as i32);
    // The lags of the kernel are -T/2 <= lag < T/2, so the outermost taps are cut short.
    let along = move |d: i8| {
        (-half..half).map(move |l| (l - i32::from(d) * s, l)).filter(move |(lag, _)| (-t / 2..t / 2).contains(lag))
    };
    along(dy).flat_map(move |(y, ly)| {
        along(dx).map(move |(x, lx)| ((y.rem_euclid(t) * t + x.rem_euclid(t)) as usize, [ly, lx]))
    })
}

/// The lags of a block [row, col] of `side` x `side` lags as indices in the whole kernel (T x T), row by row.
pub fn block_lags(sizes: &FourierSizes, side: usize, block: [u16; 2]) -> impl Iterator<Item = usize> + use<> {
    let t = sizes.filter_size;
    let [first_row, first_col] =
        [0, 1].map(|axis| usize::from(block[axis]) * side + t - (t - sizes.object[axis].min(t)) / 2);
    (0..side * side).map(move |i| (first_row + i / side) % t * t + (first_col + i % side) % t)
}

impl std::fmt::Display for FilterMask {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Taps { tile, taps } => write!(f, "{} taps of {tile} x {tile}", taps.len()),
            Self::Blocks { side, blocks } => write!(f, "{} blocks of {side} x {side} lags", blocks.len()),
        }
    }
}

impl FilterMask {
    /// Checks that the mask fits a filter bank of these sizes.
    ///
    /// # Errors
    /// [`TrainError::Config`]: a channel or a block that the network does not have, or blocks that are not sorted.
    pub fn check(&self, sizes: &FourierSizes) -> Result<(), TrainError> {
        let t = sizes.filter_size;
        let wrong = |expected: String| Err(TrainError::Config { field: "support", expected, found: self.to_string() });
        match self {
            Self::Taps { tile, taps } => {
                if *tile < 2 || *tile > t || taps.iter().any(|tap| usize::from(tap.0) >= sizes.channels) {
                    return wrong(format!("taps of at most {t} x {t} of {} channels", sizes.channels));
                }
            }
            Self::Blocks { side, blocks } => {
                let across = t.checked_div(*side).unwrap_or(0);
                let inside = |&(channel, row, col): &(u8, u16, u16)| {
                    usize::from(channel) < sizes.channels && [row, col].iter().all(|&at| usize::from(at) < across)
                };
                let sorted = blocks.is_sorted_by(|a, b| a < b);
                if !sorted || across * side != t || !blocks.iter().all(inside) {
                    return wrong(format!("blocks of {} kernels of {t} x {t} lags, in order", sizes.channels));
                }
            }
        }
        Ok(())
    }

    /// Whether each lag of each kernel is kept, [channels, T, T].
    pub fn kept(&self, sizes: &FourierSizes) -> Vec<bool> {
        let t = sizes.filter_size;
        let mut kept = vec![false; sizes.channels * t * t];
        let mut keep = |channel: u8, at: usize| kept[usize::from(channel) * t * t + at] = true;
        match self {
            Self::Taps { tile, taps } => {
                for &(channel, dy, dx) in taps {
                    tap_lags(t, tile / 2, [dy, dx]).for_each(|(at, _)| keep(channel, at));
                }
            }
            Self::Blocks { side, blocks } => {
                for &(channel, row, col) in blocks {
                    block_lags(sizes, *side, [row, col]).for_each(|at| keep(channel, at));
                }
            }
        }
        kept
    }

    /// Sets all other lags of the filters among `tensors` to 0: the nearest filters that the mask allows.
    pub fn project(&self, plan: &Fourier, tensors: &mut Tensors) {
        let (kept, t) = (self.kept(&plan.sizes()), plan.sizes().filter_size);
        let [Some(mut re), Some(mut im)] = FILTERS.map(|name| tensors.remove(name)) else {
            return;
        };
        if let (Some(re), Some(im)) = (re.as_slice_mut(), im.as_slice_mut()) {
            let spectra: Vec<Spectrum> = plan.filters(re, im);
            let kernels: Vec<f32> = spectra
                .into_par_iter()
                .zip(kept.par_chunks_exact(t * t))
                .flat_map_iter(|(s, kept)| {
                    plan.whole(s).into_iter().zip(kept).map(|(v, k)| if *k { v } else { 0.0 }).collect::<Vec<_>>()
                })
                .collect();
            let (new_re, new_im) = plan.kernel_parts(&kernels);
            re.copy_from_slice(&new_re);
            im.copy_from_slice(&new_im);
        }
        tensors.extend(FILTERS.map(String::from).into_iter().zip([re, im]));
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use crate::train::{NetworkConfig, Preset, weights};

    /// Number of lags that are not 0 in each kernel after one projection; a second projection changes nothing.
    fn lit(mask: &FilterMask, network: &NetworkConfig) -> Vec<usize> {
        let (plan, t) = (Fourier::new(network.fourier()), network.filter_size);
        let mut tensors = weights::random(network, 3);
        mask.project(&plan, &mut tensors);
        let kernels = |tensors: &Tensors| -> Vec<f32> {
            let [re, im] = FILTERS.map(|f| tensors[f].as_slice().unwrap().to_vec());
            plan.filters(&re, &im).into_iter().flat_map(|s| plan.whole(s)).collect()
        };
        let first = kernels(&tensors);
        mask.project(&plan, &mut tensors);
        assert!(first.iter().zip(kernels(&tensors)).all(|(a, b)| (a - b).abs() < 1e-8));
        first.chunks_exact(t * t).map(|k| k.iter().filter(|v| v.abs() > 1e-9).count()).collect()
    }

    #[test]
    fn what_is_projected_lies_in_the_taps_and_stays() {
        let network = NetworkConfig { channels: 2, ..Preset::Nano.network([20, 24], [8, 8]) };
        let mask = FilterMask::Taps { tile: 16, taps: vec![(0, 0, 0), (0, 1, -2), (1, 0, 1)] };
        let lit = lit(&mask, &network);
        // The third block of columns is cut in half by the end of the kernel.
        assert!(lit[0] > 90 && lit[0] <= 96 && lit[1] > 50 && lit[1] <= 64, "{lit:?}");
    }

    #[test]
    fn what_no_network_has_is_refused() {
        let sizes = NetworkConfig { channels: 2, ..Preset::Nano.network([20, 24], [8, 8]) }.fourier();
        let blocks =
            |side, blocks: &[(u8, u16, u16)]| FilterMask::Blocks { side, blocks: blocks.to_vec() }.check(&sizes);
        assert!(blocks(4, &[(0, 0, 0), (0, 0, 7), (1, 7, 0)]).is_ok());
        for (side, wrong) in [(0, (0, 0, 0)), (3, (0, 0, 0)), (4, (2, 0, 0)), (4, (0, 8, 0)), (4, (0, 0, 8))] {
            assert!(blocks(side, &[wrong]).is_err(), "{side} {wrong:?}");
        }
        assert!(blocks(4, &[(1, 0, 0), (0, 0, 0)]).is_err());
        let taps = |tile, tap| FilterMask::Taps { tile, taps: vec![tap] }.check(&sizes);
        assert!(taps(16, (1, -9, 3)).is_ok());
        assert!(taps(16, (2, 0, 0)).is_err() && taps(64, (0, 0, 0)).is_err() && taps(0, (0, 0, 0)).is_err());
    }

    #[test]
    fn what_is_projected_lies_in_the_blocks_and_stays() {
        let network = NetworkConfig { channels: 2, ..Preset::Nano.network([20, 24], [8, 10]) };
        let mask = FilterMask::Blocks { side: 4, blocks: vec![(0, 3, 2), (0, 7, 7), (1, 0, 0)] };
        let lit = lit(&mask, &network);
        assert!(lit[0] > 28 && lit[0] <= 32 && lit[1] > 14 && lit[1] <= 16, "{lit:?}");
        // L = (12, 11): block (3, 2) begins at lag (0, -3), 29 columns round.
        let first: Vec<usize> = block_lags(&network.fourier(), 4, [3, 2]).take(5).collect();
        assert_eq!(first, [29, 30, 31, 0, 32 + 29]);
    }
}
