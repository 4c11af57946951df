//! Session -> instrument: noise, chief rays, windows, low-rank model, light unit, and how good it all is.

use super::{Diagnostics, Instrument, LightUnit, LowRankPsf, Quality};
use crate::bead::{BeadError, BeadScale, BeadScan, LensWindows, RayFit, SensorMaps, cut_windows, fit_chief_rays};
use crate::effects::FrameContext;
use crate::forward::{Forward, ForwardError};
use crate::linalg::NotConverged;
use crate::noise::{NoiseCalibration, NoiseConfig, NoiseError, inverse_response, measure_noise};
use crate::psf::field::{FieldSmoother, ORDERS};
use crate::psf::fit::{self, FitConfig, LensFit, Misfit, Plane};
use crate::psf::nodes::even_nodes;
use crate::session::{Manifest, Role, Session, SessionError};
use ndarray::{Array1, Array2, Array4, Array5, s};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use thiserror::Error;

/// Most nodes a side of a coefficient map.
const MOST_NODES: usize = 65;
/// Scene frames with truth that the light unit is fitted to.
const UNIT_FRAMES: usize = 16;

/// How an instrument is calibrated.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct CalibrateConfig {
    /// Terms a lens; None: chosen by held-out error.
    pub rank: Option<usize>,
    /// Most terms that are tried where the rank is chosen.
    pub max_rank: usize,
    /// The bead frames were normalised by who measured them: their brightness means nothing.
    pub normalise_beads: bool,
    /// Nominal noise where the session cannot tell it.
    pub noise: NoiseConfig,
}

impl Default for CalibrateConfig {
    fn default() -> Self {
        Self { rank: None, max_rank: 32, normalise_beads: false, noise: NoiseConfig::default() }
    }
}

/// An instrument and what its user should know.
#[derive(Clone, Debug)]
pub struct Calibration {
    /// The instrument.
    pub instrument: Instrument,
    /// Warnings: nominal figures, dead lenses, saturated pixels.
    pub notes: Vec<String>,
}

/// Why a session cannot be calibrated.
#[derive(Debug, Error)]
pub enum CalibrateError {
    /// The session.
    #[error(transparent)]
    Session(#[from] SessionError),
    /// The noise.
    #[error(transparent)]
    Noise(#[from] NoiseError),
    /// The bead scan.
    #[error(transparent)]
    Bead(#[from] BeadError),
    /// The model of the result.
    #[error(transparent)]
    Forward(#[from] ForwardError),
    /// The numbers.
    #[error(transparent)]
    NotConverged(#[from] NotConverged),
    /// The rank.
    #[error("rank: expected 1 to {most} (the bead frames at hand), found {found}")]
    Rank {
        /// Largest that the data allow.
        most: usize,
        /// What was asked for.
        found: usize,
    },
}

/// Calibrates the instrument of a session; `step` is called about once for each frame that is read.
///
/// # Errors
/// The session holds no usable bead scan, or a frame cannot be read.
pub fn calibrate(
    session: &Session,
    config: &CalibrateConfig,
    mut step: impl FnMut(),
) -> Result<Calibration, CalibrateError> {
    let manifest = Manifest { stacks: Vec::new(), ..session.manifest().clone() };
    let noise = measure_noise(session, &config.noise, &mut step)?;
    let maps = SensorMaps {
        offset_dn: noise.offset_dn.clone(),
        inverse_response: noise.response.as_ref().map(inverse_response),
    };
    let mut scan = BeadScan::open(session, noise.model, maps)?;
    let rays = fit_chief_rays(&mut scan, &manifest, &mut step)?;
    let scale = if config.normalise_beads { BeadScale::PerFrame } else { BeadScale::Physical };
    let (windows, warnings) = cut_windows(&mut scan, &manifest, &rays.geometry, scale, &mut step)?;
    let planes = planes(&scan);
    let fit = FitConfig { rank: config.rank, max_rank: config.max_rank, scale };
    let model = Model::fit(&windows, &rays.geometry.dead, &planes, fit, &manifest)?;
    let mut notes: Vec<String> = noise.notes.iter().map(ToString::to_string).collect();
    notes.extend(rays.warnings.iter().chain(&warnings).map(ToString::to_string));
    let mut instrument = assemble(manifest, noise, rays, &scan, &windows, &planes, model);
    match fit_light_unit(session, &instrument)? {
        Some(unit) => set_light_unit(&mut instrument, unit),
        None if session.stacks_of(Role::Scene).any(|s| s.entry().truth.is_some()) => {
            notes.push(
                "the scenes show no light where their truths have some: objects stay in units of the bead".into(),
            );
        }
        None => {}
    }
    Ok(Calibration { instrument, notes })
}

/// Beads by depth, ascending.
fn planes(scan: &BeadScan) -> Vec<Plane> {
    let mut depths: Vec<f64> = scan.beads.iter().map(|b| b.z_um).collect();
    depths.sort_by(f64::total_cmp);
    depths.dedup_by(|a, b| (*a - *b).abs() < 1e-3);
    let plane = |z_um: &f64| {
        let beads: Vec<usize> = (0..scan.beads.len()).filter(|n| (scan.beads[*n].z_um - z_um).abs() < 1e-3).collect();
        let at_px = Array2::from_shape_fn((beads.len(), 2), |(i, a)| scan.beads[beads[i]].at_px[a]);
        Plane { z_um: *z_um, beads, at_px }
    };
    depths.iter().map(plane).collect()
}

/// The low-rank model of all lenses, with its errors.
struct Model {
    rank: usize,
    fits: Vec<Option<LensFit>>,
    /// Coefficients at the nodes, by lens and plane, [node, k].
    at_nodes: Vec<Option<Vec<Array2<f64>>>>,
    nodes: [Vec<f64>; 2],
    held_out: Misfit,
    one_psf: f64,
    approximation: Misfit,
    smooth: Misfit,
    config: FitConfig,
}

impl Model {
    fn fit(
        windows: &[LensWindows],
        dead: &[bool],
        planes: &[Plane],
        config: FitConfig,
        manifest: &Manifest,
    ) -> Result<Self, CalibrateError> {
        let beads: Vec<usize> = planes.iter().flat_map(|p| p.beads.clone()).collect();
        let most = beads.len();
        if let Some(found) = config.rank.filter(|r| *r == 0 || *r > most) {
            return Err(CalibrateError::Rank { most, found });
        }
        let tried = config.rank.unwrap_or(0).max(config.max_rank).min(most);
        let even = fit::checkerboard(planes, beads.len());
        let odd: Vec<bool> = even.iter().map(|t| !t).collect();
        // The order of the splines, like the rank, is what predicts best where it was not fitted.
        let mut best: Option<(f64, usize, Misfit)> = None;
        for order in ORDERS {
            let half = |train| fit::hold_out(windows, dead, planes, train, tried, order);
            let held_out = half(&even)?.join(&half(&odd)?);
            let rank = config.rank.unwrap_or_else(|| held_out.best_rank(config.scale));
            let error = held_out.nrmse(rank.min(held_out.ranks()), config.scale);
            if best.as_ref().is_none_or(|(least, ..)| error < *least) {
                best = Some((error, order, held_out));
            }
        }
        let Some((_, order, held_out)) = best else {
            return Err(CalibrateError::Rank { most, found: 0 });
        };
        let rank = config.rank.unwrap_or_else(|| held_out.best_rank(config.scale));
        let one = [&even, &odd].map(|train| fit::one_psf(windows, dead, train));
        let one_psf = one[0].join(&one[1]).nrmse(1, BeadScale::Physical);
        let smoothers =
            planes.iter().map(|p| FieldSmoother::plan(p.at_px.view(), &[order])).collect::<Result<Vec<_>, _>>()?;
        let side = (2 * (planes[0].beads.len() as f64).sqrt().ceil() as usize - 1).clamp(4, MOST_NODES);
        let nodes = [even_nodes(manifest.object.rows, side), even_nodes(manifest.object.cols, side)];
        let grid = Array2::from_shape_fn((nodes[0].len() * nodes[1].len(), 2), |(i, a)| {
            nodes[a][[i / nodes[1].len(), i % nodes[1].len()][a]]
        });
        let lenses = (0..windows.len())
            .into_par_iter()
            .map(|l| {
                if dead[l] {
                    return Ok(None);
                }
                let fit = fit::fit_lens(&windows[l], &beads, tried.max(rank))?;
                let places: Vec<_> = planes.iter().map(|p| p.at_px.clone()).collect();
                let at_beads = fit::interpolate(&fit, &beads, planes, &smoothers, &places)?;
                let grids = vec![grid.clone(); planes.len()];
                let at_nodes = fit::interpolate(&fit, &beads, planes, &smoothers, &grids)?;
                let errors = [
                    fit::approximation(&windows[l], &fit, &beads),
                    fit::predicted(&windows[l], &fit, &at_beads, planes),
                ];
                Ok(Some((fit, at_nodes, errors)))
            })
            .collect::<Result<Vec<_>, NotConverged>>()?;
        let errors = |i: usize| -> Vec<Misfit> { lenses.iter().flatten().map(|(_, _, e)| e[i].clone()).collect() };
        Ok(Self {
            rank,
            approximation: fit::sum_over_lenses(&errors(0)),
            smooth: fit::sum_over_lenses(&errors(1)),
            fits: lenses.iter().map(|l| l.as_ref().map(|(f, _, _)| f.clone())).collect(),
            at_nodes: lenses.into_iter().map(|l| l.map(|(_, n, _)| n)).collect(),
            nodes,
            held_out,
            one_psf,
            config,
        })
    }

    fn psf(&self, side: usize, planes: &[Plane], exposure_ms: f64) -> LowRankPsf {
        let (lenses, rank) = (self.fits.len(), self.rank);
        let [rows, cols] = [self.nodes[0].len(), self.nodes[1].len()];
        let mut basis = Array4::zeros((lenses, rank, side, side));
        let mut coefficients = Array5::zeros((lenses, rank, planes.len(), rows, cols));
        for (l, (fit, fields)) in self.fits.iter().zip(&self.at_nodes).enumerate() {
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
        LowRankPsf {
            basis,
            coefficients,
            node_depths_um: planes.iter().map(|p| p.z_um).collect(),
            node_rows_px: self.nodes[0].clone(),
            node_cols_px: self.nodes[1].clone(),
            exposure_ms,
        }
    }

    fn quality(&self, chief_ray_rms_px: f64) -> Quality {
        let scale = self.config.scale;
        let at = |m: &Misfit| m.nrmse(self.rank.min(m.ranks()), scale);
        Quality {
            approximation_error: at(&self.approximation),
            off_grid_error: at(&self.held_out),
            one_psf_error: self.one_psf,
            noise_floor: self.approximation.noise_floor(),
            chief_ray_rms_px,
        }
    }

    fn diagnostics(&self, windows: &[LensWindows], planes: &[Plane], photon_transfer: Array2<f32>) -> Diagnostics {
        let beads: Vec<usize> = planes.iter().flat_map(|p| p.beads.clone()).collect();
        let places =
            planes.iter().flat_map(|p| p.at_px.outer_iter().map(|a| [a[0] as f32, a[1] as f32]).collect::<Vec<_>>());
        let positions_px: Vec<[f32; 2]> = places.collect();
        let ranks = self.approximation.ranks().min(self.held_out.ranks());
        let scale = self.config.scale;
        Diagnostics {
            pcc: pearson_map(windows, &beads, &positions_px),
            positions_px: Array2::from_shape_fn((beads.len(), 2), |(i, a)| positions_px[i][a]),
            bead_nrmse: self.smooth.by_bead(self.rank.min(self.smooth.ranks()), scale),
            singular_values: Array2::from_shape_fn((self.fits.len(), beads.len()), |(l, i)| {
                let values = self.fits[l].as_ref().map(|f| &f.decomposition.singular_values);
                values.and_then(|v| v.get(i)).copied().unwrap_or(0.0) as f32
            }),
            error_by_rank: Array2::from_shape_fn((ranks, 3), |(i, c)| match c {
                0 => (i + 1) as f32,
                1 => self.approximation.nrmse(i + 1, scale) as f32,
                _ => self.held_out.nrmse(i + 1, scale) as f32,
            }),
            photon_transfer,
        }
    }
}

fn assemble(
    manifest: Manifest,
    noise: NoiseCalibration,
    rays: RayFit,
    scan: &BeadScan,
    windows: &[LensWindows],
    planes: &[Plane],
    model: Model,
) -> Instrument {
    Instrument {
        psf: model.psf(manifest.optics.psf_window_px, planes, scan.exposure_ms),
        quality: model.quality(rays.rms_px),
        diagnostics: model.diagnostics(windows, planes, noise.photon_transfer),
        manifest,
        noise: noise.model,
        offset_dn: noise.offset_dn,
        response: noise.response,
        geometry: rays.geometry,
        effects: Vec::new(),
        light_unit: LightUnit::Bead,
    }
}

/// Pearson correlation of each bead's windows, all lenses together, with those of the bead nearest to the middle of the scan.
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

/// How many of the bead's light one truth unit is: the slope of measured on predicted light, pooled over the scenes with
/// truth, each with a level of its own (so that an even background does not enter). None: no such scenes, or no light in them.
///
/// The weights come from the prediction alone, never from the noisy frame, so the slope is unbiased.
fn fit_light_unit(session: &Session, instrument: &Instrument) -> Result<Option<f64>, CalibrateError> {
    let forward = Forward::new(instrument)?;
    let noise = &instrument.noise;
    let (mut top, mut bottom) = (0.0, 0.0);
    for stack in session.stacks_of(Role::Scene) {
        let Some(mut truths) = stack.truth()? else { continue };
        let mut frames = stack.frames()?;
        for info in stack.info().iter().take(UNIT_FRAMES) {
            let (mut frame, object) = (frames.read(info.frame)?, truths.read(info.frame)?);
            let cx =
                FrameContext { exposure_ms: info.exposure_ms, illumination: info.illumination, ..forward.context() };
            let light_e = forward.expected_e(object.view(), &cx)?;
            if let Some(offset) = &instrument.offset_dn {
                frame -= offset;
            }
            let pairs = light_e.iter().zip(&frame).filter(|(_, y)| f64::from(**y) < noise.saturation_dn);
            let (covariance, variance) = moments(
                pairs.map(|(e, y)| (f64::from(*e) * noise.gain_dn_per_e, f64::from(*y) - noise.black_level_dn)),
            );
            top += covariance;
            bottom += variance;
        }
    }
    Ok((bottom > 0.0 && top > 0.0).then_some(top / bottom))
}

/// Sums of `(x - mean x)(y - mean y)` and `(x - mean x)^2`.
fn moments(pairs: impl Iterator<Item = (f64, f64)>) -> (f64, f64) {
    let mut s = [0.0; 5];
    for (x, y) in pairs {
        for (sum, v) in s.iter_mut().zip([1.0, x, y, x * y, x * x]) {
            *sum += v;
        }
    }
    let n = f64::max(s[0], 1.0);
    (s[3] - s[1] * s[2] / n, s[4] - s[1] * s[1] / n)
}

/// Changes the unit of objects from beads to truth units.
fn set_light_unit(instrument: &mut Instrument, beads_per_unit: f64) {
    instrument.psf.coefficients.mapv_inplace(|v| (f64::from(v) * beads_per_unit) as f32);
    instrument.light_unit = LightUnit::Truth { per_bead: 1.0 / beads_per_unit };
}
