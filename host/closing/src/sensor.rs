//! What a calibration without darks or flats does not know of the sensor, measured on a session that has them.

use super::data::{Observations, Shown, part_of};
use ommatidia_model::instrument::Instrument;
use ommatidia_physics::noise::{NoiseCalibration, NoiseConfig, Source, measure_noise};
use ommatidia_session::{Role, Session};
use std::collections::BTreeSet;

/// Effects that stand for the pattern in an instrument that was closed without knowing it.
const PATTERNS: [&str; 2] = ["dsnu", "prnu"];
/// Dark frames that a pattern is measured on: one does not show its own noise.
const LEAST_DARKS: usize = 2;

/// What a calibration lacks and a session can show.
#[derive(Clone, Copy)]
struct Missing {
    /// Offset of each pixel, black level and read noise: the calibration had no darks.
    offsets: bool,
    /// Response of each pixel: the calibration had no darks or no flats.
    responses: bool,
    /// Gain: the calibration had no flats.
    gain: bool,
}

impl Missing {
    fn of(instrument: &Instrument, seen: &Observations) -> Self {
        let shows = |role, least| seen.of(role).filter(|k| !seen.frames[*k].held_out).count() >= least;
        let (darks, flats) = (shows(Role::Dark, LEAST_DARKS), shows(Role::Flat, 1));
        let effects = &instrument.effects;
        let has_pattern = effects.iter().any(|e| PATTERNS.contains(&e.id.as_str()));
        let [no_darks, no_flats] = [instrument.offset_dn.is_none(), instrument.noise.sources.gain != Source::Measured];
        Self {
            offsets: darks && no_darks && !has_pattern,
            responses: darks && flats && (no_darks || no_flats) && instrument.response.is_none() && !has_pattern,
            // Strengths of effects may be in electrons.
            gain: flats && no_flats && effects.is_empty(),
        }
    }

    fn any(self) -> bool {
        self.offsets || self.responses || self.gain
    }
}

/// Measures what a calibration without darks or flats does not know of the sensor on those of a session: offset and
/// response of each pixel, black level, read noise and gain. Frames that are held out take no part. Returns the
/// sentence that says so; None: nothing was missing, or the session cannot show it.
pub(crate) fn complete_sensor(instrument: &mut Instrument, session: &Session, seen: &Observations) -> Option<String> {
    let missing = Missing::of(instrument, seen);
    if !missing.any() {
        return None;
    }
    let found = match measured(instrument, session, seen) {
        Ok(found) => found,
        Err(e) => {
            return Some(format!(
                "the calibration had no darks or no flats, and the sensor could not be measured on those of this \
                 session: {e}"
            ));
        }
    };
    let what = adopt(instrument, missing, found);
    (!what.is_empty()).then(|| {
        format!(
            "the calibration had no {}, so that it does not know {}: they were measured on this session, and a change \
             of them since the calibration cannot be seen",
            if missing.offsets { "darks" } else { "flats" },
            what.join(", ")
        )
    })
}

/// The sensor as darks and flats of the session show it that are not held out.
fn measured(instrument: &Instrument, session: &Session, seen: &Observations) -> anyhow::Result<NoiseCalibration> {
    let held_out: BTreeSet<(usize, usize)> = seen
        .frames
        .iter()
        .filter(|f| f.held_out && matches!(f.shown, Shown::Dark | Shown::Even))
        .map(|f| (f.stack, f.info.frame))
        .collect();
    let of_sensor =
        part_of(session, |s, stack, i| matches!(stack.role(), Role::Dark | Role::Flat) && !held_out.contains(&(s, i)))?;
    let noise = &instrument.noise;
    let config = NoiseConfig {
        nominal_gain_dn_per_e: Some(noise.gain_dn_per_e),
        nominal_read_noise_e: Some(noise.read_noise_e),
    };
    Ok(measure_noise(&of_sensor, &config, &mut || ())?)
}

/// Takes over what is missing, and lists it.
fn adopt(instrument: &mut Instrument, missing: Missing, found: NoiseCalibration) -> Vec<&'static str> {
    let mut what = Vec::new();
    let model = found.model;
    if missing.gain && model.sources.gain == Source::Measured {
        instrument.set_gain(model.gain_dn_per_e, model.gain_sigma);
        what.push("the gain");
    }
    if missing.offsets {
        let noise = &mut instrument.noise;
        if noise.sources.black_level != Source::Measured {
            noise.black_level_dn = model.black_level_dn;
            noise.sources.black_level = model.sources.black_level;
        }
        if noise.sources.read_noise != Source::Measured {
            // Noise in DN does not depend on the gain.
            let electrons = model.gain_dn_per_e / noise.gain_dn_per_e;
            noise.read_noise_e = model.read_noise_e * electrons;
            noise.read_noise_sigma = model.read_noise_sigma * electrons;
            noise.sources.read_noise = model.sources.read_noise;
        }
        instrument.offset_dn = found.offset_dn;
        instrument.reading_dn2 = found.reading_dn2;
        instrument.quality.maps.offset_dn = found.map_errors.offset_dn;
        instrument.quality.maps.reading = found.map_errors.reading;
        what.extend(["black level", "read noise", "the offset of each pixel"]);
    }
    if let Some(response) = found.response.filter(|_| missing.responses) {
        instrument.response = Some(response);
        instrument.quality.maps.response = found.map_errors.response;
        what.push("the response of each pixel");
    }
    what
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;
    use crate::data::Budget;
    use ommatidia_bench::{BenchConfig, ScanConfig};
    use ommatidia_model::calibrate::{CalibrateConfig, calibrate};
    use ommatidia_model::forward::Forward;
    use ommatidia_model::psf::OperatorConfig;
    use ommatidia_physics::effects::EffectSetting;

    #[test]
    fn a_session_shows_what_its_calibration_lacks_and_nothing_where_it_lacks_nothing() {
        let mut bench = BenchConfig::default();
        (bench.sensor.rows, bench.sensor.cols) = (50, 70);
        (bench.array.rows, bench.array.cols, bench.array.pitch_px) = (1, 2, 20.0);
        bench.optics.psf_field_px = 31;
        bench.optics.aperture_um = 20.0;
        (bench.object.rows, bench.object.cols) = (18, 22);
        bench.scan = ScanConfig { rows: 5, cols: 5, ..ScanConfig::default() };
        (bench.stacks.dark_frames, bench.stacks.flat_frames, bench.stacks.scene_frames) = (16, 8, 2);
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("session");
        let pattern = EffectSetting::new("dsnu", &[("rms_dn", 3.0)]);
        bench.build(&[pattern]).unwrap().measure(&path, 3, |_| ()).unwrap();
        let session = Session::open(&path).unwrap();
        let seen = Observations::read(&session, &Budget::default()).unwrap();
        let config = CalibrateConfig { rank: Some(2), replicates: 2, ..CalibrateConfig::default() };
        let calibrated = |without: &[Role]| {
            let part = part_of(&session, |_, stack, _| !without.contains(&stack.role())).unwrap();
            calibrate(&part, &config, || ()).unwrap().instrument
        };
        let whole = calibrated(&[]);
        assert_eq!(complete_sensor(&mut whole.clone(), &session, &seen), None);

        let mut no_darks = calibrated(&[Role::Dark]);
        assert!(no_darks.offset_dn.is_none());
        let note = complete_sensor(&mut no_darks, &session, &seen).unwrap();
        assert!(note.contains("had no darks") && note.contains("the offset of each pixel"), "{note}");
        // A quarter of the darks is held out, so that the two maps differ by some of their noise.
        let (a, b) = (no_darks.offset_dn.unwrap(), whole.offset_dn.as_ref().unwrap());
        let rms = |map: &ndarray::Array2<f32>| map.iter().map(|v| v * v).sum::<f32>().sqrt();
        assert!(rms(&(&a - b)) < 0.1 * rms(b), "{} {}", rms(&(&a - b)), rms(b));
        assert!((no_darks.noise.black_level_dn - whole.noise.black_level_dn).abs() < 0.1);
        assert!((no_darks.noise.read_noise_e / whole.noise.read_noise_e - 1.0).abs() < 0.1);

        let mut no_flats = calibrated(&[Role::Flat]);
        let nominal = no_flats.clone();
        let note = complete_sensor(&mut no_flats, &session, &seen).unwrap();
        assert!(note.contains("had no flats") && note.contains("the gain"), "{note}");
        assert!((no_flats.noise.gain_dn_per_e / whole.noise.gain_dn_per_e - 1.0).abs() < 0.05);
        // The frame that an object makes is the same in DN, and that of the whole calibration.
        let dn = |i: &Instrument| {
            let forward = Forward::with_config(i, OperatorConfig::exact(0)).unwrap();
            let object = ndarray::Array2::<f32>::ones((18, 22));
            let light_e = forward.expected_e(object.view(), &forward.context()).unwrap();
            f64::from(light_e.sum()) * i.noise.gain_dn_per_e
        };
        // The responses of the pixels, whose mean is 1, came with the gain.
        assert!((dn(&no_flats) / dn(&nominal) - 1.0).abs() < 5e-3, "{} {}", dn(&no_flats), dn(&nominal));
        assert!((dn(&no_flats) / dn(&whole) - 1.0).abs() < 0.05);
        assert!(no_flats.offset_dn == nominal.offset_dn);
    }
}
