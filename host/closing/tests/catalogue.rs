//! Effects of the catalogue in sessions of a small virtual instrument whose bead scan has three depths: each is named
//! alone, with its strength, and nothing is found without one.
#![allow(clippy::unwrap_used)]

use ommatidia_bench::{BenchConfig, VirtualInstrument};
use ommatidia_closing::study::instruments;
use ommatidia_closing::study::size::Size;
use ommatidia_closing::{Budget, CloseOptions, Closing, Observations, close};
use ommatidia_model::calibrate::{CalibrateConfig, calibrate};
use ommatidia_model::instrument::Instrument;
use ommatidia_physics::effects::EffectSetting;
use ommatidia_session::{Role, Session};
use std::sync::OnceLock;

struct Subject {
    config: BenchConfig,
    bench: VirtualInstrument,
    instrument: Instrument,
}

fn subject() -> &'static Subject {
    static SUBJECT: OnceLock<Subject> = OnceLock::new();
    SUBJECT.get_or_init(|| {
        let mut config = instruments::config(&Size::quick(1), 0).unwrap();
        let bench = config.build_like(&config.build(&[]).unwrap(), &[]).unwrap();
        let instrument = calibrated(&bench);
        (config.stacks.dark_frames, config.stacks.flat_frames) = (4, 2);
        Subject { config, bench, instrument }
    })
}

fn calibrated(bench: &VirtualInstrument) -> Instrument {
    let folder = tempfile::tempdir().unwrap();
    bench.measure(&folder.path().join("calibration"), 1, |_| ()).unwrap();
    let session = Session::open(folder.path().join("calibration")).unwrap();
    // The rank is fixed: its search takes most of the time.
    let calibration = CalibrateConfig { rank: Some(12), ..CalibrateConfig::default() };
    calibrate(&session, &calibration, || {}).unwrap().instrument
}

/// Closes a session of some stacks with an effect.
fn closed(config: &BenchConfig, roles: &[Role], effect: Option<EffectSetting>, seed: u64) -> Closing {
    closed_with(&subject().instrument, config, roles, effect, seed)
}

/// The same with an instrument of one's own.
fn closed_with(
    instrument: &Instrument,
    config: &BenchConfig,
    roles: &[Role],
    effect: Option<EffectSetting>,
    seed: u64,
) -> Closing {
    closed_of(instrument, config, roles, &effect.into_iter().collect::<Vec<_>>(), seed)
}

/// The same with any number of effects.
fn closed_of(
    instrument: &Instrument,
    config: &BenchConfig,
    roles: &[Role],
    effects: &[EffectSetting],
    seed: u64,
) -> Closing {
    let folder = tempfile::tempdir().unwrap();
    let dir = folder.path().join("session");
    config.build_like(&subject().bench, effects).unwrap().measure_some(&dir, seed, roles, |_| ()).unwrap();
    let mut seen = Observations::read(&Session::open(&dir).unwrap(), &Budget::default()).unwrap();
    let options = CloseOptions { seed: 1, ..CloseOptions::default() };
    let closing = close(instrument, &mut seen, &options, |_| ()).unwrap().account.closing;
    eprintln!("--- {effects:?}: {:?} -> {:?}", closing.before, closing.after);
    closing.effects.iter().for_each(|e| eprintln!("{} (z = {:.1}): {}", e.id, e.z, e.description));
    closing.nearest.iter().for_each(|n| eprintln!("like {} (z = {:.1}): {}", n.id, n.z, n.why));
    closing
}

/// Asserts that an effect is the only one that is named, with values within 10 % and the last digit of the truth.
fn is_named(closing: &Closing, id: &str, params: &[(&str, f64)]) {
    let names: Vec<&str> = closing.effects.iter().filter(|e| e.known).map(|e| e.id.as_str()).collect();
    assert_eq!(names, [id]);
    for (name, truth) in params {
        let found = closing.effects[0].params.iter().find(|p| p.name == *name).unwrap();
        let room = 0.1 * truth.abs() + 5.0 * found.sigma;
        assert!((found.value - truth).abs() < room, "{id} {name}: {} +- {}", found.value, found.sigma);
    }
}

/// Asserts that two effects at once are named, and nothing else.
fn both_are_named(effects: [(&str, &[(&str, f64)]); 2], seed: u64) {
    let settings = effects.map(|(id, params)| EffectSetting::new(id, params));
    let closing = closed_of(&subject().instrument, &subject().config, &WHOLE, &settings, seed);
    let mut names: Vec<&str> = closing.effects.iter().map(|e| e.id.as_str()).collect();
    names.sort_unstable();
    assert_eq!(names, effects.map(|(id, _)| id));
    for (id, params) in effects {
        let found = closing.effects.iter().find(|e| e.id == id).unwrap();
        for (name, truth) in params {
            let p = found.params.iter().find(|p| p.name == *name).unwrap();
            assert!((p.value - truth).abs() < 0.1 * truth.abs() + 5.0 * p.sigma, "{id}: {} +- {}", p.value, p.sigma);
        }
    }
}

const WHOLE: [Role; 3] = [Role::Dark, Role::Flat, Role::Scene];

fn whole(id: &str, params: &[(&str, f64)], seed: u64) {
    let closing = closed(&subject().config, &WHOLE, Some(EffectSetting::new(id, params)), seed);
    is_named(&closing, id, params);
}

#[test]
fn nothing_is_found_in_nothing() {
    for seed in [901, 902] {
        let closing = closed(&subject().config, &WHOLE, None, seed);
        assert!(closing.effects.is_empty(), "{:?}", closing.effects);
    }
}

/// Noise of less than a DN is rounded to few codes, whose kurtosis is not that of noise.
#[test]
fn nothing_is_found_in_noise_of_few_codes() {
    let mut config = subject().config.clone();
    (config.sensor.gain_dn_per_e, config.sensor.read_noise_e) = (0.33, 1.2);
    let instrument = calibrated(&config.build_like(&subject().bench, &[]).unwrap());
    let closing = closed_with(&instrument, &config, &[Role::Dark, Role::Flat], None, 960);
    assert!(closing.effects.is_empty() && closing.nearest.is_empty(), "{:?} {:?}", closing.effects, closing.nearest);
    assert!(!closing.catalogue_incomplete);
}

/// Flats show a drift of their lamp, and held-out scenes hardly do: chance makes their figures a little better (the
/// first seed) or worse (the second). The name stands in both, and the closed instrument never predicts worse.
#[test]
fn a_drift_of_the_lamp_is_named_whatever_held_out_scenes_say() {
    for seed in [914, 915] {
        let drift = EffectSetting::new("lamp_drift", &[("rate_per_s", 0.012)]);
        let closing = closed(&subject().config, &WHOLE, Some(drift), seed);
        is_named(&closing, "lamp_drift", &[("rate_per_s", 0.012)]);
        assert!(
            closing.after.chi2_ndf <= closing.before.chi2_ndf && closing.after.nrmse <= 1.001 * closing.before.nrmse
        );
        assert_eq!(closing.effects[0].added, closing.after != closing.before);
    }
}

/// Each brightens the frames where the other one darkens them, so that neither explains them alone.
#[test]
fn two_effects_that_hide_each_other() {
    both_are_named([("exposure_offset", &[("dt_ms", 0.4)]), ("nonlinearity", &[("beta", 0.1)])], 970);
}

/// The first name is that of an effect which resembles the sum of both.
#[test]
fn two_effects_whose_sum_resembles_a_third() {
    both_are_named([("excitation_profile", &[("falloff", 0.15)]), ("vignetting", &[("v", 0.18)])], 971);
}

/// The weaker one explains less than 3 % of what the stronger one does.
#[test]
fn an_effect_in_the_shadow_of_another_kind() {
    both_are_named([("chief_ray_response", &[("c_per_mm2", 15.0)]), ("pixel_mosaic", &[("checker", 0.03)])], 972);
}

/// A curve bends the noise along with the light, so that chi-squared with the noise of a straight camera says little.
#[test]
fn a_weak_gamma() {
    whole("camera_gamma", &[("gamma", 1.006)], 916);
}

/// Half of the session is of another day, or something was knocked.
#[test]
fn an_array_that_jumps_between_two_frames() {
    let stacks = &subject().config.stacks;
    let since_s = 1e-3 * stacks.interval_ms * (stacks.scene_frames as f64 / 2.0 - 0.5);
    let params = [("row_px", 0.3), ("col_px", -0.2), ("since_s", since_s)];
    let closing = closed(&subject().config, &WHOLE, Some(EffectSetting::new("array_jump", &params)), 980);
    is_named(&closing, "array_jump", &params);
    assert!(closing.effects[0].description.contains("since_s"), "{}", closing.effects[0].description);
}

/// About a point 9 px beside the centre of the array.
#[test]
fn a_sensor_that_turned_about_another_point() {
    whole("sensor_rotation", &[("angle_mrad", 12.0), ("row_px", 0.06), ("col_px", -0.09)], 981);
}

#[test]
fn a_tilted_specimen() {
    whole("tilt", &[("row_um_per_mm", 150.0), ("col_um_per_mm", -250.0)], 903);
}

#[test]
fn telegraph_pixels() {
    whole("telegraph_pixels", &[("amplitude_dn", 12.0)], 904);
}

#[test]
fn a_response_that_falls_with_the_angle() {
    whole("chief_ray_response", &[("c_per_mm2", 15.0)], 905);
}

#[test]
fn a_camera_that_smooths() {
    whole("camera_processing", &[("strength", 0.2)], 906);
}

#[test]
fn coma_of_all_lenses() {
    whole("aberration_drift", &[("coma_row_px3", 0.3), ("coma_col_px3", -0.2)], 907);
}

#[test]
fn backlash_of_the_stage() {
    let mut config = subject().config.clone();
    (config.scan.rows, config.scan.cols, config.scan.serpentine) = (7, 7, true);
    config.scan.depths_um = vec![0.0];
    let backlash = EffectSetting::new("stage_backlash", &[("col_um", 1.0)]);
    let closing = closed(&config, &[Role::Bead], Some(backlash), 908);
    is_named(&closing, "stage_backlash", &[("col_um", 1.0)]);
    // Bright beads show errors of this coarse calibration, which get no name.
    let closing = closed(&config, &[Role::Bead], None, 909);
    assert!(closing.effects.iter().all(|e| !e.known), "{:?}", closing.effects);
}

/// An instrument whose beads were scanned in one plane: pupils predict what such a scan does not show.
fn one_plane() -> &'static (BenchConfig, Instrument) {
    static ONE: OnceLock<(BenchConfig, Instrument)> = OnceLock::new();
    ONE.get_or_init(|| {
        let mut config = subject().config.clone();
        config.scan.depths_um = vec![0.0];
        let instrument = calibrated(&config.build_like(&subject().bench, &[]).unwrap());
        assert!(instrument.pupil_model().is_some());
        (config, instrument)
    })
}

/// Its sign is unknown. Its error includes what the radius of soft pupils leaves open, and is no measure for this test.
#[test]
fn a_specimen_out_of_focus_after_a_scan_in_one_plane() {
    let (config, instrument) = one_plane();
    let defocus = EffectSetting::new("defocus", &[("z_um", 40.0)]);
    let mut closing = closed_with(instrument, config, &WHOLE, Some(defocus), 910);
    assert!(closing.notes.iter().any(|n| n.contains("sign is unknown")), "{:?}", closing.notes);
    let z_um = &mut closing.effects[0].params[0];
    z_um.value = z_um.value.abs();
    assert!((z_um.value - 40.0).abs() < 4.0 && (2.0..6.0).contains(&z_um.sigma), "{z_um:?}");
    is_named(&closing, "defocus", &[("z_um", 40.0)]);
}

/// The bench's pupils have soft rims, and end farther out than hard ones that are fitted to them. Coma grows with the
/// cube of the distance from the centre: the same wavefront has a coefficient smaller by the cube of the radii.
#[test]
fn coma_after_a_scan_in_one_plane() {
    let (config, instrument) = one_plane();
    let coma = [("coma_row_waves", 0.02), ("coma_col_waves", -0.03), ("row_px", 0.25), ("col_px", -0.38)];
    let mut closing = closed_with(instrument, config, &WHOLE, Some(EffectSetting::new("wavefront_drift", &coma)), 911);
    let distance_um = config.true_magnification() * config.optics.object_distance_um;
    let radius_um = instrument.pupil_model().unwrap().summary().cutoff_cycles_per_px / config.sensor.pixel_pitch_um
        * config.optics.wavelength_um
        * distance_um;
    let smaller = radius_um / (config.optics.aperture_um / 2.0);
    assert!((0.7..1.0).contains(&smaller), "{smaller}");
    for p in closing.effects[0].params.iter_mut().filter(|p| p.name.starts_with("coma")) {
        (p.value, p.sigma) = (p.value / smaller.powi(3), p.sigma / smaller.powi(3));
    }
    is_named(&closing, "wavefront_drift", &coma);
}

#[test]
fn nothing_is_found_in_nothing_after_a_scan_in_one_plane() {
    let (config, instrument) = one_plane();
    let closing = closed_with(instrument, config, &WHOLE, None, 912);
    assert!(closing.effects.is_empty(), "{:?}", closing.effects);
}
