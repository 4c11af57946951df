#![allow(clippy::unwrap_used)]

use super::*;
use crate::methods::{Reconstruct, RichardsonLucy, RichardsonLucyConfig};
use ndarray::{Array2, ArrayView2};
use ommatidia_model::instrument::Instrument;
use ommatidia_model::testing::square_array;
use ommatidia_physics::effects::EffectSetting;
use ommatidia_session::artifact::{Provenance, file_hash};

/// Nine lenses, each of which blurs a little; two replicates of the calibration that are a little different.
fn instrument() -> Instrument {
    let mut instrument = square_array(3, [60, 60], [20, 20]);
    for lens in 0..9 {
        for (i, v) in [0.05f32, 0.1, 0.05, 0.1, 0.4, 0.1, 0.05, 0.1, 0.05].into_iter().enumerate() {
            instrument.psf.basis[[lens, 0, i / 3, i % 3]] = v;
        }
    }
    let changed = |factor: f32| {
        let mut psf = instrument.psf.clone();
        psf.basis.slice_mut(ndarray::s![.., .., 1, 1]).mapv_inplace(|v| factor * v);
        psf
    };
    let replicates = vec![changed(0.99), changed(1.01)];
    Instrument { replicates, ..instrument }
}

fn method(instrument: &Instrument) -> RichardsonLucy {
    RichardsonLucyConfig { iterations: 6 }.build(instrument).unwrap()
}

fn settings() -> CalibrateWidths {
    CalibrateWidths { count: 280, neighbours: 30, ..CalibrateWidths::default() }
}

fn widths(instrument: &Instrument, method: &dyn Reconstruct) -> Widths {
    let scenes = VirtualConfig::default().build(instrument, &[]).unwrap();
    let hashes = ["method".to_string(), "instrument".to_string()];
    settings().run(method, instrument, &scenes, hashes, 1, |_| ()).unwrap()
}

fn coverage(ready: &Ready, method: &dyn Reconstruct, instrument: &Instrument) -> CoverageTotals {
    let config = VirtualConfig { peak_e: Some(ready.widths().made.peak_e), ..VirtualConfig::default() };
    let scenes = config.build(instrument, &[]).unwrap();
    let mut coverage = Coverage::new(ready);
    coverage.add_virtual(ready, method, &scenes, 77, 140, || ()).unwrap();
    coverage.totals()
}

#[test]
fn other_scenes_of_a_known_instrument_are_covered_and_one_that_changed_is_named() {
    let instrument = instrument();
    let method = method(&instrument);
    let ready = widths(&instrument, &method).on(&instrument).unwrap();
    let known = coverage(&ready, &method, &instrument);
    // 140 scenes whose shares scatter by some 0.06: three standard errors are 0.015, and the calibration scatters, too.
    assert!((known.coverage - 0.9).abs() < 0.03, "{known:?}");
    assert!((known.lit - 0.9).abs() < 0.06, "{known:?}");
    assert!(known.inconsistent < 0.06, "{known:?}");
    // One third of the sensor sees three times the light: the views disagree, and no object explains all of them.
    let bright = VirtualConfig { peak_e: Some([2000.0, 2500.0]), ..VirtualConfig::default() };
    let frame_dn = bright.build(&instrument, &[]).unwrap().frame(5, "test", 6).unwrap().frame_dn;
    let spoilt = Array2::from_shape_fn(frame_dn.dim(), |at| {
        let light = frame_dn[at] - 64.0;
        64.0 + if at.1 < 20 { 3.0 * light } else { light }
    });
    let [sound, changed] = [&frame_dn, &spoilt].map(|frame| {
        let found = method.reconstruct(frame.view()).unwrap();
        let made = ready.intervals(frame.view(), &found).unwrap();
        let width = made.upper.iter().zip(&made.lower).map(|(high, low)| high - low).sum::<f32>() / found.sum();
        (made.suspicion, width)
    });
    assert!(!sound.0.inconsistent && changed.0.inconsistent, "{:?} {:?}", sound.0, changed.0);
    assert!(changed.0.misfit > 1.5 && changed.1 > sound.1, "{sound:?} {changed:?}");
}

#[test]
fn intervals_hold_their_reconstruction_and_follow_its_unit() {
    let instrument = instrument();
    let method = method(&instrument);
    let ready = widths(&instrument, &method).on(&instrument).unwrap();
    let scenes = VirtualConfig::default().build(&instrument, &[]).unwrap();
    let VirtualFrame { frame_dn, .. } = scenes.frame(5, "test", 3).unwrap();
    let found = method.reconstruct(frame_dn.view()).unwrap();
    let here = ready.intervals(frame_dn.view(), &found).unwrap();
    for ((low, high), x) in here.lower.iter().zip(&here.upper).zip(&found) {
        assert!(*low >= 0.0 && *low <= x * 1.000_01 && *high >= x * 0.999_99, "{low} {x} {high}");
    }
    let thousand = ready.intervals(frame_dn.view(), &found.mapv(|v| 1000.0 * v)).unwrap();
    assert!((thousand.light * 1000.0 / here.light - 1.0).abs() < 1e-3);
    let sum = |a: &Array2<f32>| a.iter().map(|v| f64::from(*v)).sum::<f64>();
    assert!((sum(&thousand.upper) / sum(&here.upper) / 1000.0 - 1.0).abs() < 0.01);
    // A frame without light has finite intervals, too.
    let dark = Array2::from_elem((60, 60), 64.0f32);
    let of_dark = ready.intervals(dark.view(), &Array2::zeros((20, 20))).unwrap();
    assert!(of_dark.lower.iter().chain(&of_dark.upper).all(|v| v.is_finite() && *v >= 0.0));
    let wrong = ready.intervals(dark.view(), &Array2::zeros((20, 21))).unwrap_err();
    assert!(wrong.to_string().contains("20 x 20"), "{wrong}");
}

#[test]
fn the_same_seed_gives_the_same_bytes_and_they_come_back() {
    let folder = tempfile::tempdir().unwrap();
    let instrument = instrument();
    let method = method(&instrument);
    let [first, second] = ["a", "b"].map(|n| folder.path().join(n));
    let made = widths(&instrument, &method);
    made.write(&first, Provenance::default()).unwrap();
    // Another number of threads, the same result.
    let pool = rayon::ThreadPoolBuilder::new().num_threads(1).build().unwrap();
    pool.install(|| widths(&instrument, &method)).write(&second, Provenance::default()).unwrap();
    assert_eq!(std::fs::read(&first).unwrap(), std::fs::read(&second).unwrap());
    let read = Widths::read(&first).unwrap();
    assert_eq!(read.made, made.made);
    assert_eq!(read.histograms, made.histograms);
    let ready = [made, read].map(|w| w.on(&instrument).unwrap());
    let frame = Array2::from_shape_fn((60, 60), |(r, c)| 64.0 + ((r * 7 + c) % 90) as f32);
    let found = method.reconstruct(frame.view()).unwrap();
    let [a, b] = ready.each_ref().map(|r| r.intervals(frame.view(), &found).unwrap());
    assert!(a.upper.iter().zip(&b.upper).all(|(a, b)| (a - b).abs() <= 1e-4 * a));
}

#[test]
fn widths_of_another_file_or_method_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let [path, with, other] = ["w", "network", "instrument"].map(|n| folder.path().join(n));
    std::fs::write(&with, "stands for a network").unwrap();
    std::fs::write(&other, "stands for an instrument").unwrap();
    let instrument = instrument();
    let mut widths = widths(&instrument, &method(&instrument));
    (widths.made.method_file, widths.made.instrument) = (file_hash(&with).unwrap(), file_hash(&other).unwrap());
    widths.check(&path, "richardson-lucy", &with, &other).unwrap();
    let says = |method, with, instrument, words: &str| {
        let error = widths.check(&path, method, with, instrument).unwrap_err().to_string();
        assert!(error.contains(words), "{error}");
    };
    says("wiener", &with, &other, "calibrated for the method `richardson-lucy`");
    says("richardson-lucy", &other, &other, "another method file");
    says("richardson-lucy", &with, &with, "another instrument");
    widths.write(&path, Provenance::default()).unwrap();
    let bytes = std::fs::read(&path).unwrap();
    std::fs::write(&path, &bytes[..bytes.len() - 4]).unwrap();
    assert!(Widths::read(&path).is_err());
    assert!(widths.on(&square_array(3, [60, 60], [20, 22])).is_err());
}

#[test]
fn settings_out_of_range_are_refused() {
    let instrument = instrument();
    let method = method(&instrument);
    let scenes = VirtualConfig::default().build(&instrument, &[]).unwrap();
    for (change, field) in [
        (CalibrateWidths { count: 10, ..settings() }, "count"),
        (CalibrateWidths { coverage: 1.0, ..settings() }, "coverage"),
        (CalibrateWidths { neighbours: 200, ..settings() }, "neighbours"),
    ] {
        let hashes = [String::new(), String::new()];
        let error = change.run(&method, &instrument, &scenes, hashes, 1, |_| ()).unwrap_err().to_string();
        assert!(error.contains(field), "{error}");
    }
    let light = VirtualConfig { peak_e: Some([9.0, 3.0]), ..VirtualConfig::default() };
    assert!(light.build(&instrument, &[]).unwrap_err().to_string().contains("peak_e"));
    let none = VirtualConfig { specimens: Vec::new(), ..VirtualConfig::default() };
    assert!(none.build(&instrument, &[]).is_err());
}

#[test]
fn errors_of_effects_and_of_the_calibration_are_drawn() {
    let mut known = instrument();
    known.effects.push(EffectSetting::new("veiling_glare", &[("beta", 0.05)]));
    let frame = |instrument: &Instrument, errors: &[EffectError]| {
        VirtualConfig::default().build(instrument, errors).unwrap().frame(3, "test", 1).unwrap().frame_dn
    };
    let error = EffectError { id: "veiling_glare".into(), name: "beta".into(), sigma: 0.02 };
    assert_ne!(frame(&known, &[error]), frame(&known, &[]));
    let exact = Instrument { replicates: Vec::new(), ..known.clone() };
    assert_ne!(frame(&exact, &[]), frame(&known, &[]));
    assert_eq!(frame(&known, &[]), frame(&known, &[]));
}

/// A method whose errors are Gaussian, independent and as large as the features say.
struct Gaussian {
    object: Array2<f32>,
}

impl Reconstruct for Gaussian {
    fn name(&self) -> &str {
        "gaussian"
    }

    fn reconstruct(&self, frame_dn: ArrayView2<'_, f32>) -> anyhow::Result<Array2<f32>> {
        use rand_distr::{Distribution, StandardNormal};
        // The frame seeds the noise: each frame has its own.
        let seed = frame_dn.iter().map(|v| f64::from(*v)).sum::<f64>() as u64;
        let mut rng = ommatidia_session::rng::stream(seed, "gaussian", 0);
        Ok(self.object.mapv(|x| {
            let z: f32 = StandardNormal.sample(&mut rng);
            (x + 0.05 * x * z).max(0.0)
        }))
    }
}

#[test]
fn gaussian_errors_are_covered_within_the_scatter_of_counts() {
    let instrument = instrument();
    let object = Array2::from_shape_fn((20, 20), |(r, c)| 400.0 + 20.0 * ((r * 5 + c * 3) % 17) as f32);
    let forward = ommatidia_model::forward::Forward::new(&instrument).unwrap();
    let expected = forward.expected_e(object.view(), &forward.context()).unwrap();
    let frame =
        |i: u64| forward.draw_dn(expected.clone(), &forward.context(), &mut ommatidia_session::rng::stream(i, "f", 0));
    let method = Gaussian { object: object.clone() };
    let observer = observer::Observer::new(&instrument).unwrap();
    let judged = |i: u64| calibrate::Judged::of(&observer, &method, 0, &frame(i), &object).unwrap();
    // One scale for all: scores are errors.
    let ones = scale::Scale { ranges: [[0.0, 1.0, -1.0, 1.0]; observer::PIXEL], coefficients: [0.0; scale::TERMS] };
    let mut sum = vec![0.0f64; scores::BINS];
    let mut add = |i: u64| {
        for chunk in calibrate::histogram(&ones, &judged(i)).chunks(scores::BINS) {
            sum.iter_mut().zip(chunk).for_each(|(s, n)| *s += f64::from(*n));
        }
    };
    (0..40).for_each(&mut add);
    let limits = scores::Limits::of(&sum, 0.1);
    let errors: Vec<f32> = (40..80).flat_map(|i| judged(i).errors).collect();
    let inside = errors.iter().filter(|e| limits.low <= f64::from(**e) && f64::from(**e) <= limits.high).count();
    // 16,000 independent errors, learned and judged: four times sqrt(2 * 0.09 / 16,000).
    assert!((inside as f64 / errors.len() as f64 - 0.9).abs() < 0.0135, "{inside} {limits:?}");
}
