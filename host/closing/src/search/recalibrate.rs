//! Recalibration: when the PSFs vary more over the field than the model allows, no single effect explains it, and the
//! model needs more terms. A trial calibration on the training beads of the session, judged on the held-out beads,
//! measures how much better the model could be.

use crate::data::{Budget, Observations, bead_is_held_out, part_of};
use crate::evidence::{Figures, figures};
use crate::fit::{Model, refit};
use ommatidia_model::calibrate::{CalibrateConfig, calibrate};
use ommatidia_model::instrument::Instrument;
use ommatidia_physics::noise::NoiseConfig;
use ommatidia_session::{Role, Session, SessionError};

/// A new calibration counts if it lowers the NRMSE of held-out beads below this share of the old one's.
const BETTER: f64 = 0.9;

/// Calibrates on the training beads of a session, all but one colour of the checkerboard. Returns the instrument if it
/// predicts the held-out beads clearly better than `before` does (NRMSE lower by a tenth). Returns None as well where
/// the session has no beads, or has scenes with known objects, which judge the model better than beads.
///
/// # Errors
/// The session cannot be read or calibrated.
pub fn trial_calibration(
    session: &Session,
    before: &Instrument,
    config: &CalibrateConfig,
) -> anyhow::Result<Option<Instrument>> {
    let known = session.stacks_of(Role::Scene).any(|s| s.entry().truth.is_some());
    if known || session.stacks_of(Role::Bead).next().is_none() {
        return Ok(None);
    }
    let trial = calibration_of(&without_held_out_beads(session)?, before, config)?;
    let nrmse = |instrument| -> anyhow::Result<f64> { Ok(held_out_figures(session, instrument)?.nrmse) };
    Ok((nrmse(&trial)? < BETTER * nrmse(before)?).then_some(trial))
}

/// Calibrates on a session of the instrument `before`. What the session does not show of the sensor (the noise without
/// flats and darks, the maps and the bend of the response without the frames that they are measured on) stays as it
/// was.
///
/// # Errors
/// The session cannot be read or calibrated.
pub(crate) fn calibration_of(
    session: &Session,
    before: &Instrument,
    config: &CalibrateConfig,
) -> anyhow::Result<Instrument> {
    let noise = NoiseConfig {
        nominal_gain_dn_per_e: Some(before.noise.gain_dn_per_e),
        nominal_read_noise_e: Some(before.noise.read_noise_e),
    };
    let mut it = calibrate(session, &CalibrateConfig { noise, ..*config }, || {})?.instrument;
    let has = |role| session.stacks_of(role).next().is_some();
    let (darks, flats) = (has(Role::Dark), has(Role::Flat));
    if !darks && !flats {
        it.noise = before.noise;
    }
    if !darks {
        (it.offset_dn, it.reading_dn2) = (before.offset_dn.clone(), before.reading_dn2.clone());
        it.quality.maps.offset_dn = before.quality.maps.offset_dn;
    }
    if !flats {
        it.effects = before.bends().cloned().collect();
    }
    if !(darks && flats) {
        it.response = before.response.clone();
        it.quality.maps.response = before.quality.maps.response;
    }
    Ok(it)
}

/// How well an instrument predicts the held-out frames of a session, with the light of each stack and the black level
/// fitted to the other frames.
///
/// # Errors
/// The session cannot be read, or has another layout than the instrument.
pub fn held_out_figures(session: &Session, instrument: &Instrument) -> anyhow::Result<Figures> {
    let seen = Observations::read(session, &Budget::default())?;
    let model = Model::new(instrument, &seen)?;
    Ok(figures(&model, &refit(&model, model.state(instrument)?)?))
}

/// The session without its scenes and held-out beads.
fn without_held_out_beads(session: &Session) -> Result<Session, SessionError> {
    part_of(session, |_, stack, i| match stack.role() {
        Role::Scene => false,
        Role::Bead => !bead_is_held_out(i),
        Role::Dark | Role::Flat => true,
    })
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;
    use ommatidia_bench::{BenchConfig, ScanConfig};
    use ommatidia_session::FrameInfo;

    #[test]
    fn held_out_beads_and_scenes_are_absent_and_all_other_frames_are_the_same() {
        let mut config = BenchConfig::default();
        (config.sensor.rows, config.sensor.cols) = (50, 70);
        (config.array.rows, config.array.cols, config.array.pitch_px) = (1, 2, 20.0);
        config.optics.psf_field_px = 31;
        config.optics.aperture_um = 20.0;
        (config.object.rows, config.object.cols) = (18, 22);
        config.scan = ScanConfig { rows: 1, cols: 5, ..ScanConfig::default() };
        (config.stacks.dark_frames, config.stacks.flat_frames, config.stacks.scene_frames) = (2, 1, 1);
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("session");
        config.build(&[]).unwrap().measure(&path, 3, |_| ()).unwrap();
        let whole = Session::open(&path).unwrap();
        let part = without_held_out_beads(&whole).unwrap();
        assert!(part.stacks_of(Role::Scene).next().is_none());
        for (all, some) in whole.stacks().iter().filter(|s| s.role() != Role::Scene).zip(part.stacks()) {
            let step = if all.role() == Role::Bead { 2 } else { 1 };
            assert_eq!((all.role(), all.len().div_ceil(step)), (some.role(), some.len()));
            let (mut a, mut b) = (all.frames().unwrap(), some.frames().unwrap());
            for i in 0..some.len() {
                assert_eq!(a.read(step * i).unwrap(), b.read(i).unwrap());
                assert_eq!(FrameInfo { frame: i, ..all.info()[step * i].clone() }, some.info()[i]);
            }
        }
    }
}
