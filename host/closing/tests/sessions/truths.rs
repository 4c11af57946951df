//! Sessions whose truths have a unit of their own, or are less sharp than the specimens.

use super::{accounted, closed, measured, names, subject};
use ndarray::{Array3, Axis};
use ommatidia_closing::FaultKind;
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
    assert!(much.notes.iter().any(|n| n.contains("contradict one another far less")), "{:?}", much.notes);
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

/// Pictures whose point at (row, col) from the centre lies at `size` times that, turned by `turn` rad (rows towards
/// columns) and displaced, by linear interpolation, dark outside; `displaced` gives the displacement of each, pixels.
fn moved(pictures: &Array3<f32>, size: f64, turn: f64, displaced: impl Fn(usize) -> [f64; 2]) -> Array3<f32> {
    let (_, rows, cols) = pictures.dim();
    let centre = [rows, cols].map(|n| (n as f64 - 1.0) / 2.0);
    Array3::from_shape_fn(pictures.dim(), |(k, r, c)| {
        let [y, x] = [r as f64 - centre[0] - displaced(k)[0], c as f64 - centre[1] - displaced(k)[1]];
        let at = [
            centre[0] + (turn.cos() * y - turn.sin() * x) / size,
            centre[1] + (turn.sin() * y + turn.cos() * x) / size,
        ];
        let near = |a: usize| {
            let part = at[a] - at[a].floor();
            [(at[a].floor(), 1.0 - part), (at[a].floor() + 1.0, part)]
        };
        let value = |r: f64, c: f64| {
            let inside = r >= 0.0 && c >= 0.0 && r < rows as f64 && c < cols as f64;
            if inside { pictures[[k, r as usize, c as usize]] } else { 0.0 }
        };
        let both = near(0).into_iter().flat_map(|r| near(1).map(|c| (r, c)));
        both.map(|((r, u), (c, v))| (u * v) as f32 * value(r, c)).sum()
    })
}

/// Truths that lie so far beside the objects that no effect describes it, without a word about it in the session: the
/// views of each frame agree with one another, so that the truths are wrong and nothing else is.
#[test]
fn truths_far_beside_the_objects_are_said_to_be_misplaced() {
    let folder = tempfile::tempdir().unwrap();
    let with = |name: &str, size: f64, turn: f64, displaced: &dyn Fn(usize) -> [f64; 2]| {
        let dir = folder.path().join(name);
        let session = measured(Holds::Whole, &[], &dir, 65);
        let file = dir.join("scene_truth.npy");
        let truths = stack::read(&file).unwrap();
        stack::write(&file, moved(&truths, size, turn, displaced).view()).unwrap();
        let found = closed(&session);
        let causes = found.effects.iter().filter(|e| e.known && e.id != "metadata_fault").count();
        assert_eq!(causes, 0, "{:?}", names(&found));
        assert!(found.registrations.is_empty() && found.estimated_frames.len() > 3);
        let [fault] = found.faults.as_slice() else { panic!("{:?}", found.faults) };
        assert!(fault.correlation_after > fault.correlation_before && fault.z > 5.0, "{fault:?}");
        fault.kind
    };
    let none = |_: usize| [0.0; 2];
    let FaultKind::Misplaced { scale, turn_mrad, .. } = with("large", 1.04, 0.0, &none) else { panic!("no scale") };
    assert!((scale - (1.0 / 1.04 - 1.0)).abs() < 0.004 && turn_mrad.abs() < 4.0, "{scale} {turn_mrad}");
    let FaultKind::Misplaced { scale, turn_mrad, .. } = with("turned", 1.0, 0.035, &none) else { panic!("no turn") };
    assert!(scale.abs() < 0.004 && (turn_mrad.abs() - 35.0).abs() < 4.0, "{scale} {turn_mrad}");
    let each = |k: usize| [0.8 * (k as f64 * 2.1).sin(), 0.8 * (k as f64 * 1.3).cos()];
    let FaultKind::MisplacedOneByOne { rms_px } = with("each", 1.0, 0.0, &each) else { panic!("not one by one") };
    assert!((0.6..1.0).contains(&rms_px), "{rms_px}");
}
