//! Fits the low-rank model of all lenses: rank and smoothness by held-out error, coefficient maps at the nodes, errors.

use super::error::CalibrateError;
use crate::instrument::{Diagnostics, Quality};
use crate::psf::field::ORDERS;
use crate::psf::fit::{self, FitConfig, LensModels, Misfit, Plane, Terms};
use crate::psf::nodes::even_nodes;
use crate::psf::{BeadScale, LensWindows, LowRankPsf};
use ndarray::{Array1, Array2, Array4, Array5, s};
use ommatidia_physics::linalg::NotConverged;
use ommatidia_session::Manifest;

/// Largest number of nodes along one side of a coefficient map.
const MOST_NODES: usize = 65;

/// The low-rank model of all lenses, with its errors.
pub(super) struct Model {
    pub rank: usize,
    pub terms: Terms,
    models: LensModels,
    nodes: Nodes,
    held_out: Misfit,
    one_psf: f64,
    approximation: Misfit,
    smooth: Misfit,
    scale: BeadScale,
}

/// How the model is fitted and stored.
#[derive(Clone, Copy, Debug)]
pub(super) struct ModelConfig<'a> {
    pub fit: FitConfig,
    /// Sizes of object and windows.
    pub manifest: &'a Manifest,
    /// Exposure that the windows are brought to, ms.
    pub exposure_ms: f64,
}

/// The nodes of the coefficient maps, and the size of a basis PSF.
#[derive(Clone, Debug)]
pub(super) struct Nodes {
    rows_px: Vec<f64>,
    cols_px: Vec<f64>,
    depths_um: Vec<f64>,
    side: usize,
    exposure_ms: f64,
}

impl Nodes {
    fn new(planes: &[Plane], manifest: &Manifest, exposure_ms: f64) -> Self {
        let side = (2 * (planes[0].beads.len() as f64).sqrt().ceil() as usize - 1).clamp(4, MOST_NODES);
        Self {
            rows_px: even_nodes(manifest.object.rows, side),
            cols_px: even_nodes(manifest.object.cols, side),
            depths_um: planes.iter().map(|p| p.z_um).collect(),
            side: manifest.optics.psf_window_px,
            exposure_ms,
        }
    }

    /// The model of all lenses at the nodes, with `rank` terms each.
    pub(super) fn psf(&self, models: &LensModels, rank: usize) -> Result<LowRankPsf, NotConverged> {
        let [rows, cols] = [self.rows_px.len(), self.cols_px.len()];
        let grid =
            Array2::from_shape_fn((rows * cols, 2), |(i, a)| [self.rows_px[i / cols], self.cols_px[i % cols]][a]);
        let targets: Vec<_> = self.depths_um.iter().map(|z| (*z, grid.clone())).collect();
        let fields = models.at(&targets)?;
        let lenses = models.fits.len();
        let mut basis = Array4::zeros((lenses, rank, self.side, self.side));
        let mut coefficients = Array5::zeros((lenses, rank, self.depths_um.len(), rows, cols));
        for (l, (fit, fields)) in models.fits.iter().zip(&fields).enumerate() {
            let (Some(fit), Some(fields)) = (fit, fields) else { continue };
            // A lens may have fewer terms than asked for: the rest stay zero.
            for k in 0..rank.min(fit.decomposition.basis.nrows()) {
                let row = fit.decomposition.basis.row(k);
                basis.slice_mut(s![l, k, .., ..]).iter_mut().zip(row).for_each(|(b, v)| *b = *v);
                for (z, field) in fields.iter().enumerate() {
                    let map = coefficients.slice_mut(s![l, k, z, .., ..]);
                    map.into_iter().zip(field.column(k)).for_each(|(m, v)| *m = *v as f32);
                }
            }
        }
        Ok(LowRankPsf {
            basis,
            coefficients,
            node_depths_um: self.depths_um.clone(),
            node_rows_px: self.rows_px.clone(),
            node_cols_px: self.cols_px.clone(),
            exposure_ms: self.exposure_ms,
        })
    }
}

/// The chosen rank and terms, with their held-out error.
struct Choice {
    rank: usize,
    terms: Terms,
    held_out: Misfit,
}

impl Choice {
    fn one_psf(held_out: Misfit, planes: &[Plane]) -> Self {
        Self { rank: planes.len(), terms: Terms::OnePsf, held_out }
    }

    /// The order of the splines and the rank with the least held-out error.
    fn best(config: FitConfig, most: usize, halves: &Halves<'_>) -> Result<Self, CalibrateError> {
        if let Some(found) = config.rank.filter(|r| *r == 0 || *r > most) {
            return Err(CalibrateError::Rank { most, found });
        }
        let tried = config.rank.unwrap_or(0).max(config.max_rank).min(most);
        let with = |spline_order| Terms::Truncated { most: tried, spline_order };
        // One decomposition of each half serves all orders.
        let mut fitted = halves.fit(with(ORDERS[0]))?;
        let mut best: Option<(f64, Self)> = None;
        for spline_order in ORDERS {
            let terms = with(spline_order);
            fitted = halves.smoothed(fitted, terms)?;
            let held_out = halves.misfit(&fitted)?;
            let rank = config.rank.unwrap_or_else(|| held_out.best_rank(config.scale));
            let error = held_out.nrmse(rank.min(held_out.ranks()), config.scale);
            if best.as_ref().is_none_or(|(least, _)| error < *least) {
                best = Some((error, Self { rank, terms, held_out }));
            }
        }
        best.map(|(_, choice)| choice).ok_or(CalibrateError::Rank { most, found: 0 })
    }
}

/// The two halves of a checkerboard, which predict each other.
struct Halves<'a> {
    windows: &'a [LensWindows],
    dead: &'a [bool],
    planes: [Vec<Plane>; 2],
}

impl<'a> Halves<'a> {
    fn new(windows: &'a [LensWindows], dead: &'a [bool], planes: &[Plane]) -> Self {
        let beads = planes.iter().map(|p| p.beads.len()).sum();
        let even = fit::checkerboard(planes, beads);
        Self { windows, dead, planes: [true, false].map(|half| fit::select(planes, |n| even[n] == half)) }
    }

    fn fit(&self, terms: Terms) -> Result<[LensModels; 2], NotConverged> {
        let [a, b] = &self.planes;
        let fit = |planes| LensModels::fit(self.windows, self.dead, planes, terms);
        Ok([fit(a)?, fit(b)?])
    }

    fn smoothed(&self, [a, b]: [LensModels; 2], terms: Terms) -> Result<[LensModels; 2], NotConverged> {
        Ok([a.smoothed(&self.planes[0], terms)?, b.smoothed(&self.planes[1], terms)?])
    }

    /// Misfit of each half at the beads of the other.
    fn misfit(&self, [a, b]: &[LensModels; 2]) -> Result<Misfit, NotConverged> {
        Ok(a.misfit(self.windows, &self.planes[1])?.join(&b.misfit(self.windows, &self.planes[0])?))
    }
}

impl Model {
    pub(super) fn fit(
        windows: &[LensWindows],
        dead: &[bool],
        planes: &[Plane],
        ModelConfig { fit: config, manifest, exposure_ms }: ModelConfig<'_>,
    ) -> Result<Self, CalibrateError> {
        let beads: usize = planes.iter().map(|p| p.beads.len()).sum();
        let halves = Halves::new(windows, dead, planes);
        let one = halves.misfit(&halves.fit(Terms::OnePsf)?)?;
        let one_psf = one.nrmse(one.ranks(), config.scale);
        let choice = if config.one_psf { Choice::one_psf(one, planes) } else { Choice::best(config, beads, &halves)? };
        let models = LensModels::fit(windows, dead, planes, choice.terms)?;
        let order: Vec<usize> = planes.iter().flat_map(|p| p.beads.clone()).collect();
        let living = windows.iter().zip(&models.fits).filter_map(|(w, fit)| Some((w, fit.as_ref()?)));
        let approximations: Vec<Misfit> = living.map(|(w, fit)| fit::approximation(w, fit, &order)).collect();
        Ok(Self {
            rank: choice.rank,
            terms: choice.terms,
            approximation: fit::sum_over_lenses(&approximations),
            smooth: models.misfit(windows, planes)?,
            models,
            nodes: Nodes::new(planes, manifest, exposure_ms),
            held_out: choice.held_out,
            one_psf,
            scale: config.scale,
        })
    }

    pub(super) fn psf(&self) -> Result<LowRankPsf, NotConverged> {
        self.nodes.psf(&self.models, self.rank)
    }

    /// The windows with unmeasured pixels filled in, so that refits need not repeat it.
    pub(super) fn filled(&self, windows: &[LensWindows]) -> Vec<LensWindows> {
        self.models.filled(windows, self.rank)
    }

    /// Refits a model of the same rank and smoothness to the beads of `planes` alone, of which each lens has `seen`
    /// some.
    pub(super) fn refit(
        &self,
        windows: &[LensWindows],
        seen: &[Vec<bool>],
        dead: &[bool],
        planes: &[Plane],
    ) -> Result<LowRankPsf, NotConverged> {
        let terms = match self.terms {
            Terms::Truncated { spline_order, .. } => Terms::Truncated { most: self.rank, spline_order },
            Terms::OnePsf => Terms::OnePsf,
        };
        self.nodes.psf(&LensModels::fit_seen(windows, seen, dead, planes, terms)?, self.rank)
    }

    /// Scatter of the brightness of beads that were left out about what their neighbours predict, relative, and the
    /// part of it that noise causes.
    pub(super) fn brightness_scatter(&self) -> [f64; 2] {
        let rank = self.rank.min(self.held_out.ranks());
        let pixels = self.nodes.side.pow(2) * self.models.fits.iter().flatten().count();
        self.held_out.brightness_scatter(rank, pixels)
    }

    pub(super) fn quality(&self, chief_ray_rms_px: f64) -> Quality {
        let at = |m: &Misfit| m.nrmse(self.rank.min(m.ranks()), self.scale);
        Quality {
            approximation_error: at(&self.approximation),
            off_grid_error: at(&self.held_out),
            one_psf_error: self.one_psf,
            noise_floor: self.approximation.noise_floor(),
            chief_ray_rms_px,
            ..Quality::default()
        }
    }

    pub(super) fn diagnostics(
        &self,
        windows: &[LensWindows],
        planes: &[Plane],
        photon_transfer: Array2<f32>,
    ) -> Result<Diagnostics, NotConverged> {
        let beads: Vec<usize> = planes.iter().flat_map(|p| p.beads.clone()).collect();
        let places =
            planes.iter().flat_map(|p| p.at_px.outer_iter().map(|a| [a[0] as f32, a[1] as f32]).collect::<Vec<_>>());
        let positions_px: Vec<[f32; 2]> = places.collect();
        let ranks = self.approximation.ranks().min(self.held_out.ranks());
        let fits = &self.models.fits;
        // Three times the rank of single lenses: as far as the two are worth comparing. Its errors know no free scale.
        let whole = match self.scale {
            BeadScale::Physical => self.models.whole_array(windows, &beads, 3 * self.approximation.ranks())?,
            BeadScale::PerFrame => Vec::new(),
        };
        Ok(Diagnostics {
            whole_array_error: whole.into_iter().map(|v| v as f32).collect(),
            pcc: pearson_map(windows, &beads, &positions_px),
            positions_px: Array2::from_shape_fn((beads.len(), 2), |(i, a)| positions_px[i][a]),
            bead_nrmse: self.smooth.by_bead(self.rank.min(self.smooth.ranks()), self.scale),
            singular_values: Array2::from_shape_fn((fits.len(), beads.len()), |(l, i)| {
                let values = fits[l].as_ref().map(|f| &f.decomposition.singular_values);
                values.and_then(|v| v.get(i)).copied().unwrap_or(0.0) as f32
            }),
            error_by_rank: Array2::from_shape_fn((ranks, 3), |(i, c)| match c {
                0 => (i + 1) as f32,
                1 => self.approximation.nrmse(i + 1, self.scale) as f32,
                _ => self.held_out.nrmse(i + 1, self.scale) as f32,
            }),
            photon_transfer,
            ..Diagnostics::default()
        })
    }
}

/// Pearson correlation of each bead's windows (all lenses) with those of the bead nearest to the middle of the scan,
/// [bead].
fn pearson_map(windows: &[LensWindows], beads: &[usize], positions: &[[f32; 2]]) -> Array1<f32> {
    let n = positions.len().max(1) as f32;
    let middle = [0, 1].map(|a| positions.iter().map(|p| p[a]).sum::<f32>() / n);
    let distance = |p: &[f32; 2]| (p[0] - middle[0]).powi(2) + (p[1] - middle[1]).powi(2);
    let nearest = (0..positions.len()).min_by(|a, b| distance(&positions[*a]).total_cmp(&distance(&positions[*b])));
    let Some(nearest) = nearest else { return Array1::zeros(0) };
    let vector = |i: usize| -> Vec<f64> {
        windows.iter().flat_map(|w| w.light_dn.row(beads[i]).to_vec()).map(f64::from).collect()
    };
    let axis = vector(nearest);
    (0..beads.len()).map(|i| pearson(&axis, &vector(i)) as f32).collect()
}

fn pearson(a: &[f64], b: &[f64]) -> f64 {
    let n = a.len().max(1) as f64;
    let (ma, mb) = (a.iter().sum::<f64>() / n, b.iter().sum::<f64>() / n);
    let (mut ab, mut aa, mut bb) = (0.0, 0.0, 0.0);
    for (x, y) in a.iter().zip(b) {
        ab += (x - ma) * (y - mb);
        aa += (x - ma).powi(2);
        bb += (y - mb).powi(2);
    }
    if aa * bb > 0.0 { ab / (aa * bb).sqrt() } else { 0.0 }
}
