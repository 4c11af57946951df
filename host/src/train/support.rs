//! Filters that a device can afford: each kernel holds a few blocks of lags and nothing else.

use super::ops::fourier::{Fourier, Spectrum};
use super::weights::FILTERS;
use crate::artifact::Tensors;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

/// The lags that filters may have. A tap (dy, dx) covers the lags `l - d S`, `-S/2 <= l < S/2`, S = tile / 2, of its channel's kernel
/// (`ommatidia_shared::filter`).
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Support {
    /// Side of the device's transforms, pixels.
    pub tile: usize,
    /// Taps: channel, block row, block column.
    pub taps: Vec<(u8, i8, i8)>,
}

/// The lags of a tap: index in the whole kernel (T x T), and lag relative to the tap, rows and columns.
pub fn lags(t: usize, step: usize, [dy, dx]: [i8; 2]) -> impl Iterator<Item = (usize, [i32; 2])> {
    let (half, t, s) = (step as i32 / 2, t as i32, step as i32);
    // The kernel's own lags are -T/2 <= lag < T/2, so the outermost blocks are cut short.
    let along = move |d: i8| {
        (-half..half).map(move |l| (l - i32::from(d) * s, l)).filter(move |(lag, _)| (-t / 2..t / 2).contains(lag))
    };
    along(dy).flat_map(move |(y, ly)| {
        along(dx).map(move |(x, lx)| ((y.rem_euclid(t) * t + x.rem_euclid(t)) as usize, [ly, lx]))
    })
}

impl Support {
    /// Takes all other lags out of the filters among `tensors`: the nearest filters that the taps can hold.
    pub fn project(&self, plan: &Fourier, tensors: &mut Tensors) {
        let (sizes, step) = (plan.sizes(), self.tile / 2);
        let (t, c) = (sizes.filter_size, sizes.channels);
        let mut kept = vec![false; c * t * t];
        for &(channel, dy, dx) in &self.taps {
            lags(t, step, [dy, dx]).for_each(|(at, _)| kept[usize::from(channel) * t * t + at] = true);
        }
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

    #[test]
    fn what_is_projected_lies_in_the_taps_and_stays() {
        let network = NetworkConfig { channels: 2, ..Preset::Nano.network([20, 24], [8, 8]) };
        let (plan, t) = (Fourier::new(network.fourier()), 32);
        let support = Support { tile: 16, taps: vec![(0, 0, 0), (0, 1, -2), (1, 0, 1)] };
        let mut tensors = weights::random(&network, 3);
        support.project(&plan, &mut tensors);
        let kernels = |tensors: &Tensors| -> Vec<f32> {
            let [re, im] = FILTERS.map(|f| tensors[f].as_slice().unwrap().to_vec());
            plan.filters(&re, &im).into_iter().flat_map(|s| plan.whole(s)).collect()
        };
        let first = kernels(&tensors);
        let lit = |channel: usize| first[channel * t * t..][..t * t].iter().filter(|v| v.abs() > 1e-9).count();
        // The third block of columns is cut in half by the end of the kernel.
        assert!(lit(0) > 90 && lit(0) <= 96 && lit(1) > 50 && lit(1) <= 64, "{} {}", lit(0), lit(1));
        support.project(&plan, &mut tensors);
        assert!(first.iter().zip(kernels(&tensors)).all(|(a, b)| (a - b).abs() < 1e-8));
    }
}
