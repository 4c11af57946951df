//! Sessions of the virtual instrument can be calibrated, from files and from computed frames alike.
#![allow(clippy::unwrap_used)]

use ommatidia_bench::{ArrayConfig, BenchConfig, ObjectConfig, ScanConfig};
use ommatidia_model::calibrate::{CalibrateConfig, calibrate};
use ommatidia_model::check::{Severity, check};
use ommatidia_physics::effects::EffectSetting;
use ommatidia_session::{Role, Session};
use std::path::Path;
use std::sync::Arc;

/// Two lenses before a small sensor; quick to compute.
fn small() -> BenchConfig {
    let mut config = BenchConfig::default();
    config.sensor.rows = 50;
    config.sensor.cols = 70;
    config.array = ArrayConfig { rows: 1, cols: 2, pitch_px: 20.0, lenses_px: None, placement_rms_px: 0.3 };
    config.optics.aperture_um = 20.0;
    config.optics.psf_window_px = 13;
    config.optics.object_distance_um = 300.0;
    config.optics.psf_field_px = 31;
    config.object = ObjectConfig { rows: 18, cols: 22, pixel_um: 2.8 };
    config.scan = ScanConfig { rows: 3, cols: 3, bead_e: 30_000.0, ..ScanConfig::default() };
    config.stacks.dark_frames = 3;
    config.stacks.flat_levels = vec![0.2, 0.4];
    config.stacks.flat_frames = 2;
    config.stacks.scene_frames = 3;
    config
}

#[test]
fn written_and_computed_frames_calibrate_to_the_same_instrument() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("s");
    let built = small().build(&[EffectSetting::new("lag", &[("share", 0.1)])]).unwrap();
    built.measure(&path, 5, |_| ()).unwrap();
    let (written, live) = (Session::open(&path).unwrap(), Arc::new(built).live(&path, 5));
    for (a, b) in written.stacks().iter().zip(live.stacks()) {
        assert_eq!((a.info(), a.role()), (b.info(), b.role()));
        let (mut x, mut y) = (a.frames().unwrap(), b.frames().unwrap());
        for i in 0..a.len() {
            assert_eq!(x.read(i).unwrap(), y.read(i).unwrap());
        }
    }
    let config = CalibrateConfig { rank: Some(2), ..CalibrateConfig::default() };
    let instrument = |session| calibrate(session, &config, || ()).unwrap().instrument;
    let (a, b) = (instrument(&written), instrument(&live));
    assert_eq!((a.psf.basis, a.noise), (b.psf.basis, b.noise));
}

/// Seven lenses in a hexagon.
fn hexagon() -> BenchConfig {
    let mut config = BenchConfig::default();
    (config.sensor.rows, config.sensor.cols) = (150, 160);
    (config.object.rows, config.object.cols) = (48, 48);
    let around = (0..6).map(|n| f64::from(n) * std::f64::consts::FRAC_PI_3);
    let places = around.map(|a| [74.5 + 34.0 * a.sin(), 79.5 + 34.0 * a.cos()]).chain([[74.5, 79.5]]);
    (config.array.rows, config.array.cols, config.array.pitch_px) = (1, 7, 34.0);
    (config.array.lenses_px, config.array.placement_rms_px) = (Some(places.collect()), 0.0);
    // What displaces foci from their anchors.
    let aberrations = &mut config.aberrations;
    (aberrations.coma, aberrations.scatter, aberrations.tilt_scatter) = (0.0, 0.0, 0.0);
    config.optics.distortion_px = 0.0;
    config.optics.aperture_um = 36.0;
    config.scan.rows = 9;
    config.scan.cols = 9;
    config
}

/// The errors that the checks find.
fn errors(session: &Path) -> Vec<String> {
    let found = check(&Session::open(session).unwrap(), || ()).unwrap();
    found.at_least(Severity::Error).map(|f| format!("{}: {}", f.topic, f.text)).collect()
}

/// Anchors and notes of a calibration.
fn calibrated(session: &Path) -> (Vec<[f64; 2]>, Vec<String>) {
    let config = CalibrateConfig { rank: Some(4), replicates: 0, ..CalibrateConfig::default() };
    let done = calibrate(&Session::open(session).unwrap(), &config, || ()).unwrap();
    (done.instrument.geometry.anchors_px, done.notes.iter().map(ToString::to_string).collect())
}

/// Declared as a grid, the foci of a hexagon are an error that says what to write instead; what it says passes, and so
/// do places that are all wrong by the same shift. Calibrated lenses lie where the virtual instrument has them.
#[test]
fn lenses_that_form_no_grid_are_listed_declared_and_calibrated() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("s");
    let roles = [Role::Dark, Role::Flat, Role::Bead];
    hexagon().build(&[]).unwrap().measure_some(&path, 4, &roles, |_| ()).unwrap();
    let places = Session::open(&path).unwrap().manifest().array.lenses_px.clone().unwrap();
    assert_eq!(errors(&path), [""; 0]);
    let as_measured = calibrated(&path);
    let declared = |text: &str| {
        let file = path.join("session.toml");
        let all = std::fs::read_to_string(&file).unwrap();
        let (start, rest) = all.split_at(all.find("[array]").unwrap());
        let end = rest.find("[optics]").unwrap();
        std::fs::write(&file, format!("{start}[array]\n{text}\n\n{}", &rest[end..])).unwrap();
        errors(&path)
    };
    let grid = declared("rows = 3\ncols = 3\npitch_px = 34.0");
    assert!(grid.len() == 1 && grid[0].contains("7 spots") && grid[0].contains("lenses_px"), "{grid:?}");
    // What the error says to write.
    let written: Vec<&str> = grid[0].split('`').skip(1).step_by(2).filter(|t| t.contains(" = ")).collect();
    assert_eq!(declared(&written.join("\n")), [""; 0], "{written:?}");
    let as_said = calibrated(&path);
    let shifted: Vec<[f64; 2]> = places.iter().map(|p| [p[0] + 6.0, p[1] - 4.0]).collect();
    assert_eq!(declared(&format!("rows = 1\ncols = 7\npitch_px = 34.0\nlenses_px = {shifted:?}")), [""; 0]);
    // A lens that nobody declared is no error: it may be a reflection.
    assert_eq!(declared(&format!("rows = 1\ncols = 6\npitch_px = 34.0\nlenses_px = {:?}", &places[..6])), [""; 0]);
    let warnings = check(&Session::open(&path).unwrap(), || ()).unwrap();
    assert!(warnings.at_least(Severity::Warning).any(|f| f.text.contains("1 elsewhere")), "{warnings:?}");

    for (anchors, notes) in [as_measured, as_said] {
        let off = |a: &[f64; 2]| places.iter().map(|t| (a[0] - t[0]).hypot(a[1] - t[1])).fold(f64::INFINITY, f64::min);
        assert!(anchors.len() == 7 && anchors.iter().all(|a| off(a) < 0.1), "{anchors:?} {places:?}");
        assert!(!notes.iter().any(|n| n.contains("dead")), "{notes:?}");
    }
}
