//! Errors of a model on bead windows, for all ranks at once: sums of squares from which NRMSE follows with and without
//! a free scale for each bead.

use super::lens_fit::LensFit;
use super::planes::Plane;
use crate::psf::windows::{BeadScale, LensWindows};
use ndarray::{Array1, Array2, ArrayView2, Axis, CowArray, Zip, s};

/// Pixels per chunk of a sum.
const CHUNK_PX: usize = 4096;

/// Sums of products over the pixels of each bead, for rank 1, 2, ...
#[derive(Clone, Debug)]
pub struct Misfit {
    /// `<prediction, measured>`, [bead, rank].
    pt: Array2<f64>,
    /// `<prediction, prediction>`, [bead, rank].
    pp: Array2<f64>,
    /// `<measured, measured>`, [bead].
    tt: Array1<f64>,
    /// Expected sum of squares of the noise, [bead].
    noise: Array1<f64>,
}

impl Misfit {
    pub(super) fn new(beads: usize, ranks: usize) -> Self {
        Self {
            pt: Array2::zeros((beads, ranks)),
            pp: Array2::zeros((beads, ranks)),
            tt: Array1::zeros(beads),
            noise: Array1::zeros(beads),
        }
    }

    fn add(mut self, other: &Self) -> Self {
        self.pt += &other.pt;
        self.pp += &other.pp;
        self.tt += &other.tt;
        self.noise += &other.noise;
        self
    }

    /// The beads of both halves of a hold-out, one half after the other.
    pub fn join(&self, other: &Self) -> Self {
        let two = |a: &Array2<f64>, b: &Array2<f64>| {
            let ranks = a.ncols().min(b.ncols());
            ndarray::concatenate![Axis(0), a.slice(s![.., ..ranks]), b.slice(s![.., ..ranks])]
        };
        Self {
            pt: two(&self.pt, &other.pt),
            pp: two(&self.pp, &other.pp),
            tt: ndarray::concatenate![Axis(0), self.tt, other.tt],
            noise: ndarray::concatenate![Axis(0), self.noise, other.noise],
        }
    }

    /// Number of ranks; the first is rank 1.
    pub fn ranks(&self) -> usize {
        self.pt.ncols()
    }

    /// Squared misfit of bead `n` at `rank` (1 or more), DN^2.
    fn squared(&self, n: usize, rank: usize, scale: BeadScale) -> f64 {
        let (pt, pp, tt) = (self.pt[[n, rank - 1]], self.pp[[n, rank - 1]], self.tt[n]);
        match scale {
            BeadScale::Physical => (tt - 2.0 * pt + pp).max(0.0),
            BeadScale::PerFrame if pp > 0.0 => (tt - pt * pt / pp).max(0.0),
            BeadScale::PerFrame => tt,
        }
    }

    /// NRMSE over all beads at `rank` (1 or more).
    pub fn nrmse(&self, rank: usize, scale: BeadScale) -> f64 {
        let misfit: f64 = (0..self.tt.len()).map(|n| self.squared(n, rank, scale)).sum();
        (misfit / self.tt.sum()).sqrt()
    }

    /// NRMSE of each bead at `rank`.
    pub fn by_bead(&self, rank: usize, scale: BeadScale) -> Array1<f32> {
        Array1::from_shape_fn(self.tt.len(), |n| {
            (self.squared(n, rank, scale) / self.tt[n].max(f64::MIN_POSITIVE)).sqrt() as f32
        })
    }

    /// Scatter of the brightness of the beads about the predicted one at `rank`, relative, and the part of it that
    /// noise causes, for windows of `pixels` pixels in all. The scatter is about the median and robust: noise in a
    /// prediction makes all beads look alike too dim, and the windows of a few may be cut off.
    pub fn brightness_scatter(&self, rank: usize, pixels: usize) -> [f64; 2] {
        let k = rank - 1;
        let lit: Vec<usize> = (0..self.tt.len()).filter(|n| self.pp[[*n, k]] > 0.0).collect();
        let scales: Vec<f64> = lit.iter().map(|n| self.pt[[*n, k]] / self.pp[[*n, k]]).collect();
        let centre = median(scales.clone());
        let scatter = 1.4826 * median(scales.iter().map(|a| (a - centre).abs()).collect()) / centre.abs();
        // Photon noise is about twice as strong, in amplitude, where the light is; the prediction has as much of it.
        let noise = lit.iter().map(|n| 8.0 * self.noise[*n] / (pixels.max(1) as f64 * self.pp[[*n, k]]));
        [scatter, median(noise.collect()).sqrt()]
    }

    /// NRMSE that the noise of the measured windows alone causes: a lower limit of [`Self::nrmse`].
    pub fn noise_floor(&self) -> f64 {
        (self.noise.sum() / self.tt.sum()).sqrt()
    }

    /// The smallest rank whose squared misfit exceeds the least one by at most a thousandth.
    pub fn best_rank(&self, scale: BeadScale) -> usize {
        let squares: Vec<f64> = (1..=self.ranks()).map(|k| self.nrmse(k, scale).powi(2)).collect();
        let least = squares.iter().fold(f64::INFINITY, |m, v| m.min(*v));
        1 + squares.iter().position(|v| *v <= 1.001 * least).unwrap_or(0)
    }
}

/// The median; NaN of nothing.
fn median(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    values.get(values.len() / 2).copied().unwrap_or(f64::NAN)
}

/// Misfit of a TSVD at those of `beads` that were fitted, with the coefficients of the decomposition: the approximation
/// error of Eq. 2.
pub fn approximation(windows: &LensWindows, fit: &LensFit, beads: &[usize]) -> Misfit {
    let found = misfit(windows, &fit.beads, &fit.decomposition.basis, fit.decomposition.coefficients.view());
    let mut all = Misfit::new(beads.len(), found.ranks());
    for (i, bead) in beads.iter().enumerate() {
        let Some(from) = fit.beads.iter().position(|b| b == bead) else { continue };
        all.pt.row_mut(i).assign(&found.pt.row(from));
        all.pp.row_mut(i).assign(&found.pp.row(from));
        (all.tt[i], all.noise[i]) = (found.tt[from], found.noise[from]);
    }
    all
}

/// Misfit at beads whose coefficients come from the smooth fields: `fields` holds [bead, k] for each plane.
pub fn predicted(windows: &LensWindows, fit: &LensFit, fields: &[Array2<f64>], planes: &[Plane]) -> Misfit {
    let basis = &fit.decomposition.basis;
    let parts = fields.iter().zip(planes).map(|(c, plane)| misfit(windows, &plane.beads, basis, c.view()));
    parts.fold(Misfit::new(0, basis.nrows()), |all, part| all.join(&part))
}

/// Adds up the misfits of lenses, up to the largest rank that all of them have.
pub fn sum_over_lenses(parts: &[Misfit]) -> Misfit {
    let ranks = parts.iter().map(Misfit::ranks).min().unwrap_or(0);
    let beads = parts.first().map_or(0, |p| p.tt.len());
    let cut = |m: &Misfit| Misfit {
        pt: m.pt.slice(s![.., ..ranks]).to_owned(),
        pp: m.pp.slice(s![.., ..ranks]).to_owned(),
        ..m.clone()
    };
    parts.iter().fold(Misfit::new(beads, ranks), |sum, m| sum.add(&cut(m)))
}

/// Misfit of `coefficients` [bead, k] times `basis` [k, px] at `beads`, for each rank; unmeasured pixels do not count.
///
/// All sums follow from `<basis, measured>` and `<basis, basis>` in f64; predictions are never formed.
pub(super) fn misfit(
    windows: &LensWindows,
    beads: &[usize],
    basis: &Array2<f32>,
    coefficients: ArrayView2<'_, f64>,
) -> Misfit {
    let ranks = basis.nrows();
    let mut out = Misfit::new(beads.len(), ranks);
    let mut with_measured = Array2::<f64>::zeros((beads.len(), ranks));
    let mut with_itself = Array2::<f64>::zeros((ranks, ranks));
    let px = basis.ncols();
    for first in (0..px).step_by(CHUNK_PX) {
        let here = s![.., first..(first + CHUNK_PX).min(px)];
        let part = basis.slice(here).mapv(f64::from);
        let mut measured = windows.light_dn.slice(here).select(Axis(0), beads).mapv(f64::from);
        if let Some(known) = &windows.known {
            Zip::from(&mut measured).and(&known.slice(here).select(Axis(0), beads)).for_each(|v, k| {
                if !k {
                    *v = 0.0;
                }
            });
        }
        with_measured += &measured.dot(&part.t());
        with_itself += &part.dot(&part.t());
        out.tt += &measured.mapv(|v| v * v).sum_axis(Axis(1));
    }
    let noise = windows.variance_dn2.sum();
    for (i, bead) in beads.iter().enumerate() {
        let known = windows.known.as_ref().map(|k| k.row(*bead));
        let missing: Vec<usize> = known.map_or_else(Vec::new, |k| (0..px).filter(|p| !k[*p]).collect());
        let lost = basis.select(Axis(1), &missing).mapv(f64::from);
        let norms = if missing.is_empty() {
            with_itself.view().into()
        } else {
            CowArray::from(&with_itself - &lost.dot(&lost.t()))
        };
        out.noise[i] = noise - missing.iter().map(|p| windows.variance_dn2[*p]).sum::<f64>();
        let (mut pt, mut pp) = (0.0, 0.0);
        for k in 0..ranks {
            let c = coefficients[[i, k]];
            pt += c * with_measured[[i, k]];
            let crossed: f64 = (0..k).map(|j| coefficients[[i, j]] * norms[[j, k]]).sum();
            pp += c * (c * norms[[k, k]] + 2.0 * crossed);
            (out.pt[[i, k]], out.pp[[i, k]]) = (pt, pp);
        }
    }
    out
}
