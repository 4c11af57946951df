//! Windows at scattered positions -> the low-rank model, with its error on positions that were left out.
//!
//! [`super::decompose`] knows no positions and [`super::field`] no PSFs; here they meet: the coefficients of each lens's
//! decomposition become smooth functions over the field.

use super::decompose::{Decomposition, decompose};
use super::field::FieldSmoother;
use crate::bead::{BeadScale, LensWindows};
use crate::linalg::NotConverged;
use ndarray::{Array1, Array2, ArrayView2, Axis, s};
use rayon::prelude::*;

/// How the model is fitted.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FitConfig {
    /// Terms a lens; None: chosen by held-out error.
    pub rank: Option<usize>,
    /// Most terms that are tried.
    pub max_rank: usize,
    /// Whether the errors leave one scale a bead free.
    pub scale: BeadScale,
}

impl Default for FitConfig {
    fn default() -> Self {
        Self { rank: None, max_rank: 32, scale: BeadScale::Physical }
    }
}

/// Beads at one depth: their indices and positions.
#[derive(Clone, Debug)]
pub struct Plane {
    /// Depth, um.
    pub z_um: f64,
    /// Indices of its beads.
    pub beads: Vec<usize>,
    /// Their positions, object pixels, [bead, (row, col)].
    pub at_px: Array2<f64>,
}

/// The fitted model of one lens.
#[derive(Clone, Debug)]
pub struct LensFit {
    /// Basis and coefficients at the beads.
    pub decomposition: Decomposition,
}

/// Sums of squares over beads, by rank 1, 2, ..: what NRMSE with and without a free scale a bead is made of.
#[derive(Clone, Debug)]
pub struct Misfit {
    /// `<prediction, measured>`, [bead, rank].
    pt: Array2<f64>,
    /// `<prediction, prediction>`, [bead, rank].
    pp: Array2<f64>,
    /// `<measured, measured>`, [bead].
    tt: Array1<f64>,
    /// Expected noise, [bead].
    noise: Array1<f64>,
}

impl Misfit {
    fn new(beads: usize, ranks: usize) -> Self {
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

    /// Both halves of a hold-out, bead after bead.
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

    /// Number of ranks, from 1.
    pub fn ranks(&self) -> usize {
        self.pt.ncols()
    }

    /// Squared misfit of bead `n` at `rank`.
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

    /// The part of [`Self::nrmse`] that the noise of the measured windows alone makes.
    pub fn noise_floor(&self) -> f64 {
        (self.noise.sum() / self.tt.sum()).sqrt()
    }

    /// The smallest rank whose squared misfit is within a thousandth of the least.
    pub fn best_rank(&self, scale: BeadScale) -> usize {
        let squares: Vec<f64> = (1..=self.ranks()).map(|k| self.nrmse(k, scale).powi(2)).collect();
        let least = squares.iter().fold(f64::INFINITY, |m, v| m.min(*v));
        1 + squares.iter().position(|v| *v <= 1.001 * least).unwrap_or(0)
    }
}

/// Decomposes the windows of one lens.
///
/// # Errors
/// The windows hold values that are no numbers.
pub fn fit_lens(windows: &LensWindows, beads: &[usize], max_rank: usize) -> Result<LensFit, NotConverged> {
    let light = windows.light_dn.select(Axis(0), beads);
    let known = windows.known.as_ref().map(|k| k.select(Axis(0), beads));
    let rank = max_rank.min(beads.len());
    let decomposition = decompose(light.view(), known.as_ref().map(|k| k.view()), sigma(windows).view(), rank)?;
    Ok(LensFit { decomposition })
}

/// Noise of each pixel; where the model says none, even.
fn sigma(windows: &LensWindows) -> Array1<f32> {
    let floor = 1e-6 * windows.variance_dn2.iter().fold(0.0f64, |m, v| m.max(*v));
    windows.variance_dn2.mapv(|v| if floor > 0.0 { v.max(floor).sqrt() as f32 } else { 1.0 })
}

/// Misfit of a TSVD at the beads that it was made of (coefficients as decomposed: the approximation error of Eq. 2).
pub fn approximation(windows: &LensWindows, fit: &LensFit, beads: &[usize]) -> Misfit {
    misfit(windows, beads, &fit.decomposition.basis, fit.decomposition.coefficients.view())
}

/// Misfit of one PSF for the whole field, the mean of the beads in `train`, at all others, over all living lenses.
pub fn one_psf(windows: &[LensWindows], dead: &[bool], train: &[bool]) -> Misfit {
    let (inside, outside): (Vec<usize>, Vec<usize>) = (0..train.len()).partition(|n| train[*n]);
    let living = windows.iter().zip(dead).filter(|(_, dead)| !**dead);
    let parts = living.map(|(w, _)| {
        let mean =
            w.light_dn.select(Axis(0), &inside).mean_axis(Axis(0)).unwrap_or_else(|| Array1::zeros(w.light_dn.ncols()));
        misfit(w, &outside, &mean.insert_axis(Axis(0)), Array2::ones((outside.len(), 1)).view())
    });
    sum_over_lenses(&parts.collect::<Vec<_>>())
}

/// Misfit at beads whose coefficients come from the smooth fields, [bead of the plane, k] a plane.
pub fn predicted(windows: &LensWindows, fit: &LensFit, fields: &[Array2<f64>], planes: &[Plane]) -> Misfit {
    let basis = &fit.decomposition.basis;
    let parts = fields.iter().zip(planes).map(|(c, plane)| misfit(windows, &plane.beads, basis, c.view()));
    parts.fold(Misfit::new(0, basis.nrows()), |all, part| all.join(&part))
}

/// Coefficients of one lens at `targets` (one array of positions a plane) from smooth fields through those at its beads.
///
/// `order` says which row of the decomposition each bead is.
///
/// # Errors
/// A coefficient is no number.
pub fn interpolate(
    fit: &LensFit,
    order: &[usize],
    planes: &[Plane],
    smoothers: &[FieldSmoother],
    targets: &[Array2<f64>],
) -> Result<Vec<Array2<f64>>, NotConverged> {
    let row_of = |bead: &usize| order.iter().position(|b| b == bead);
    planes
        .iter()
        .zip(smoothers)
        .zip(targets)
        .map(|((plane, smoother), target)| {
            let rows: Vec<usize> = plane.beads.iter().filter_map(row_of).collect();
            let here = fit.decomposition.coefficients.select(Axis(0), &rows);
            Ok(smoother.fit(here.view())?.at(target.view()))
        })
        .collect()
}

/// Misfit of the model fitted to the beads of `train` at all other beads of `planes`, over all living lenses.
///
/// # Errors
/// The windows hold values that are no numbers.
pub fn hold_out(
    windows: &[LensWindows],
    dead: &[bool],
    planes: &[Plane],
    train: &[bool],
    max_rank: usize,
    spline_order: usize,
) -> Result<Misfit, NotConverged> {
    let part = |keep: bool| -> Vec<Plane> {
        let planes = planes.iter().map(|p| {
            let rows: Vec<usize> = (0..p.beads.len()).filter(|i| train[p.beads[*i]] == keep).collect();
            Plane {
                z_um: p.z_um,
                beads: rows.iter().map(|i| p.beads[*i]).collect(),
                at_px: p.at_px.select(Axis(0), &rows),
            }
        });
        planes.collect()
    };
    let (fitted, left) = (part(true), part(false));
    let order: Vec<usize> = fitted.iter().flat_map(|p| p.beads.clone()).collect();
    let smoothers =
        fitted.iter().map(|p| FieldSmoother::plan(p.at_px.view(), &[spline_order])).collect::<Result<Vec<_>, _>>()?;
    let targets: Vec<Array2<f64>> = left.iter().map(|p| p.at_px.clone()).collect();
    let lenses: Vec<usize> = (0..windows.len()).filter(|l| !dead[*l]).collect();
    let parts = lenses
        .par_iter()
        .map(|l| {
            let fit = fit_lens(&windows[*l], &order, max_rank)?;
            let fields = interpolate(&fit, &order, &fitted, &smoothers, &targets)?;
            Ok(predicted(&windows[*l], &fit, &fields, &left))
        })
        .collect::<Result<Vec<_>, NotConverged>>()?;
    Ok(sum_over_lenses(&parts))
}

/// Adds up the misfits of lenses, up to the rank that all of them have.
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

/// Misfit of `coefficients` [bead, k] times `basis` [k, px] at `beads`, for each rank; unknown pixels do not count.
fn misfit(windows: &LensWindows, beads: &[usize], basis: &Array2<f32>, coefficients: ArrayView2<'_, f64>) -> Misfit {
    let ranks = basis.nrows();
    let mut out = Misfit::new(beads.len(), ranks);
    for (i, bead) in beads.iter().enumerate() {
        let known = |p: usize| windows.known.as_ref().is_none_or(|k| k[[*bead, p]]);
        let target = windows.light_dn.row(*bead);
        let mut prediction = Array1::<f32>::zeros(target.len());
        let sum = |f: &dyn Fn(usize) -> f64| (0..target.len()).filter(|p| known(*p)).map(f).sum::<f64>();
        out.tt[i] = sum(&|p| f64::from(target[p]).powi(2));
        out.noise[i] = sum(&|p| windows.variance_dn2[p]);
        for k in 0..ranks {
            prediction.scaled_add(coefficients[[i, k]] as f32, &basis.row(k));
            out.pt[[i, k]] = sum(&|p| f64::from(prediction[p]) * f64::from(target[p]));
            out.pp[[i, k]] = sum(&|p| f64::from(prediction[p]).powi(2));
        }
    }
    out
}

/// Splits beads in two halves so that each bead's neighbours are in the other one: a checkerboard on a regular scan, every
/// second bead in order of position otherwise.
pub fn checkerboard(planes: &[Plane], beads: usize) -> Vec<bool> {
    let mut train = vec![true; beads];
    for plane in planes {
        let (rows, cols) = (levels(plane.at_px.column(0)), levels(plane.at_px.column(1)));
        let count = |levels: &[usize]| levels.iter().max().map_or(0, |m| m + 1);
        let regular = count(&rows) * count(&cols) <= 2 * plane.beads.len();
        for (i, bead) in plane.beads.iter().enumerate() {
            train[*bead] = if regular { (rows[i] + cols[i]).is_multiple_of(2) } else { i.is_multiple_of(2) };
        }
    }
    train
}

/// Rank of each value among the distinct ones (a hundredth of a pixel is the same).
fn levels(values: ndarray::ArrayView1<'_, f64>) -> Vec<usize> {
    let mut distinct: Vec<i64> = values.iter().map(|v| (v * 100.0).round() as i64).collect();
    distinct.sort_unstable();
    distinct.dedup_by(|a, b| *a - *b <= 1);
    let rank = |v: &f64| distinct.partition_point(|d| *d < (v * 100.0).round() as i64 - 1);
    values.iter().map(rank).collect()
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;

    #[test]
    fn a_checkerboard_has_its_neighbours_in_the_other_half() {
        let at_px =
            Array2::from_shape_fn((20, 2), |(i, a)| if a == 0 { (i / 5) as f64 * 7.3 } else { (i % 5) as f64 * 7.3 });
        let plane = Plane { z_um: 0.0, beads: (0..20).collect(), at_px };
        let train = checkerboard(&[plane], 20);
        for i in 0..20 {
            assert!(i % 5 == 4 || train[i] != train[i + 1]);
            assert!(i >= 15 || train[i] != train[i + 5]);
        }
    }

    #[test]
    fn misfit_is_the_norm_of_the_difference_with_and_without_a_free_scale() {
        let windows = LensWindows {
            light_dn: ndarray::arr2(&[[3.0, 4.0, 100.0]]),
            known: Some(ndarray::arr2(&[[true, true, false]])),
            variance_dn2: ndarray::arr1(&[0.5, 0.5, 9.0]),
        };
        let basis = ndarray::arr2(&[[0.6, 0.8, 0.0], [0.8, -0.6, 0.0]]);
        let m = misfit(&windows, &[0], &basis, ndarray::arr2(&[[4.0, 0.5]]).view());
        assert!((m.nrmse(1, BeadScale::Physical) - 0.2).abs() < 1e-6);
        assert!(m.nrmse(1, BeadScale::PerFrame) < 1e-6);
        assert!((m.nrmse(2, BeadScale::Physical) - 1.25f64.sqrt() / 5.0).abs() < 1e-6);
        assert!((m.noise_floor() - 0.2).abs() < 1e-12);
        assert_eq!(m.best_rank(BeadScale::Physical), 1);
    }
}
