//! Truths that lie beside the objects: the session states how well they are placed, and the loop fits their places.

use super::{closed, measured, names, with_lines};
use ommatidia_closing::study::sessions::Holds;
use ommatidia_closing::{Closing, TruthRegistration};
use ommatidia_physics::effects::EffectSetting;
use ommatidia_session::Session;

/// The statement of the sessions here: about what their truths are off by.
const STATED: &str = "truth_registration_px = 0.5";

/// Shift along rows and columns (object pixels), turn (mrad) and scale that a kind of session puts in.
fn put_in(holds: Holds) -> [f64; 4] {
    match holds {
        Holds::TruthShifted => [-0.18, 0.24, 0.0, 0.0],
        Holds::TruthTurned => [0.0, 0.0, -1e3 * 0.4f64.to_radians(), 0.0],
        Holds::TruthScaled => [0.0, 0.0, 0.0, 1.0 / 1.01 - 1.0],
        _ => [0.0; 4],
    }
}

/// A session of a kind with effects, closed; its manifest states the registration.
fn stated(holds: Holds, effects: &[EffectSetting], seed: u64) -> Closing {
    let folder = tempfile::tempdir().unwrap();
    let dir = folder.path().join("session");
    eprintln!("--- {holds:?} with {effects:?}");
    measured(holds, effects, &dir, seed);
    closed(&with_lines(&dir, STATED))
}

/// Each value lies within three of its errors of the truth.
fn assert_found(registration: &TruthRegistration, truth: [f64; 4]) {
    for (v, truth) in registration.params.iter().zip(truth) {
        assert!(v.sigma > 0.0 && (v.value - truth).abs() < 3.0 * v.sigma, "{v:?} for {truth}");
    }
}

/// Shifted truths have a test of their own below, beside an effect that they hide.
#[test]
fn misplaced_truths_are_placed_and_no_effect_of_the_optics_is_named() {
    for (holds, seed) in [(Holds::TruthTurned, 701), (Holds::TruthScaled, 702)] {
        let closing = stated(holds, &[], seed);
        assert_eq!(names(&closing), Vec::<&str>::new(), "{holds:?}");
        let [registration] = closing.registrations.as_slice() else { panic!("{:?}", closing.registrations) };
        assert_found(registration, put_in(holds));
        assert!(registration.stated_px == 0.5 && registration.frame.is_none());
    }
}

/// The session takes its truths for exact. They were interpolated when they were misplaced, and one of them lost light
/// at its border: that is no wrong exposure, and the blur is no change of the waves.
#[test]
fn light_at_the_border_of_a_misplaced_truth_is_no_wrong_exposure() {
    let folder = tempfile::tempdir().unwrap();
    let dir = folder.path().join("session");
    measured(Holds::TruthScaled, &[], &dir, 762);
    let closing = closed(&Session::open(&dir).unwrap());
    let displaces = |id: &&str| ["array_shift", "stage_scale", "magnification", "sensor_rotation"].contains(id);
    assert!(names(&closing).iter().all(displaces), "{:?}", names(&closing));
    assert!(closing.notes.iter().any(|note| note.contains("sharper than their truths predict")));
    assert!(closing.nearest.iter().all(|n| n.id != "spectral_shift" && n.id != "defocus"), "{:?}", closing.nearest);
}

#[test]
fn a_shifted_array_beside_misplaced_truths_is_not_testable() {
    let shift = EffectSetting::new("array_shift", &[("row_px", 0.25)]);
    let closing = stated(Holds::TruthShifted, &[shift], 710);
    assert_eq!(names(&closing), Vec::<&str>::new());
    for id in ["array_shift", "stage_scale"] {
        let lost = closing.rejected.iter().find(|r| r.id == id).unwrap();
        assert!(lost.upper_limit.is_none() && lost.needs.as_ref().unwrap().contains("misplaced truth"), "{lost:?}");
    }
    // Others lose a part of their information only.
    for id in ["magnification", "sensor_rotation", "lens_decentre", "radial_distortion"] {
        let kept = closing.rejected.iter().find(|r| r.id == id).unwrap();
        assert!(kept.upper_limit.is_some(), "{kept:?}");
    }
    // The shift counts as registration.
    let row = &closing.registrations[0].params[0];
    assert!((row.value - (0.25 - 0.18)).abs() < 0.02, "{row:?}");
}

/// What moves the sources of the virtual instrument as `d(x)` does. The truths stay sharp, and whole at their edges.
fn moved() -> [(EffectSetting, [f64; 4]); 3] {
    [
        (EffectSetting::new("array_shift", &[("row_px", -0.18), ("col_px", 0.24)]), [-0.18, 0.24, 0.0, 0.0]),
        (EffectSetting::new("stage_scale", &[("row_by_col", 0.007), ("col_by_row", -0.007)]), [0.0, 0.0, 7.0, 0.0]),
        (EffectSetting::new("stage_scale", &[("row_by_row", -0.01), ("col_by_col", -0.01)]), [0.0, 0.0, 0.0, -0.01]),
    ]
}

#[test]
fn other_effects_are_found_beside_truths_that_lie_elsewhere() {
    for ((id, param, value), (moved, truth)) in
        [("vignetting", "v", 0.05), ("interpixel_capacitance", "alpha", 0.01), ("halo", "weight", 0.005)]
            .into_iter()
            .zip(moved())
    {
        let closing = stated(Holds::Whole, &[moved, EffectSetting::new(id, &[(param, value)])], 720);
        assert_eq!(names(&closing), [id]);
        let found = &closing.effects[0].params[0];
        assert!((found.value - value).abs() < 0.1 * value, "{found:?}");
        assert_found(&closing.registrations[0], truth);
    }
}

#[test]
fn truths_that_were_placed_one_by_one_are_placed_one_by_one() {
    // Each truth lies elsewhere: the specimen moves from frame to frame.
    let folder = tempfile::tempdir().unwrap();
    let dir = folder.path().join("session");
    let drift = EffectSetting::new("thermal_drift", &[("row_px_per_s", 2.0)]);
    measured(Holds::Whole, &[drift], &dir, 750);
    let closing = closed(&with_lines(&dir, &format!("{STATED}\ntruth_registration_per_frame = true")));
    assert_eq!(names(&closing), Vec::<&str>::new());
    assert!(closing.held_out_frames.is_empty() && closing.registrations.len() == 8);
    for r in &closing.registrations {
        let expected = 2.0 * 0.02 * r.frame.unwrap() as f64;
        assert!((r.params[0].value - expected).abs() < 0.01 + 3.0 * r.params[0].sigma, "{r:?} for {expected}");
    }
    let drift = closing.rejected.iter().find(|r| r.id == "thermal_drift").unwrap();
    assert!(drift.upper_limit.is_none(), "{drift:?}");
}

#[test]
fn a_displacement_that_a_misplaced_truth_may_be_has_a_note() {
    let folder = tempfile::tempdir().unwrap();
    let closing = closed(&measured(Holds::TruthShifted, &[], &folder.path().join("session"), 730));
    assert!(closing.registrations.is_empty());
    // Truths that were displaced by interpolation are also less sharp, which may be named, so that no other name need
    // be earned, and a drift of wavefronts, which displaces and blurs, may resemble it best.
    assert!(names(&closing).iter().all(|id| ["array_shift", "truth_blur"].contains(id)), "{:?}", names(&closing));
    let displaced = |n: &String| ["array_shift", "unknown_warp", "wavefront_drift"].iter().any(|id| n.starts_with(id));
    let note = |n: &String| displaced(n) && n.contains("truth_registration_px");
    assert!(closing.notes.iter().any(note), "{:?}", closing.notes);
}
