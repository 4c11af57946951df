//! Sessions whose lamp is uneven or flickers, whose response is uneven, or whose light one record has wrong.

use super::{closed, measured, names, subject};
use ommatidia_closing::study::sessions::Holds;
use ommatidia_closing::{Closing, FaultKind, Verdict};
use ommatidia_physics::effects::EffectSetting;
use ommatidia_session::{Session, rng, stack};
use rand_distr::{Distribution, StandardNormal};
use std::path::Path;

/// Dims the flats of a session: their light falls off by 8 % towards the corners, and by 3 % along the columns. Photons
/// are lost at random, so that what is left has the noise of its light.
fn dim_flats(session: &Path) {
    let noise = &subject().instrument.noise;
    let (gain, black) = (noise.gain_dn_per_e, noise.black_level_dn);
    let file = session.join("flat.npy");
    let mut frames = stack::read(&file).unwrap();
    let (_, rows, cols) = frames.dim();
    for (n, mut frame) in frames.outer_iter_mut().enumerate() {
        let mut rng = rng::stream(5, "lamp", n as u64);
        for ((r, c), v) in frame.indexed_iter_mut() {
            let (y, x) = (2.0 * r as f64 / (rows as f64 - 1.0) - 1.0, 2.0 * c as f64 / (cols as f64 - 1.0) - 1.0);
            let share = 1.0 - 0.04 * (y * y + x * x) - 0.015 * (1.0 + x);
            let light_e = (f64::from(*v) - black) / gain;
            let normal: f64 = StandardNormal.sample(&mut rng);
            let left_e = share * light_e + (light_e.max(0.0) * share * (1.0 - share)).sqrt() * normal;
            *v = (black + gain * left_e) as f32;
        }
    }
    stack::write(&file, frames.view()).unwrap();
}

#[test]
fn an_uneven_lamp_is_no_vignetting_and_hides_no_effect() {
    let folder = tempfile::tempdir().unwrap();
    let with = |name: &str, effects: &[EffectSetting]| {
        let dir = folder.path().join(name);
        measured(Holds::Whole, effects, &dir, 61);
        dim_flats(&dir);
        closed(&Session::open(&dir).unwrap())
    };
    let nothing = with("nothing", &[]);
    assert!(nothing.effects.is_empty() && nothing.nearest.is_empty());
    let moved = with("moved", &[EffectSetting::new("array_shift", &[("row_px", 0.05)])]);
    assert_eq!(names(&moved), ["array_shift"]);
    // Scenes show what flats do not any more.
    let shaded = with("shaded", &[EffectSetting::new("vignetting", &[("v", 0.05)])]);
    assert_eq!(names(&shaded), ["vignetting"]);
    let v = &shaded.effects[0].params[0];
    assert!((v.value - 0.05).abs() < 5.0 * v.sigma, "{v:?}");
}

/// Response that rises by a share of 6 % from the first to the last column, in scenes and flats.
fn tilt_response(session: &Path) {
    let black = subject().instrument.noise.black_level_dn as f32;
    for file in ["scene.npy", "flat.npy"].map(|name| session.join(name)) {
        let mut frames = stack::read(&file).unwrap();
        let columns = frames.dim().2 as f32;
        for ((_, _, c), v) in frames.indexed_iter_mut() {
            *v = black + (1.0 + 0.06 * (c as f32 / (columns - 1.0) - 0.5)) * (*v - black);
        }
        stack::write(&file, frames.view()).unwrap();
    }
}

/// Gains of the lenses follow such a response in steps, with more values. A gain of one lens is no gradient.
#[test]
fn a_response_that_rises_over_the_sensor_is_no_gain_of_lenses() {
    let folder = tempfile::tempdir().unwrap();
    let dir = folder.path().join("tilted");
    measured(Holds::Whole, &[], &dir, 64);
    tilt_response(&dir);
    let closing = closed(&Session::open(&dir).unwrap());
    assert!(closing.effects.iter().all(|e| !e.known), "{:?}", names(&closing));
    let [gradient] = closing.effects.as_slice() else { panic!("{:?}", names(&closing)) };
    let by_col = gradient.params.iter().find(|p| p.name == "by_col").unwrap();
    assert!((by_col.value - 0.03).abs() < 5.0 * by_col.sigma && by_col.sigma < 0.003, "{by_col:?}");
    let gain = EffectSetting::new("lens_gain", &[("change_2", 0.03)]);
    let dir = folder.path().join("gain");
    measured(Holds::Whole, &[gain], &dir, 64);
    assert_eq!(names(&closed(&Session::open(&dir).unwrap())), ["lens_gain"]);
}

/// Errors of the calibration could leave as much in all frames together: they do not change the light of one frame.
/// Under a strong effect the light of all frames scatters.
#[test]
fn an_exposure_that_is_a_tenth_too_long_is_found_also_beside_a_strong_effect() {
    let folder = tempfile::tempdir().unwrap();
    let moved = EffectSetting::new("array_shift", &[("row_px", 0.8)]);
    for (frame, beside) in [(2.0, None), (5.0, Some(moved))] {
        let dir = folder.path().join(format!("{frame}"));
        let wrong = EffectSetting::new("metadata_fault", &[("exposure_factor", 1.1), ("frame", frame)]);
        let all: Vec<_> = beside.iter().cloned().chain([wrong]).collect();
        measured(Holds::Whole, &all, &dir, 65);
        let closing = closed(&Session::open(&dir).unwrap());
        let [fault] = closing.faults.as_slice() else { panic!("{:?}", closing.faults) };
        let FaultKind::Exposure { factor } = fault.kind else { panic!("{fault:?}") };
        assert!(fault.frame == frame as usize && (factor - 1.1).abs() < 0.01, "{fault:?}");
        let mut named = names(&closing);
        named.sort_unstable();
        assert_eq!(named, beside.iter().map(|e| e.id.as_str()).chain(["metadata_fault"]).collect::<Vec<_>>());
    }
}

/// Changes the light of each scene of a session by a factor of its own, 0.95 to 1.05.
fn flicker(session: &Path) {
    const FACTORS: [f32; 8] = [0.97, 1.03, 1.05, 0.96, 1.01, 1.04, 0.95, 0.98];
    let black = subject().instrument.noise.black_level_dn as f32;
    let file = session.join("scene.npy");
    let mut frames = stack::read(&file).unwrap();
    for (mut frame, factor) in frames.outer_iter_mut().zip(FACTORS) {
        frame.mapv_inplace(|v| black + factor * (v - black));
    }
    stack::write(&file, frames.view()).unwrap();
}

#[test]
fn a_lamp_that_flickers_is_no_effect_and_hides_none() {
    let folder = tempfile::tempdir().unwrap();
    let with = |name: &str, effects: &[EffectSetting], seed: u64| {
        let dir = folder.path().join(name);
        measured(Holds::Whole, effects, &dir, seed);
        flicker(&dir);
        closed(&Session::open(&dir).unwrap())
    };
    let units = |closing: &Closing| {
        closing.faults.iter().filter(|f| matches!(f.kind, FaultKind::Unit { .. })).map(|f| f.frame).collect::<Vec<_>>()
    };
    let nothing = with("nothing", &[], 62);
    assert_eq!((units(&nothing), names(&nothing)), ((0..8).collect(), vec!["metadata_fault"; 8]));
    assert!(nothing.verdict == Verdict::Adequate && nothing.after.chi2_ndf < 1.1, "{:?}", nothing.after);
    // Factors are relative to the median scene, and so is their evidence.
    let is_median = |f: &&FaultKind| matches!(f, FaultKind::Unit { factor } if *factor == 1.0);
    assert_eq!(nothing.faults.iter().map(|f| &f.kind).filter(is_median).count(), 1);
    assert!(nothing.faults.iter().all(|f| (f.z > 5.0) == (f.kind != FaultKind::Unit { factor: 1.0 })));
    assert!(nothing.notes.iter().any(|n| n.contains("illumination")), "{:?}", nothing.notes);
    let moved = with("moved", &[EffectSetting::new("array_shift", &[("row_px", 0.05)])], 63);
    assert_eq!(units(&moved).len(), 8);
    assert!(names(&moved).iter().all(|id| ["metadata_fault", "array_shift"].contains(id)), "{:?}", names(&moved));
    assert!(names(&moved).contains(&"array_shift"));
}

#[test]
fn a_lamp_that_flickers_beside_a_stronger_effect_is_corrected_too() {
    let folder = tempfile::tempdir().unwrap();
    measured(Holds::Whole, &[EffectSetting::new("array_shift", &[("row_px", 0.8)])], folder.path(), 64);
    flicker(folder.path());
    let closing = closed(&Session::open(folder.path()).unwrap());
    let named = names(&closing);
    assert!(named.contains(&"array_shift") && named.contains(&"metadata_fault"), "{named:?}");
    assert!(named.iter().all(|id| ["metadata_fault", "array_shift"].contains(id)), "{named:?}");
    assert!(closing.verdict == Verdict::Adequate && closing.after.chi2_ndf < 1.1, "{:?}", closing.after);
}
