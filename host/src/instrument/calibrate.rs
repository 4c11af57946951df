//! Session -> instrument: noise, chief rays, windows, low-rank model, light unit, and how good it all is.

use super::light_unit::{fit_light_unit, set_light_unit};
use super::model::Model;
use super::replicates::replicates;
use super::{Instrument, LightUnit, Quality, sensor_only};
use crate::bead::{BeadError, BeadScale, BeadScan, cut_windows, extent, fit_chief_rays};
use crate::forward::ForwardError;
use crate::linalg::NotConverged;
use crate::noise::{NoiseCalibration, NoiseConfig, NoiseError, inverse_response, measure_noise};
use crate::psf::fit::{FitConfig, Plane};
use crate::sensor::SensorMaps;
use crate::session::{Manifest, Role, Session, SessionError};
use ndarray::Array2;
use serde::{Deserialize, Serialize};
use thiserror::Error;

/// How an instrument is calibrated.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct CalibrateConfig {
    /// Terms a lens; None: chosen by held-out error.
    pub rank: Option<usize>,
    /// Most terms that are tried where the rank is chosen.
    pub max_rank: usize,
    /// Side of the windows that hold one focus, px, odd; None: the nominal one, widened until next to no light falls outside.
    pub window_px: Option<usize>,
    /// One PSF a lens for the whole field instead of the low-rank model.
    pub one_psf: bool,
    /// Refits with a part of the beads left out, which tell how uncertain the PSF model is; 0: none.
    pub replicates: usize,
    /// The bead frames were normalised by who measured them: their brightness means nothing.
    pub normalise_beads: bool,
    /// Nominal noise where the session cannot tell it.
    pub noise: NoiseConfig,
}

impl Default for CalibrateConfig {
    fn default() -> Self {
        Self {
            rank: None,
            max_rank: 32,
            window_px: None,
            one_psf: false,
            replicates: 8,
            normalise_beads: false,
            noise: NoiseConfig::default(),
        }
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
    /// The window.
    #[error("window: expected an odd number of pixels, found {found}")]
    Window {
        /// What was asked for.
        found: usize,
    },
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
/// A session without a bead scan gives an instrument whose optics is the identity, where object and sensor share one grid.
///
/// # Errors
/// The session holds no usable bead scan, or a frame cannot be read.
pub fn calibrate(
    session: &Session,
    config: &CalibrateConfig,
    mut step: impl FnMut(),
) -> Result<Calibration, CalibrateError> {
    let mut manifest = Manifest { stacks: Vec::new(), ..session.manifest().clone() };
    let noise = measure_noise(session, &config.noise, &mut step)?;
    let mut notes: Vec<String> = noise.notes.iter().map(ToString::to_string).collect();
    if let Some(useless) = noise.useless() {
        let pixels = useless.iter().filter(|u| **u).count();
        notes.push(format!(
            "{pixels} pixels are noisy or dead (telegraph, hot): left out of the foci, weighted down elsewhere"
        ));
    }
    let mut instrument = if sensor_only::applies(session) {
        notes.push(sensor_only::NOTE.into());
        sensor_only::instrument(session, manifest, noise)?
    } else {
        let mut scan = BeadScan::open(session, noise.model, maps(&noise))?;
        let rays = fit_chief_rays(&mut scan, &manifest, &mut step)?;
        let nominal = manifest.optics.psf_window_px;
        manifest.optics.psf_window_px = match config.window_px {
            Some(found) if found.is_multiple_of(2) => return Err(CalibrateError::Window { found }),
            Some(side) => side,
            None => {
                // Foci that wander about their chief rays need room as well as those that have tails.
                extent(&mut scan, &manifest, &rays.geometry, &mut step)?.max(nominal)
            }
        };
        let scale = if config.normalise_beads { BeadScale::PerFrame } else { BeadScale::Physical };
        let (windows, warnings) = cut_windows(&mut scan, &manifest, &rays.geometry, (scale, nominal), &mut step)?;
        let planes = planes(&scan);
        let fit = FitConfig { rank: config.rank, max_rank: config.max_rank, one_psf: config.one_psf, scale };
        let dead = &rays.geometry.dead;
        let model = Model::fit(&windows, dead, &planes, fit, (&manifest, scan.exposure_ms))?;
        let psf = model.psf()?;
        let (replicates, note) = replicates(&model, &psf, (&windows, dead), &planes, config.replicates)?;
        notes.extend(rays.warnings.iter().chain(&warnings).map(ToString::to_string));
        notes.extend(note);
        Instrument {
            psf,
            replicates,
            quality: Quality { maps: noise.left, ..model.quality(rays.rms_px) },
            diagnostics: model.diagnostics(&windows, &planes, noise.photon_transfer)?,
            manifest,
            noise: noise.model,
            offset_dn: noise.offset_dn,
            response: noise.response,
            reading_dn2: noise.reading_dn2,
            geometry: rays.geometry,
            effects: Vec::new(),
            light_unit: LightUnit::Bead,
        }
    };
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

fn maps(noise: &NoiseCalibration) -> SensorMaps {
    SensorMaps {
        offset_dn: noise.offset_dn.clone(),
        inverse_response: noise.response.as_ref().map(inverse_response),
        unusable: noise.useless(),
    }
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
