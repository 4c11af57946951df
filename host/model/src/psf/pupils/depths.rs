//! What a scan at several depths says of pupils: how far their wavefronts bend with depth, and to which side.
//!
//! Depths of a scan may lie farther apart than the depth of field. Values between them, interpolated pixel by pixel,
//! are those of no optics then: a focus that widens and narrows again is a mixture of its neighbours. A pupil, fitted
//! to the PSFs of one depth, predicts those between; what it leaves of the calibrated ones is small, and is
//! interpolated.

use super::WAVELENGTH_UM;
use super::change::{FAINT, PupilModel, chosen_nodes, light, window};
use super::kernel::Kernel;
use crate::psf::LowRankPsf;
use ndarray::Array2;
use rayon::prelude::*;
use std::f64::consts::TAU;

/// Defocus for each um relative to that of a hard rim and of the usual wavelength: what soft rims and other wavelengths
/// make of it.
const FACTORS: [f64; 10] = [0.5, 0.6, 0.7, 0.8, 0.9, 1.0, 1.1, 1.25, 1.4, 1.6];
/// Steps that refine the best of them, and the first one, relative to the usual defocus.
const STEPS: usize = 5;
const FIRST_STEP: f64 = 0.07;
/// Index of Z_4 among the terms of a pupil.
const DEFOCUS: usize = 2;
/// Pupils say how PSFs change with depth if they leave at most this share of the change (root mean square).
const MOST_LEFT: f64 = 0.5;

/// How the wavefront of a lens bends with depth.
#[derive(Clone, Copy)]
struct Bend {
    /// Defocus of a source that is displaced by 1 um, with its sign, waves rms.
    waves_per_um: f64,
    /// Sums of squares over places and depths: of what this leaves of the change of the PSFs, and of the change.
    squares: [f64; 2],
}

impl PupilModel {
    /// With the defocus of each lens by depth, as the PSFs at all depths show it. None: pupils do not explain how PSFs
    /// change with depth.
    pub(super) fn with_depths(mut self, psf: &LowRankPsf) -> Option<Self> {
        let bends: Vec<Option<Bend>> = (0..self.lenses.len()).into_par_iter().map(|l| self.bend(psf, l)).collect();
        let [left, size] = [0, 1].map(|k| bends.iter().flatten().map(|b| b.squares[k]).sum::<f64>());
        self.scanned_waves_per_um = bends.iter().map(|b| b.map(|b| b.waves_per_um)).collect();
        (size > 0.0 && left <= MOST_LEFT * MOST_LEFT * size).then_some(self)
    }

    /// How the wavefront of a lens bends with depth. None: a dead lens.
    fn bend(&self, psf: &LowRankPsf, l: usize) -> Option<Bend> {
        let lens = self.lenses[l].as_ref()?;
        let (side, own, depths_um) = (psf.basis.dim().2, self.depth, &psf.node_depths_um);
        let kernel = Kernel::new(side, 1.3 * lens.radius);
        let waves = kernel.waves(side, lens.radius);
        let lit: Vec<Array2<f64>> = (0..depths_um.len()).map(|d| light(psf, l, d)).collect();
        let least = FAINT * lit[own].iter().fold(0.0f64, |m, v| m.max(*v));
        // At each place: the pupil, and how the PSF changes to the other depths, at equal light.
        let mut seen = Vec::new();
        for ([i, j], at) in chosen_nodes(psf) {
            if lit.iter().any(|lit| lit[[i, j]] <= least) {
                continue;
            }
            let at_depth = |d: usize| window(psf, [l, d, i, j]) / lit[d][[i, j]];
            let here = at_depth(own);
            let others = (0..depths_um.len()).filter(|d| *d != own);
            let changes: Vec<_> = others.map(|d| (depths_um[d] - depths_um[own], at_depth(d) - &here)).collect();
            seen.push((lens.at(at), changes));
        }
        let tried = |waves_per_um: f64| {
            let mut squares = [0.0; 2];
            for (pupil, changes) in &seen {
                let here = kernel.psf(&waves, pupil);
                let sum = here.sum().max(f64::MIN_POSITIVE);
                for (z_um, change) in changes {
                    let mut there = *pupil;
                    there.terms[DEFOCUS] += TAU * waves_per_um * z_um;
                    let by = (kernel.psf(&waves, &there) - &here) / sum;
                    squares[0] += change.iter().zip(&by).map(|(c, b)| (c - b) * (c - b)).sum::<f64>();
                    squares[1] += change.iter().map(|c| c * c).sum::<f64>();
                }
            }
            Bend { waves_per_um, squares }
        };
        let better = |a: Bend, b: Bend| if b.squares[0] < a.squares[0] { b } else { a };
        let usual = self.defocus_waves(l, 1.0, WAVELENGTH_UM);
        let signed = FACTORS.iter().flat_map(|f| [f * usual, -f * usual]);
        let mut best = signed.map(tried).reduce(better)?;
        // Towards the better neighbour, at half the distance each time.
        let mut step = FIRST_STEP * usual;
        for _ in 0..STEPS {
            best = [best.waves_per_um - step, best.waves_per_um + step].map(tried).into_iter().fold(best, better);
            step /= 2.0;
        }
        Some(best)
    }
}
