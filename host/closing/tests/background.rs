//! A background in bead frames and scenes, put in behind the back of the model: the calibration removes it, predictions
//! stay as good as without one, and the loop finds no effect in it.
#![allow(clippy::unwrap_used)]

use ndarray::Array3;
use ommatidia_bench::{ArrayConfig, BenchConfig, ScanConfig};
use ommatidia_closing::{Budget, CloseOptions, Observations, close};
use ommatidia_model::calibrate::{CalibrateConfig, Calibration, calibrate};
use ommatidia_model::forward::Forward;
use ommatidia_model::instrument::Instrument;
use ommatidia_session::{Role, Session, rng, stack};
use rand_distr::{Distribution, Poisson};
use std::path::Path;

/// Photo-electrons of stray light at a pixel, from its place in the frame (0 to 1 along rows and columns).
type Stray = fn(f64, f64) -> f64;

fn config() -> BenchConfig {
    let mut config = BenchConfig::default();
    (config.sensor.rows, config.sensor.cols) = (90, 124);
    // The stray light is put in behind the pixels.
    config.sensor.prnu_rms = 0.0;
    config.array = ArrayConfig { rows: 1, cols: 2, pitch_px: 50.0, ..config.array };
    (config.object.rows, config.object.cols) = (40, 40);
    config.scan = ScanConfig { rows: 9, cols: 9, ..config.scan };
    config.stacks.scene_frames = 8;
    config
}

/// Adds stray light to the frames of a stack: Poisson electrons times the gain. The frames were rounded to whole DN
/// before and stay singles, so that they are not rounded twice.
fn stray(session: &Path, role: &str, gain: f64, light: Stray, seed: u64) {
    let file = session.join(format!("{role}.npy"));
    let mut frames: Array3<f32> = stack::read(&file).unwrap();
    let (_, rows, cols) = frames.dim();
    for (n, mut frame) in frames.outer_iter_mut().enumerate() {
        let mut rng = rng::stream(seed, role, n as u64);
        for ((r, c), v) in frame.indexed_iter_mut() {
            let e = light(r as f64 / (rows - 1) as f64, c as f64 / (cols - 1) as f64);
            if e > 0.0 {
                *v += (gain * Poisson::new(e).unwrap().sample(&mut rng)) as f32;
            }
        }
    }
    stack::write(&file, frames.view()).unwrap();
}

fn copy(from: &Path, to: &Path) {
    std::fs::create_dir(to).unwrap();
    for entry in std::fs::read_dir(from).unwrap().map(Result::unwrap) {
        std::fs::copy(entry.path(), to.join(entry.file_name())).unwrap();
    }
}

/// NRMSE of the predicted light of the scenes' true objects against the light that the virtual instrument expects
/// without noise and background.
fn prediction_error(instrument: &Instrument, session: &Session, black_dn: f64) -> f64 {
    let forward = Forward::new(instrument).unwrap();
    let scene = session.need(Role::Scene).unwrap()[0];
    let (mut truths, mut expected) = (scene.truth().unwrap().unwrap(), scene.expected().unwrap().unwrap());
    let (mut misfit, mut light) = (0.0, 0.0);
    for n in 0..scene.len() {
        let got = forward.expected_e(truths.read(n).unwrap().view(), &forward.context()).unwrap();
        for (g, w) in got.iter().zip(&expected.read(n).unwrap()) {
            let want = f64::from(*w) - black_dn;
            misfit += (f64::from(*g) * instrument.noise.gain_dn_per_e - want).powi(2);
            light += want.powi(2);
        }
    }
    (misfit / light).sqrt()
}

struct Outcome {
    nrmse: f64,
    found: Vec<String>,
    notes: Vec<String>,
    calibration: Calibration,
}

/// Calibrates a session with stray light in `roles`, and closes the loop on the same session.
fn outcome(clean: &Path, light: Stray, roles: &[&str], seed: u64) -> Outcome {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("session");
    copy(clean, &path);
    let bench = config();
    roles.iter().for_each(|role| stray(&path, role, bench.sensor.gain_dn_per_e, light, seed));
    let session = Session::open(&path).unwrap();
    let calibration = calibrate(&session, &CalibrateConfig::default(), || {}).unwrap();
    let mut seen = Observations::read(&session, &Budget::default()).unwrap();
    let closed = close(&calibration.instrument, &mut seen, &CloseOptions::default(), |_| {}).unwrap();
    let closing = closed.account.closing;
    Outcome {
        nrmse: prediction_error(&calibration.instrument, &session, bench.sensor.black_level_dn),
        found: closing.effects.iter().map(|e| e.id.clone()).collect(),
        notes: closing.notes,
        calibration,
    }
}

/// Seeds that nothing was developed on: they were chosen before they were run once. Seeds 31, 32 and 101 to 116 served
/// to find out what the error depends on. (It was not the estimate of the background, which could be replaced by the
/// truth without a change, but coefficient maps that followed noise: see `psf::field`.)
const FRESH: [u64; 3] = [511, 512, 513];

/// Sessions without, with an even, a strong and a sloping background. Each seed is judged by itself: with a background
/// the prediction error is at most 5 % larger than without. The strong background adds five times the read noise's
/// variance to every pixel; there each error may grow by as much as the noise of the foci does, and their mean by 5 %.
#[test]
fn a_background_is_removed_and_no_effect_is_found_in_it() {
    let folder = tempfile::tempdir().unwrap();
    let clean = folder.path().join("clean");
    let cases: [(&str, Stray, [f64; 3]); 4] = [
        ("none", |_, _| 0.0, [0.0, 0.0, 0.0]),
        ("2 e-", |_, _| 2.0, [2.0, 0.0, 0.0]),
        ("20 e-", |_, _| 20.0, [20.0, 0.0, 0.0]),
        ("slope", |r, c| 6.0 + 4.0 * r - 8.0 * (c - 0.5), [8.0, 4.0, -8.0]),
    ];
    let (mut sums, mut too_large) = ([0.0; 4], Vec::new());
    for seed in FRESH {
        config().build(&[]).unwrap().measure(&clean, seed, |_| ()).unwrap();
        let (mut without, mut noise) = (f64::NAN, f64::NAN);
        for ((name, light, truth), sum) in cases.iter().zip(&mut sums) {
            let got = outcome(&clean, *light, &["bead", "scene"], seed + 1000);
            let quality = &got.calibration.instrument.quality;
            let b = quality.background.unwrap();
            let here = format!("seed {seed}, {name}: NRMSE {:.5}, {b:?}, found {:?}", got.nrmse, got.found);
            eprintln!("{here}");
            assert_eq!(b.is_seen(), *name != "none", "{here}");
            if *name == "none" {
                (without, noise) = (got.nrmse, quality.noise_floor);
            } else {
                let note = |n: &String| n.contains("the bead frames have a background of");
                assert!(got.calibration.notes.iter().any(note), "{:?}", got.calibration.notes);
                assert!(got.notes.iter().any(|n| n.starts_with("background of the scene frames")), "{:?}", got.notes);
            }
            for ((mean, sigma), want) in b.mean_e.iter().zip(&b.sigma_e).zip(truth) {
                assert!((mean - want).abs() < 4.0 * sigma + 0.02 * want.abs(), "{here}");
            }
            assert!(got.found.is_empty(), "{here}");
            let most = if *name == "20 e-" { quality.noise_floor / noise } else { 1.05 };
            if got.nrmse > most * without {
                too_large.push(format!("{here}: more than {most:.3} times {without:.5}"));
            }
            *sum += got.nrmse;
        }
    }
    assert!(too_large.is_empty(), "{too_large:#?}");
    assert!(sums.iter().all(|e| *e < 1.05 * sums[0]), "{sums:?}");
}

/// Scenes with a background that the beads did not have: it is named background, not glare.
#[test]
fn a_background_of_the_scenes_alone_is_named_background() {
    let folder = tempfile::tempdir().unwrap();
    let clean = folder.path().join("clean");
    config().build(&[]).unwrap().measure(&clean, 41, |_| ()).unwrap();
    let got = outcome(&clean, |_, _| 4.0, &["scene"], 1041);
    assert!(!got.calibration.instrument.quality.background.unwrap().is_seen());
    assert_eq!(got.found, ["background"]);
}
