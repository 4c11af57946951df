//! Low-rank models of all lenses: decompositions whose coefficients are smooth functions over the field.

use super::lens_fit::{LensFit, filled, fit_lens, mean_psf};
use super::misfit::{Misfit, predicted, sum_over_lenses};
use super::planes::{Plane, select};
use crate::psf::field::FieldSmoother;
use crate::psf::nodes::Taps;
use crate::psf::windows::{BeadScale, LensWindows};
use ndarray::{Array2, Axis};
use ommatidia_physics::linalg::{NotConverged, symmetric_eigen};
use rayon::prelude::*;
use std::sync::Arc;

/// Settings of the fit.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FitConfig {
    /// Number of terms (rank) of each lens; None: chosen by held-out error.
    pub rank: Option<usize>,
    /// Largest rank that is tried.
    pub max_rank: usize,
    /// Fits one PSF for the whole field of each lens instead.
    pub one_psf: bool,
    /// Whether errors are counted with one free scale for each bead.
    pub scale: BeadScale,
}

impl Default for FitConfig {
    fn default() -> Self {
        Self { rank: None, max_rank: 32, one_psf: false, scale: BeadScale::Physical }
    }
}

/// The kind of model that is fitted to each lens.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Terms {
    /// The leading terms of the decomposition, with coefficients that are smooth over the field.
    Truncated {
        /// Number of terms at most.
        most: usize,
        /// Order m of the smoothing splines.
        spline_order: usize,
    },
    /// One PSF for the whole field: the mean of the beads at each depth.
    OnePsf,
}

impl Terms {
    /// Orders of the splines; empty: constant coefficients.
    fn spline_orders(self) -> Vec<usize> {
        match self {
            Self::Truncated { spline_order, .. } => vec![spline_order],
            Self::OnePsf => Vec::new(),
        }
    }
}

/// The fitted models of all lenses.
#[derive(Clone, Debug)]
pub struct LensModels {
    /// One entry for each lens; None for a dead lens.
    pub fits: Vec<Option<LensFit>>,
    fields: Vec<Option<Arc<LensFields>>>,
}

/// Smoothing splines shared by the lenses that see the same beads.
#[derive(Debug)]
struct LensFields {
    planes: Vec<Plane>,
    smoothers: Vec<FieldSmoother>,
    /// Range of rows and of columns in which each plane was seen, object pixels.
    limits: Vec<[[f64; 2]; 2]>,
}

/// Range of rows and of columns that the beads `seen` of a plane cover. A side is infinite where they reach as far as
/// all beads of the plane: a function may be extrapolated beyond the scan, but not to where the foci fall off the
/// sensor and no data constrain it.
pub(super) fn limits_of(seen: &Plane, all: &Plane) -> [[f64; 2]; 2] {
    let range = |plane: &Plane, a: usize| {
        plane.at_px.column(a).iter().fold([f64::INFINITY, f64::NEG_INFINITY], |r, v| [r[0].min(*v), r[1].max(*v)])
    };
    [0, 1].map(|a| {
        let ([low, high], [least, most]) = (range(seen, a), range(all, a));
        [if low > least { low } else { f64::NEG_INFINITY }, if high < most { high } else { f64::INFINITY }]
    })
}

impl LensModels {
    /// Fits every living lens to those beads of `planes` whose foci lie on the sensor.
    ///
    /// # Errors
    /// The windows hold non-finite values.
    pub fn fit(windows: &[LensWindows], dead: &[bool], planes: &[Plane], terms: Terms) -> Result<Self, NotConverged> {
        let seen: Vec<Vec<bool>> = windows.iter().map(LensWindows::seen).collect();
        Self::fit_seen(windows, &seen, dead, planes, terms)
    }

    /// The same, where it is stated which beads each lens has `seen`: windows whose unmeasured pixels are filled in do
    /// not show it.
    ///
    /// # Errors
    /// The windows hold non-finite values.
    pub fn fit_seen(
        windows: &[LensWindows],
        seen: &[Vec<bool>],
        dead: &[bool],
        planes: &[Plane],
        terms: Terms,
    ) -> Result<Self, NotConverged> {
        let lens = |l: usize| {
            let planes = select(planes, |n| seen[l][n]);
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

    /// Keeps the decompositions and smooths their coefficients by other splines.
    ///
    /// # Errors
    /// A position is not finite.
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

    /// The windows of all lenses, their unmeasured pixels filled in by the first `rank` terms.
    pub fn filled(&self, windows: &[LensWindows], rank: usize) -> Vec<LensWindows> {
        windows.iter().zip(&self.fits).map(|(w, fit)| filled(w, fit.as_ref(), rank)).collect()
    }

    /// NRMSE of one joint decomposition of the windows of all lenses, for rank 1 to `most`: the error of a model in
    /// which lenses of different aberrations share their coefficients (Xue et al., Optica 9, 1009, 2022). Beads are in
    /// the order of `order`; unmeasured pixels are filled in. Empty where the lenses have no decomposition.
    ///
    /// # Errors
    /// The windows hold non-finite values.
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

    /// Coefficients of all lenses at `targets` (depth in um, positions [n, (row, col)] in object pixels): one array
    /// [position, k] for each target, None for a dead lens. Values come from the smooth fields and are interpolated
    /// between depths.
    ///
    /// # Errors
    /// A coefficient is not finite.
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

    /// Misfit at the beads of `planes`, summed over all living lenses. The beads may be others than the fitted ones.
    ///
    /// # Errors
    /// A coefficient is not finite.
    pub fn misfit(&self, windows: &[LensWindows], planes: &[Plane]) -> Result<Misfit, NotConverged> {
        let targets: Vec<(f64, Array2<f64>)> = planes.iter().map(|p| (p.z_um, p.at_px.clone())).collect();
        let fields = self.at(&targets)?;
        let lenses = self.fits.iter().zip(&fields).zip(windows);
        let parts = lenses.filter_map(|((fit, fields), w)| Some(predicted(w, fit.as_ref()?, fields.as_ref()?, planes)));
        Ok(sum_over_lenses(&parts.collect::<Vec<_>>()))
    }
}
