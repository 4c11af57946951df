//! Sessions of every kind: what each is judged on, what can be found in it, and what cannot (docs/closing.md).

use super::{accounted, closed, measured, names, subject};
use ndarray::{Array3, Axis};
use ommatidia_closing::study::sessions::Holds;
use ommatidia_closing::{Account, CloseRequest, Closing, JudgedOn, Progress, Verdict, close_session};
use ommatidia_model::calibrate::CalibrateConfig;
use ommatidia_model::instrument::Instrument;
use ommatidia_model::metrics::compare;
use ommatidia_physics::effects::EffectSetting;
use ommatidia_session::artifact::Provenance;
use ommatidia_session::{FrameReader, Role, Session};

/// Closes a session of a kind with one effect.
fn with(holds: Holds, id: &str, params: &[(&str, f64)], seed: u64) -> Closing {
    eprintln!("--- {holds:?} with {id} {params:?}");
    let folder = tempfile::tempdir().unwrap();
    closed(&measured(holds, &[EffectSetting::new(id, params)], &folder.path().join("session"), seed))
}

/// Whether an effect was searched for: it has an upper limit.
fn is_limited(closing: &Closing, id: &str) -> bool {
    closing.rejected.iter().any(|r| r.id == id && r.upper_limit.is_some())
}

#[test]
fn scenes_alone_show_the_optics_and_no_single_pixels() {
    let closing = with(Holds::ScenesAlone, "vignetting", &[("v", 0.05)], 801);
    assert_eq!((closing.judged_on, names(&closing)), (JudgedOn::Known, vec!["vignetting"]));
    assert!(closing.held_out_frames == [3, 7] && closing.after.chi2_ndf < closing.before.chi2_ndf);
    assert!(is_limited(&closing, "array_shift") && !is_limited(&closing, "prnu") && !is_limited(&closing, "dsnu"));
}

#[test]
fn one_scene_is_judged_on_its_lower_half() {
    let closing = with(Holds::OneFrame, "array_shift", &[("row_px", 0.3)], 802);
    assert_eq!((closing.judged_on, names(&closing)), (JudgedOn::Known, vec!["array_shift"]));
    assert!(closing.held_out_frames.is_empty() && closing.held_out_blocks == [18, 36]);
    assert!(!is_limited(&closing, "thermal_drift") && !is_limited(&closing, "lag"));
}

#[test]
fn darks_and_flats_judge_the_sensor_and_no_optics() {
    let closing = with(Holds::DarksAndFlats, "interpixel_capacitance", &[("alpha", 0.02)], 803);
    assert_eq!((closing.judged_on, names(&closing)), (JudgedOn::Even, vec!["interpixel_capacitance"]));
    // Figures of even light and darks: noise alone gives 1.
    for f in [closing.before, closing.after] {
        assert!((0.8..1.3).contains(&f.chi2_ndf) && f.nrmse > 0.0 && f.nrmse < 0.2, "{f:?}");
    }
    assert!(!is_limited(&closing, "array_shift") && !is_limited(&closing, "magnification"));
}

#[test]
fn darks_alone_show_noise_and_have_no_figures() {
    let folder = tempfile::tempdir().unwrap();
    let dir = folder.path().join("session");
    let mut config = subject().config.clone();
    config.stacks.dark_frames = 12;
    let noise = EffectSetting::new("row_noise", &[("sigma_dn", 1.0)]);
    let bench = config.build_like(&subject().bench, &[noise]).unwrap();
    bench.measure_some(&dir, 807, &[Role::Dark], |_| ()).unwrap();
    let closing = closed(&Session::open(&dir).unwrap());
    assert_eq!((closing.judged_on, names(&closing)), (JudgedOn::Nothing, vec!["row_noise"]));
    assert!(closing.before.chi2_ndf.is_nan() && !is_limited(&closing, "vignetting"));
}

#[test]
fn a_video_of_the_unknown_shows_what_no_specimen_makes() {
    let closing = with(Holds::Video, "row_noise", &[("sigma_dn", 2.0)], 804);
    assert_eq!((closing.judged_on, names(&closing)), (JudgedOn::SelfConsistency, vec!["row_noise"]));
    // Shading of the excitation is a change of the specimen.
    assert!(is_limited(&closing, "lens_gain") && !is_limited(&closing, "excitation_profile"));
}

#[test]
fn nothing_is_found_in_frames_of_the_unknown_without_an_effect() {
    let closing = with(Holds::Unknown, "array_shift", &[], 808);
    assert_eq!((closing.judged_on, names(&closing)), (JudgedOn::SelfConsistency, vec![]));
    assert!((0.9..1.15).contains(&closing.before.chi2_ndf), "{:?}", closing.before);
    assert_eq!(closing.before, closing.after);
}

#[test]
fn a_capacitance_is_found_where_nobody_knows_the_specimens() {
    // The specimens are seen through it: else what they take up of its blur would be missing in the prediction.
    let closing = with(Holds::Unknown, "interpixel_capacitance", &[("alpha", 0.03)], 810);
    assert_eq!((closing.judged_on, names(&closing)), (JudgedOn::SelfConsistency, vec!["interpixel_capacitance"]));
    let p = &closing.effects[0].params[0];
    assert!((p.value - 0.03).abs() < 4.0 * p.sigma && p.sigma < 0.003, "{p:?}");
}

#[test]
fn a_turned_array_is_found_in_frames_of_the_unknown() {
    let folder = tempfile::tempdir().unwrap();
    let turned = EffectSetting::new("array_rotation", &[("angle_mrad", 7.0)]);
    let account = accounted(&measured(Holds::Unknown, &[turned], &folder.path().join("session"), 809));
    let closing = &account.closing;
    assert_eq!((closing.judged_on, names(closing)), (JudgedOn::SelfConsistency, vec!["array_rotation"]));
    let angle = closing.effects[0].params[0].value;
    assert!((angle - 7.0).abs() < 0.5, "{angle}");
    assert!(closing.after.chi2_ndf - 1.0 < 0.2 * (closing.before.chi2_ndf - 1.0), "{:?}", closing.after);
    // The specimens, against truths that the session does not name.
    let mut truths = FrameReader::open(&folder.path().join("session/scene_truth.npy")).unwrap();
    let maps = account.specimens.as_ref().unwrap();
    let file = folder.path().join("account");
    account.write(&file, Provenance::default()).unwrap();
    assert_eq!(Account::read(&file).unwrap().specimens.unwrap().after, maps.after);
    for (i, frame) in maps.frames.iter().enumerate() {
        let truth = truths.read(*frame).unwrap();
        let psnr = |maps: &Array3<f32>| compare(maps.index_axis(Axis(0), i), truth.view()).unwrap().psnr_db;
        let [before, after] = [&maps.before, &maps.after].map(psnr);
        eprintln!("frame {frame}: {before:.2} dB before, {after:.2} dB after");
        assert!(after > before, "{before} {after}");
    }
}

#[test]
fn beads_judge_the_optics_beside_unknown_scenes() {
    let closing = with(Holds::BeadsAndUnknown, "array_shift", &[("row_px", 0.3)], 805);
    assert_eq!((closing.judged_on, names(&closing)), (JudgedOn::Known, vec!["array_shift"]));
    assert!(closing.held_out_frames.len() == 24 && closing.after.chi2_ndf < closing.before.chi2_ndf);
    assert!(!is_limited(&closing, "motion_blur") || is_limited(&closing, "lens_decentre"));
}

/// Darker edges of the sensor change the light of each bead's frame, which is fitted behind them. Then no more is left
/// than where nothing is wrong.
#[test]
fn a_strong_vignetting_is_named_on_beads_and_nothing_on_beads_is_nothing() {
    let closing = with(Holds::BeadsAndUnknown, "vignetting", &[("v", 0.5)], 807);
    assert_eq!((closing.verdict, names(&closing)), (Verdict::Adequate, vec!["vignetting"]));
    let v = &closing.effects[0].params[0];
    assert!((v.value - 0.5).abs() < 0.02, "{v:?}");
    let folder = tempfile::tempdir().unwrap();
    let empty = closed(&measured(Holds::BeadsAndUnknown, &[], &folder.path().join("session"), 808));
    assert_eq!((empty.verdict, empty.effects.len()), (Verdict::Adequate, 0));
    assert!((closing.after.chi2_ndf - empty.after.chi2_ndf).abs() < 0.02, "{:?} {:?}", closing.after, empty.after);
}

#[test]
fn a_poor_calibration_is_replaced_beside_bright_unknown_scenes() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    measured(Holds::BeadsAndUnknown, &[], &at("session"), 806);
    subject().poor.write(&at("poor.instrument"), Provenance::new("test", 1, &())).unwrap();
    let request = CloseRequest {
        session: &at("session"),
        instrument: &at("poor.instrument"),
        output: &at("closed.instrument"),
        calibration: CalibrateConfig { rank: Some(8), ..CalibrateConfig::default() },
        plan: false,
        fine_tuning: None,
        seed: 1,
    };
    let outcome = close_session(&request, &mut |p| {
        if let Progress::Step(name) = p {
            eprintln!("{name}");
        }
    });
    let closing = outcome.unwrap().closed.account.closing;
    eprintln!("{:?} {:?}", closing.effects, closing.notes);
    assert_eq!(names(&closing), ["rank_truncation"]);
    assert!(closing.after.nrmse < 0.9 * closing.before.nrmse);
    // The session has no darks and flats: what is known of the sensor stays.
    let (old, new) = (&subject().poor, Instrument::read(&at("closed.instrument")).unwrap());
    assert_eq!(new.noise.gain_dn_per_e, old.noise.gain_dn_per_e);
    assert!(new.response == old.response && new.offset_dn == old.offset_dn && old.offset_dn.is_some());
}
