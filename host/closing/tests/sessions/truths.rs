//! Sessions whose truths have a unit of their own, or are less sharp than the specimens.

use super::{accounted, closed, measured, names, subject};
use ndarray::{Array3, Axis};
use ommatidia_closing::study::sessions::Holds;
use ommatidia_closing::{Budget, CloseOptions, Observations, Verdict, close};
use ommatidia_physics::effects::EffectSetting;
use ommatidia_session::{Session, stack};
use std::path::Path;

#[test]
fn truths_may_have_any_unit_of_light() {
    let folder = tempfile::tempdir().unwrap();
    let dir = folder.path().join("session");
    let session = measured(Holds::Whole, &[], &dir, 62);
    let before = closed(&session);
    let file = dir.join("scene_truth.npy");
    let truths = stack::read(&file).unwrap();
    for unit in [300.0, 1.0 / 300.0] {
        stack::write(&file, (&truths * unit as f32).view()).unwrap();
        let after = closed(&session);
        assert!(after.effects.is_empty());
        assert!((after.before.chi2_ndf - before.before.chi2_ndf).abs() < 1e-3, "{unit}: {:?}", after.before);
    }
}

/// Blurs pictures along an axis by a Gaussian of variance `var_px2`, dark outside.
fn blurred(pictures: &Array3<f32>, axis: usize, var_px2: f64) -> Array3<f32> {
    let mut out = Array3::zeros(pictures.dim());
    let n = pictures.len_of(Axis(axis)) as isize;
    let sum: f64 = (-12..=12).map(|d: i32| (-f64::from(d * d) / (2.0 * var_px2)).exp()).sum();
    for i in 0..n {
        for j in (i - 12).max(0)..(i + 13).min(n) {
            let weight = (-((i - j) as f64).powi(2) / (2.0 * var_px2)).exp() / sum;
            let from = pictures.index_axis(Axis(axis), j as usize);
            out.index_axis_mut(Axis(axis), i as usize).scaled_add(weight as f32, &from);
        }
    }
    out
}

/// A session whose truths are blurred by a variance.
fn of_blurred_truths(dir: &Path, effects: &[EffectSetting], var_px2: f64) -> Session {
    let session = measured(Holds::Whole, effects, dir, 63);
    let file = dir.join("scene_truth.npy");
    let truths = stack::read(&file).unwrap();
    stack::write(&file, blurred(&blurred(&truths, 1, var_px2), 2, var_px2).view()).unwrap();
    session
}

#[test]
fn blurred_truths_are_named_and_no_instrument_gets_their_blur() {
    let folder = tempfile::tempdir().unwrap();
    let session = of_blurred_truths(&folder.path().join("little"), &[], 0.2);
    let little = closed(&session);
    assert_eq!(names(&little), ["truth_blur"]);
    let found = &little.effects[0];
    assert!(!found.added && little.notes.iter().any(|n| n.contains("the truths are blurred")), "{:?}", little.notes);
    // What a Gaussian that is sampled on pixels does to the details of a specimen is no Gaussian.
    assert!((0.12..0.25).contains(&found.params[0].value), "{found:?}");
    let mut seen = Observations::read(&session, &Budget::default()).unwrap();
    let options = CloseOptions { seed: 1, ..CloseOptions::default() };
    let instrument = close(&subject().instrument, &mut seen, &options, |_| ()).unwrap().instrument;
    assert!(instrument.effects.iter().all(|e| e.id != "truth_blur"));
    // Of much blur so much is left that the search ends, and claims nothing of the optics.
    let much = accounted(&of_blurred_truths(&folder.path().join("much"), &[], 1.0)).closing;
    assert_eq!((names(&much), much.nearest.len()), (vec!["truth_blur"], 0));
    assert!(much.verdict != Verdict::Adequate);
}

#[test]
fn what_makes_frames_sharper_or_softer_is_no_blur_of_truths() {
    let folder = tempfile::tempdir().unwrap();
    let with = |name: &str, id: &str, param: &str, value: f64| {
        let effect = EffectSetting::new(id, &[(param, value)]);
        let found = closed(&measured(Holds::Whole, &[effect], &folder.path().join(name), 64));
        names(&found).iter().map(ToString::to_string).collect::<Vec<_>>()
    };
    assert_eq!(with("shorter", "spectral_shift", "change", -0.05), ["spectral_shift"]);
    assert_eq!(with("spread", "charge_diffusion", "sigma_px", 0.4), ["charge_diffusion"]);
}
