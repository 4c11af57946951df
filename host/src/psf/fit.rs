//! Windows at scattered positions -> the low-rank model, with its error on positions that were left out.
//!
//! [`super::decompose`] knows no positions and [`super::field`] no PSFs; here they meet: the coefficients of each lens's
//! decomposition become smooth functions over the field.

use super::decompose::{Decomposition, decompose, fill};
use super::field::FieldSmoother;
use super::nodes::Taps;
use crate::bead::{BeadScale, LensWindows};
use crate::linalg::{NotConverged, symmetric_eigen};
use ndarray::{Array1, Array2, ArrayView2, Axis, CowArray, Zip, s};
use rayon::prelude::*;
use std::sync::Arc;

/// Fewer beads at a depth say nothing of the field between them.
const FEW: usize = 4;
/// Pixels that are summed at a time.
const CHUNK_PX: usize = 4096;
/// Terms that what was not measured is filled in with, before windows are averaged.
const FILL_TERMS: usize = 16;

/// How the model is fitted.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FitConfig {
    /// Terms a lens; None: chosen by held-out error.
    pub rank: Option<usize>,
    /// Most terms that are tried.
    pub max_rank: usize,
    /// One PSF a lens instead.
    pub one_psf: bool,
    /// Whether the errors leave one scale a bead free.
    pub scale: BeadScale,
}

impl Default for FitConfig {
    fn default() -> Self {
        Self { rank: None, max_rank: 32, one_psf: false, scale: BeadScale::Physical }
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

/// What the model of a lens is made of.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Terms {
    /// The leading terms of the decomposition, their coefficients smooth over the field.
    Truncated {
        /// Most terms.
        most: usize,
        /// Order of the splines.
        spline_order: usize,
    },
    /// One PSF for the whole field: the mean of the beads at each depth.
    OnePsf,
}

impl Terms {
    /// Orders that splines are planned for; none: constants.
    fn spline_orders(self) -> Vec<usize> {
        match self {
            Self::Truncated { spline_order, .. } => vec![spline_order],
            Self::OnePsf => Vec::new(),
        }
    }
}

/// The fitted model of one lens.
#[derive(Clone, Debug)]
pub struct LensFit {
    /// Basis and coefficients at the beads.
    pub decomposition: Decomposition,
    /// The beads that it was made of, in the order of the coefficients.
    pub beads: Vec<usize>,
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
    Ok(LensFit { decomposition, beads: beads.to_vec() })
}

/// Noise of each pixel; where the model says none, even.
fn sigma(windows: &LensWindows) -> Array1<f32> {
    let floor = 1e-6 * windows.variance_dn2.iter().fold(0.0f64, |m, v| m.max(*v));
    windows.variance_dn2.mapv(|v| if floor > 0.0 { v.max(floor).sqrt() as f32 } else { 1.0 })
}

/// Misfit of a TSVD at those of `beads` that it was made of (coefficients as decomposed: the approximation error of Eq. 2).
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

/// Misfit at beads whose coefficients come from the smooth fields, [bead of the plane, k] a plane.
pub fn predicted(windows: &LensWindows, fit: &LensFit, fields: &[Array2<f64>], planes: &[Plane]) -> Misfit {
    let basis = &fit.decomposition.basis;
    let parts = fields.iter().zip(planes).map(|(c, plane)| misfit(windows, &plane.beads, basis, c.view()));
    parts.fold(Misfit::new(0, basis.nrows()), |all, part| all.join(&part))
}

/// Models of all lenses.
#[derive(Clone, Debug)]
pub struct LensModels {
    /// One a lens; None: dead.
    pub fits: Vec<Option<LensFit>>,
    fields: Vec<Option<Arc<LensFields>>>,
}

/// How the coefficients of lenses that see the same beads become functions over the field.
#[derive(Debug)]
struct LensFields {
    planes: Vec<Plane>,
    smoothers: Vec<FieldSmoother>,
    /// Where the lens was seen in each plane: rows and columns, from and to, object pixels.
    limits: Vec<[[f64; 2]; 2]>,
}

/// Rows and columns, from and to, that the beads `seen` of a plane reach. Infinite where they reach as far as those of the whole plane: a
/// function may be followed beyond the scan, but not to where the foci fall far off the sensor and nothing holds it.
fn limits_of(seen: &Plane, all: &Plane) -> [[f64; 2]; 2] {
    let range = |plane: &Plane, a: usize| {
        plane.at_px.column(a).iter().fold([f64::INFINITY, f64::NEG_INFINITY], |r, v| [r[0].min(*v), r[1].max(*v)])
    };
    [0, 1].map(|a| {
        let ([low, high], [least, most]) = (range(seen, a), range(all, a));
        [if low > least { low } else { f64::NEG_INFINITY }, if high < most { high } else { f64::INFINITY }]
    })
}

impl LensModels {
    /// Fits every living lens to those beads of `planes` that it sees.
    ///
    /// # Errors
    /// The windows hold values that are no numbers.
    pub fn fit(windows: &[LensWindows], dead: &[bool], planes: &[Plane], terms: Terms) -> Result<Self, NotConverged> {
        let lens = |l: usize| {
            let seen = windows[l].seen();
            let planes = select(planes, |n| seen[n]);
            let beads: Vec<usize> = planes.iter().flat_map(|p| p.beads.clone()).collect();
            match terms {
                _ if dead[l] || beads.is_empty() => Ok(None),
                Terms::Truncated { most, .. } => fit_lens(&windows[l], &beads, most).map(Some),
                Terms::OnePsf => mean_psf(&windows[l], &planes).map(Some),
            }
        };
        let fits = (0..windows.len()).into_par_iter().map(lens).collect::<Result<Vec<_>, NotConverged>>()?;
        Self { fits, fields: Vec::new() }.smoothed(planes, terms)
    }

    /// The same decompositions with coefficients that are smooth by other splines.
    ///
    /// # Errors
    /// A position is no number.
    pub fn smoothed(self, planes: &[Plane], terms: Terms) -> Result<Self, NotConverged> {
        let orders = terms.spline_orders();
        let mut planned: Vec<(&[usize], Arc<LensFields>)> = Vec::new();
        let mut fields = Vec::new();
        for fit in &self.fits {
            let Some(fit) = fit else {
                fields.push(None);
                continue;
            };
            let found = planned.iter().find(|(beads, _)| *beads == fit.beads).map(|(_, f)| Arc::clone(f));
            let plan = match found {
                Some(plan) => plan,
                None => {
                    let mut seen = select(planes, |n| fit.beads.contains(&n));
                    let limits = seen.iter().zip(planes).filter(|(p, _)| !p.beads.is_empty());
                    let limits = limits.map(|(seen, all)| limits_of(seen, all)).collect();
                    seen.retain(|p| !p.beads.is_empty());
                    let planes = seen;
                    let smoothers = planes.iter().map(|p| FieldSmoother::plan(p.at_px.view(), &orders));
                    let smoothers = smoothers.collect::<Result<Vec<_>, _>>()?;
                    let plan = Arc::new(LensFields { planes, smoothers, limits });
                    planned.push((&fit.beads, Arc::clone(&plan)));
                    plan
                }
            };
            fields.push(Some(plan));
        }
        Ok(Self { fields, ..self })
    }

    /// The windows with what was not measured filled in by the first `rank` terms.
    pub fn filled(&self, windows: &[LensWindows], rank: usize) -> Vec<LensWindows> {
        windows.iter().zip(&self.fits).map(|(w, fit)| filled(w, fit.as_ref(), rank)).collect()
    }

    /// NRMSE of one decomposition of the windows of all lenses together, by its rank from 1 to `most`: what the whole array costs
    /// where lenses of different aberrations share their coefficients (Xue et al., Optica 9, 1009, 2022). Beads as in `order`; what was not
    /// measured is filled in. Empty where the lenses have no decomposition.
    ///
    /// # Errors
    /// The windows hold values that are no numbers.
    pub fn whole_array(&self, windows: &[LensWindows], order: &[usize], most: usize) -> Result<Vec<f64>, NotConverged> {
        let mut gram = Array2::<f64>::zeros((order.len(), order.len()));
        for fit in self.fits.iter().flatten() {
            let own = &fit.decomposition.gram;
            let place: Vec<Option<usize>> = fit.beads.iter().map(|b| order.iter().position(|o| o == b)).collect();
            if own.is_empty() {
                return Ok(Vec::new());
            }
            for ((i, j), v) in own.indexed_iter() {
                if let (Some(i), Some(j)) = (place[i], place[j]) {
                    gram[[i, j]] += v;
                }
            }
        }
        let vectors = symmetric_eigen(&gram)?.vectors;
        let n = order.len();
        let left = Array2::from_shape_fn((most.min(n), n), |(k, i)| vectors[[i, n - 1 - k]] as f32);
        // Given its coefficients, a pixel's share in the basis is its projection, whatever its weight.
        let parts =
            windows.par_iter().zip(&self.fits).filter_map(|(w, fit)| Some((w, fit.as_ref()?))).map(|(w, fit)| {
                let light = filled(w, Some(fit), fit.decomposition.basis.nrows()).light_dn.select(Axis(0), order);
                let square = |row: ndarray::ArrayView1<'_, f32>| row.iter().map(|v| f64::from(*v).powi(2)).sum::<f64>();
                let kept: Vec<f64> = left.dot(&light).outer_iter().map(square).collect();
                (light.outer_iter().map(square).sum::<f64>(), kept)
            });
        let mut left_over = vec![0.0; left.nrows()];
        let mut all = 0.0;
        for (total, kept) in parts.collect::<Vec<_>>() {
            all += total;
            let mut rest = total;
            left_over.iter_mut().zip(kept).for_each(|(sum, k)| {
                rest -= k;
                *sum += rest.max(0.0);
            });
        }
        Ok(left_over.iter().map(|v| (v / all).sqrt()).collect())
    }

    /// Coefficients of all lenses at `targets` (depth, um, and positions), [position, k], from smooth fields through those at the
    /// beads, interpolated between depths; None: a dead lens.
    ///
    /// # Errors
    /// A coefficient is no number.
    pub fn at(&self, targets: &[(f64, Array2<f64>)]) -> Result<Vec<Option<Vec<Array2<f64>>>>, NotConverged> {
        let lens = |(fit, fields): (&Option<LensFit>, &Option<Arc<LensFields>>)| {
            let (Some(fit), Some(fields)) = (fit, fields.as_deref()) else { return Ok(None) };
            let LensFields { planes, smoothers, limits } = fields;
            let row_of = |bead: &usize| fit.beads.iter().position(|b| b == bead);
            let depths: Vec<f64> = planes.iter().map(|p| p.z_um).collect();
            let field = |(plane, smoother): (&Plane, &FieldSmoother)| {
                let rows: Vec<usize> = plane.beads.iter().filter_map(row_of).collect();
                smoother.fit(fit.decomposition.coefficients.select(Axis(0), &rows).view())
            };
            let fields = planes.iter().zip(smoothers).map(field).collect::<Result<Vec<_>, NotConverged>>()?;
            let value = |(z_um, at): &(f64, Array2<f64>)| {
                let taps = Taps::at(&depths, *z_um);
                let mut sum = Array2::zeros((at.nrows(), fit.decomposition.basis.nrows()));
                let near = fields[taps.first..].iter().zip(&limits[taps.first..]);
                let used = taps.weights.iter().zip(near).take(taps.count);
                used.filter(|(w, _)| **w != 0.0).for_each(|(w, (f, limits))| {
                    let within =
                        Array2::from_shape_fn(at.dim(), |(i, a)| at[[i, a]].max(limits[a][0]).min(limits[a][1]));
                    sum.scaled_add(f64::from(*w), &f.at(within.view()));
                });
                sum
            };
            Ok(Some(targets.iter().map(value).collect()))
        };
        self.fits.par_iter().zip(&self.fields).map(lens).collect()
    }

    /// Misfit at the beads of `planes`, which need not be those that were fitted, over all living lenses.
    ///
    /// # Errors
    /// A coefficient is no number.
    pub fn misfit(&self, windows: &[LensWindows], planes: &[Plane]) -> Result<Misfit, NotConverged> {
        let targets: Vec<(f64, Array2<f64>)> = planes.iter().map(|p| (p.z_um, p.at_px.clone())).collect();
        let fields = self.at(&targets)?;
        let lenses = self.fits.iter().zip(&fields).zip(windows);
        let parts = lenses.filter_map(|((fit, fields), w)| Some(predicted(w, fit.as_ref()?, fields.as_ref()?, planes)));
        Ok(sum_over_lenses(&parts.collect::<Vec<_>>()))
    }
}

/// The windows of a lens with what was not measured filled in by the first `rank` terms.
fn filled(w: &LensWindows, fit: Option<&LensFit>, rank: usize) -> LensWindows {
    let (Some(known), Some(fit)) = (&w.known, fit) else { return w.clone() };
    let model = fit.decomposition.windows(rank);
    let mut light_dn = w.light_dn.clone();
    for (row, bead) in fit.beads.iter().enumerate() {
        let pixels = light_dn.row_mut(*bead).into_iter().zip(known.row(*bead)).zip(model.row(row));
        pixels.filter(|((_, k), _)| !**k).for_each(|((v, _), m)| *v = *m);
    }
    LensWindows { light_dn, known: None, variance_dn2: w.variance_dn2.clone() }
}

/// The mean PSF of each plane, with constant coefficients: the shift-invariant model.
///
/// What was not measured is filled in first, as for the low-rank model: a pixel that only some beads show is no mean over all of them.
fn mean_psf(windows: &LensWindows, planes: &[Plane]) -> Result<LensFit, NotConverged> {
    let (count, px) = (planes.iter().map(|p| p.beads.len()).sum(), windows.light_dn.ncols());
    let mut basis = Array2::<f32>::zeros((planes.len(), px));
    let mut coefficients = Array2::zeros((count, planes.len()));
    let mut singular_values = Vec::new();
    let mut row = 0;
    for (k, plane) in planes.iter().enumerate() {
        let mut light = windows.light_dn.select(Axis(0), &plane.beads);
        if let Some(known) = windows.known.as_ref().map(|k| k.select(Axis(0), &plane.beads)) {
            fill(&mut light, known.view(), sigma(windows).view(), FILL_TERMS)?;
        }
        let mean = light.mean_axis(Axis(0)).unwrap_or_else(|| Array1::zeros(light.ncols()));
        let norm = mean.iter().map(|v| f64::from(*v).powi(2)).sum::<f64>().sqrt().max(f64::MIN_POSITIVE);
        basis.row_mut(k).assign(&mean.mapv(|v| (f64::from(v) / norm) as f32));
        coefficients.slice_mut(s![row..row + plane.beads.len(), k]).fill(norm);
        row += plane.beads.len();
        singular_values.push(norm * (plane.beads.len() as f64).sqrt());
    }
    let beads = planes.iter().flat_map(|p| p.beads.clone()).collect();
    Ok(LensFit {
        decomposition: Decomposition { basis, coefficients, singular_values, gram: Array2::zeros((0, 0)) },
        beads,
    })
}

/// The beads of each plane that `keep` names.
pub fn select(planes: &[Plane], keep: impl Fn(usize) -> bool) -> Vec<Plane> {
    let part = |p: &Plane| {
        let rows: Vec<usize> = (0..p.beads.len()).filter(|i| keep(p.beads[*i])).collect();
        let beads = rows.iter().map(|i| p.beads[*i]).collect();
        Plane { z_um: p.z_um, beads, at_px: p.at_px.select(Axis(0), &rows) }
    };
    planes.iter().map(part).collect()
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
///
/// All from `<basis, measured>` and `<basis, basis>`, summed in f64: predictions are never formed.
fn misfit(windows: &LensWindows, beads: &[usize], basis: &Array2<f32>, coefficients: ArrayView2<'_, f64>) -> Misfit {
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

/// Splits beads in two halves so that each bead's neighbours are in the other one: a checkerboard on a regular scan, every second row of a scan that
/// is itself the one colour of a checkerboard, every second bead in order of position otherwise; of a scan of depth at a few positions,
/// every second depth.
pub fn checkerboard(planes: &[Plane], beads: usize) -> Vec<bool> {
    let mut train = vec![true; beads];
    if planes.iter().all(|p| p.beads.len() < FEW) {
        planes.iter().enumerate().for_each(|(i, p)| p.beads.iter().for_each(|b| train[*b] = i.is_multiple_of(2)));
        return train;
    }
    for plane in planes {
        let (rows, cols) = (levels(plane.at_px.column(0)), levels(plane.at_px.column(1)));
        let count = |levels: &[usize]| levels.iter().max().map_or(0, |m| m + 1);
        let regular = count(&rows) * count(&cols) <= 2 * plane.beads.len();
        let even = |i: &usize| (rows[*i] + cols[*i]).is_multiple_of(2);
        let n = plane.beads.len();
        let white = (0..n).filter(even).count();
        let one_colour = 4 * white.min(n - white) < n;
        for (i, bead) in plane.beads.iter().enumerate() {
            train[*bead] = match (regular, one_colour) {
                (true, false) => even(&i),
                (true, true) => rows[i].is_multiple_of(2),
                (false, _) => i.is_multiple_of(2),
            };
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
    fn a_scan_of_depth_alone_is_divided_by_depths_and_predicted_between_them() {
        // The light wanders smoothly from one pixel to the next with depth.
        let plane = |i: usize| Plane { z_um: i as f64, beads: vec![i], at_px: ndarray::arr2(&[[5.0, 5.0]]) };
        let planes: Vec<Plane> = (0..11).map(plane).collect();
        let light = Array2::from_shape_fn((11, 2), |(i, p)| {
            let share = (0.1 * i as f32).sin();
            if p == 0 { 1.0 - share } else { share }
        });
        let windows = LensWindows { light_dn: light, known: None, variance_dn2: ndarray::arr1(&[1.0, 1.0]) };
        let train = checkerboard(&planes, 11);
        assert!(train.iter().enumerate().all(|(i, t)| *t == (i % 2 == 0)));
        let terms = Terms::Truncated { most: 2, spline_order: 2 };
        let windows = [windows];
        let models = LensModels::fit(&windows, &[false], &select(&planes, |n| train[n]), terms).unwrap();
        let misfit = models.misfit(&windows, &select(&planes, |n| !train[n])).unwrap();
        assert!(misfit.nrmse(2, BeadScale::Physical) < 1e-3, "{}", misfit.nrmse(2, BeadScale::Physical));
    }

    #[test]
    fn lenses_of_different_aberrations_need_more_terms_together_than_each_alone() {
        use rand_distr::{Distribution, StandardNormal};
        // Two terms a lens whose coefficients have nothing to do with those of the other lens.
        let mut rng = crate::rng::stream(3, "whole array", 0);
        let mut random = |shape| Array2::<f32>::from_shape_simple_fn(shape, || StandardNormal.sample(&mut rng));
        let mut lens = || LensWindows {
            light_dn: random((30, 2)).dot(&random((2, 49))),
            known: None,
            variance_dn2: Array1::ones(49),
        };
        let windows = [lens(), lens()];
        let at_px = Array2::from_shape_fn((30, 2), |(i, a)| [i / 6, i % 6][a] as f64);
        let planes = [Plane { z_um: 0.0, beads: (0..30).collect(), at_px }];
        let terms = Terms::Truncated { most: 4, spline_order: 2 };
        let models = LensModels::fit(&windows, &[false, false], &planes, terms).unwrap();
        let whole = models.whole_array(&windows, &planes[0].beads, 6).unwrap();
        assert!(whole[1] > 0.2 && whole[2] > 0.05 && whole[3] < 1e-3, "{whole:?}");
        let own = approximation(&windows[0], models.fits[0].as_ref().unwrap(), &planes[0].beads);
        assert!(own.nrmse(2, BeadScale::Physical) < 1e-3);
    }

    #[test]
    fn functions_are_held_where_the_foci_fall_off_the_sensor() {
        let plane = |beads: &[usize]| Plane {
            z_um: 0.0,
            beads: beads.to_vec(),
            at_px: Array2::from_shape_fn((beads.len(), 2), |(i, a)| [beads[i] / 3, beads[i] % 3][a] as f64 * 10.0),
        };
        let all = plane(&[0, 1, 2, 3, 4, 5, 6, 7, 8]);
        let free = [f64::NEG_INFINITY, f64::INFINITY];
        assert_eq!(limits_of(&all, &all), [free, free]);
        // The first row was not seen.
        assert_eq!(limits_of(&plane(&[3, 4, 5, 6, 7, 8]), &all), [[10.0, f64::INFINITY], free]);
    }

    #[test]
    fn one_colour_of_a_checkerboard_is_divided_by_rows() {
        let places: Vec<(usize, usize)> =
            (0..49usize).map(|i| (i / 7, i % 7)).filter(|(r, c)| (r + c).is_multiple_of(2)).collect();
        let at_px = Array2::from_shape_fn((places.len(), 2), |(i, a)| [places[i].0, places[i].1][a] as f64 * 9.1);
        let train = checkerboard(&[Plane { z_um: 0.0, beads: (0..places.len()).collect(), at_px }], places.len());
        assert!(places.iter().zip(&train).all(|((r, _), t)| *t == r.is_multiple_of(2)));
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
