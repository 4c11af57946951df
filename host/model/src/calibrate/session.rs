//! Session -> instrument: noise, chief rays, bead windows, low-rank model, light unit, errors.

use super::coarse;
use super::error::CalibrateError;
use super::frames;
use super::light_unit::{fit_light_unit, set_light_unit};
use super::model::{Model, ModelConfig};
use super::replicates::{ReplicateRequest, replicates};
use super::sensor_only;
use crate::bead::{BeadBackground, BeadCut, BeadScan, cut_windows, extent, fit_chief_rays, remove_background};
use crate::check::scan::same_depth;
use crate::check::{Finding, Severity, check};
use crate::instrument::{Diagnostics, Instrument, LightUnit, Quality};
use crate::psf::BeadScale;
use crate::psf::fit::{FitConfig, Plane};
use crate::slopes::Slopes;
use ndarray::Array2;
use ommatidia_physics::noise::{Bend, NoiseCalibration, NoiseConfig, inverse_response, measure_noise};
use ommatidia_physics::sensor::SensorMaps;
use ommatidia_session::{Manifest, Role, Session, with_error};
use serde::{Deserialize, Serialize};

/// Largest NRMSE on positions that were left out, apart from the noise: a model that misses more than a quarter of the
/// light's power between its positions says nothing about them.
const MOST_OFF_GRID: f64 = 0.5;

/// Largest scatter of the brightness of beads that were left out, relative, which still counts as that of one bead. A
/// brightness that the lamp and the optics cause is smooth over the field, and is predicted far better.
const MOST_SCATTER: f64 = 0.03;

/// The scatter of the brightness counts from this many times what noise causes.
const MOST_NOISE: f64 = 3.0;

/// Settings of a calibration.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct CalibrateConfig {
    /// Number of terms (rank) of each lens; None: chosen by held-out error.
    pub rank: Option<usize>,
    /// Largest rank that is tried where the rank is chosen.
    pub max_rank: usize,
    /// Side of the window that holds one focus, px, odd; None: the nominal side, widened until almost no light falls
    /// outside.
    pub window_px: Option<usize>,
    /// Fits one PSF for the whole field of each lens instead of the low-rank model.
    pub one_psf: bool,
    /// Number of jackknife refits (each leaves out a group of beads) that estimate the uncertainty of the PSF model. 0
    /// disables them.
    pub replicates: usize,
    /// Whether the brightness of single bead frames is not that of the bead, as where frames are already normalised one
    /// by one: then each is brought to the same total light. None: decided from the data.
    pub normalise_beads: Option<bool>,
    /// Calibrates even where the checks of the session find errors; they become notes.
    pub accept: bool,
    /// Nominal noise, used where the session does not determine it.
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
            normalise_beads: None,
            accept: false,
            noise: NoiseConfig::default(),
        }
    }
}

/// A calibrated instrument and notes for its user.
#[derive(Clone, Debug)]
pub struct Calibration {
    /// The instrument.
    pub instrument: Instrument,
    /// Warnings: nominal figures, dead lenses, saturated pixels.
    pub notes: Vec<String>,
    /// Whether each bead frame was brought to the same total light.
    pub beads_normalised: bool,
    /// The bend of the sensor's response that the flats show; None where they show none.
    pub bend: Option<Bend>,
    /// Scatter of the brightness of the beads about what their neighbours predict, relative; None where it was not
    /// needed for a decision.
    pub bead_scatter: Option<f64>,
}

/// Calibrates the instrument of a session. `step` is called about once for each frame that is read, for progress bars.
///
/// A session without a bead scan, whose object and sensor share one grid, gives an instrument whose optics are the
/// identity.
///
/// # Errors
/// The session holds no usable bead scan, or a frame cannot be read.
pub fn calibrate(
    session: &Session,
    config: &CalibrateConfig,
    mut step: impl FnMut(),
) -> Result<Calibration, CalibrateError> {
    calibrate_with(session, config, &mut step)
}

/// As [`calibrate()`]. It is compiled once, and not again for each crate that calls it.
fn calibrate_with(
    session: &Session,
    config: &CalibrateConfig,
    step: &mut dyn FnMut(),
) -> Result<Calibration, CalibrateError> {
    let mut manifest = Manifest { stacks: Vec::new(), ..session.manifest().clone() };
    let checked = check(session, &mut *step)?;
    let errors: Vec<Finding> = checked.at_least(Severity::Error).cloned().collect();
    if !(errors.is_empty() || config.accept) {
        return Err(CalibrateError::Check(errors));
    }
    let noise = measure_noise(session, &config.noise, step)?;
    let bend = noise.bend;
    let mut notes: Vec<String> =
        checked.at_least(Severity::Warning).filter(|f| is_new(f)).map(|f| format!("{}: {}", f.topic, f.text)).collect();
    let of_noise: Vec<String> = noise.notes.iter().map(ToString::to_string).collect();
    notes.extend(of_noise);
    if let Some(useless) = noise.useless() {
        let pixels = useless.iter().filter(|u| **u).count();
        notes.push(format!(
            "{pixels} pixels are noisy, hot or dead: left out of the foci, and given less weight elsewhere"
        ));
    }
    let (mut normalised, mut bead_scatter) = (config.normalise_beads == Some(true), None);
    let mut instrument = if sensor_only::applies(session) {
        notes.push(sensor_only::NOTE.into());
        sensor_only::instrument(session, manifest, noise)?
    } else {
        let mut scan = BeadScan::open(session, noise.model, maps(&noise), noise.bend)?;
        let fitted = fit_chief_rays(&mut scan, &manifest, step)?;
        let background = remove_background(&mut scan, &manifest, &fitted.rays, noise.map_errors.offset_dn, step)?;
        notes.extend(background_note(background.as_ref().map(|(b, _)| b)));
        let nominal = manifest.optics.psf_window_px;
        if let Some(found) = config.window_px.filter(|side| side.is_multiple_of(2)) {
            return Err(CalibrateError::Window { found });
        }
        let extent = extent(&mut scan, &manifest, &fitted.rays, step)?;
        // Foci that wander about their chief rays need room as well as those that have tails.
        let grown = || extent.as_ref().map_or(nominal, |e| e.side_px().max(nominal));
        manifest.optics.psf_window_px = config.window_px.unwrap_or_else(grown);
        let side = manifest.optics.psf_window_px;
        let outside_window = extent.as_ref().map_or(0.0, |e| e.outside(side, background.is_none()));
        let planes = planes(&scan);
        let dead = &fitted.rays.dead;
        let mut fit_with = |scale| -> Result<_, CalibrateError> {
            let cut = BeadCut { scale, nominal_px: nominal };
            let (windows, warnings) = cut_windows(&mut scan, &manifest, &fitted.rays, cut, step)?;
            let fit = FitConfig { rank: config.rank, max_rank: config.max_rank, one_psf: config.one_psf, scale };
            let target = ModelConfig { fit, manifest: &manifest, exposure_ms: scan.exposure_ms };
            Ok((Model::fit(&windows, dead, &planes, target)?, windows, warnings))
        };
        let mut fitted_model = match config.normalise_beads {
            Some(true) => fit_with(BeadScale::PerFrame)?,
            _ => fit_with(BeadScale::Physical)?,
        };
        // One PSF for the whole field has one brightness: vignetting would count as scatter.
        if config.normalise_beads.is_none() && !config.one_psf {
            let [scatter, noise] = fitted_model.0.brightness_scatter();
            bead_scatter = Some(scatter);
            if scatter > MOST_SCATTER && scatter > MOST_NOISE * noise {
                let before = fitted_model.0.quality(fitted.rms_px).off_grid_error;
                fitted_model = fit_with(BeadScale::PerFrame)?;
                normalised = true;
                notes.push(unequal_beads(scatter, before, fitted_model.0.quality(fitted.rms_px).off_grid_error));
            }
        }
        let (model, windows, warnings) = fitted_model;
        if normalised {
            // The light of frames that are normalised says nothing.
            notes.retain(|note| !note.starts_with("drift"));
        }
        let psf = model.psf()?;
        let quality = model.quality(fitted.rms_px);
        let most = MOST_OFF_GRID.hypot(2.0 * quality.noise_floor);
        if quality.off_grid_error > most {
            let error = CalibrateError::OffGrid { most, found: quality.off_grid_error };
            if !config.accept {
                return Err(error);
            }
            notes.push(error.to_string());
        }
        notes.extend(coarse::note(&quality, model.rank, config));
        let request =
            ReplicateRequest { psf: &psf, windows: &windows, dead, planes: &planes, count: config.replicates };
        let (replicates, note) = replicates(&model, request)?;
        notes.extend(fitted.warnings.iter().chain(&warnings).map(ToString::to_string));
        notes.extend(note);
        let mut instrument = Instrument {
            psf,
            replicates,
            quality: Quality {
                maps: noise.map_errors,
                background: background.as_ref().map(|(b, _)| *b),
                outside_window,
                ..quality
            },
            diagnostics: Diagnostics {
                background_e: by_frame(background.as_ref().map_or(&[], |(_, frames)| frames)),
                ..model.diagnostics(&windows, &planes, noise.photon_transfer)?
            },
            manifest,
            noise: noise.model,
            offset_dn: noise.offset_dn,
            response: noise.response,
            reading_dn2: noise.reading_dn2,
            geometry: fitted.rays,
            effects: noise.bend.iter().map(sensor_only::bend_effect).collect(),
            light_unit: LightUnit::Bead,
            pupils: Default::default(),
        };
        instrument.quality.frame_error = frames::error(&instrument, &mut scan, &planes)?;
        instrument
    };
    match fit_light_unit(session, &instrument)? {
        Some(unit) => set_light_unit(&mut instrument, unit),
        None if session.stacks_of(Role::Scene).any(|s| s.entry().truth.is_some()) => {
            notes.push("the scenes show no light where their truths do: objects stay in units of the bead".into());
        }
        None => {}
    }
    Ok(Calibration { instrument, notes, beads_normalised: normalised, bend, bead_scatter })
}

/// Whether a warning of the checks is not given by the calibration itself, in more detail.
fn is_new(finding: &Finding) -> bool {
    let own = matches!(finding.topic, "counts" | "saturation" | "lenses" | "light");
    finding.severity == Severity::Error || !own
}

/// What was decided about beads of unequal brightness, and why.
fn unequal_beads(scatter: f64, before: f64, after: f64) -> String {
    format!(
        "beads: their brightness scatters by {:.1} % about what their neighbours predict, beyond what a lamp or \
         vignetting does: each frame was brought to the same total light (--normalise-beads=yes). The error on \
         positions that were left out is then {:.1} %, with the brightness as measured {:.1} % (--normalise-beads=no). \
         Vignetting is not part of this model",
        100.0 * scatter,
        100.0 * after,
        100.0 * before
    )
}

/// What the user should know about the background of the bead frames.
fn background_note(found: Option<&BeadBackground>) -> Option<String> {
    let Some(b) = found else {
        return Some(
            "the windows of the foci cover nearly all of the measured pixels: a background of the bead frames cannot \
             be distinguished from the tails of foci, and none was removed"
                .into(),
        );
    };
    if b.tail_e > 0.0 {
        return Some(format!(
            "light far from the foci of the bead frames is {:.3} e- a pixel brighter near the windows than far from \
             them: tails of foci (a halo), which the model leaves out; the background was taken from the farthest \
             pixels. A larger psf_window_px holds more of the tails",
            b.tail_e
        ));
    }
    b.is_seen().then(|| {
        let [level, row, col] = b.mean_e;
        format!(
            "the bead frames have a background of {} e- a pixel ({row:+.2} e- from the first to the last row, \
             {col:+.2} \
             e- from the first to the last column): removed from the PSFs. Scenes of this session may have it too; \
             `close` fits it",
            with_error(level, b.sigma_e[0], 2)
        )
    })
}

/// The background of each frame as an array, [bead, (level, row, col)], e-.
fn by_frame(background_e: &[Slopes]) -> Array2<f32> {
    Array2::from_shape_fn((background_e.len(), 3), |(n, a)| background_e[n][a] as f32)
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
    depths.dedup_by(|a, b| same_depth(*a, *b));
    let plane = |z_um: &f64| {
        let beads: Vec<usize> = (0..scan.beads.len()).filter(|n| same_depth(scan.beads[*n].z_um, *z_um)).collect();
        let at_px = Array2::from_shape_fn((beads.len(), 2), |(i, a)| scan.beads[beads[i]].at_px[a]);
        Plane { z_um: *z_um, beads, at_px }
    };
    depths.iter().map(plane).collect()
}
