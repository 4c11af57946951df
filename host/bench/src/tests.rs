#![allow(clippy::unwrap_used)]

use super::foci::Point;
use super::optics::{Emission, Moves};
use super::stacks::Bead;
use super::truth::{BenchTruth, TRUTH_FILE};
use super::*;
use ndarray::{Array2, s};
use ommatidia_physics::effects::{Chain, EffectSetting, FrameContext, Layout, Record};
use ommatidia_session::{Role, Session};
use std::path::Path;

/// Two lenses before a small sensor; quick to compute.
fn small() -> BenchConfig {
    let mut config = BenchConfig::default();
    config.sensor.rows = 50;
    config.sensor.cols = 70;
    config.array = ArrayConfig { rows: 1, cols: 2, pitch_px: 20.0, placement_rms_px: 0.3, lenses_px: None };
    config.optics.aperture_um = 20.0;
    config.optics.psf_window_px = 13;
    config.optics.object_distance_um = 300.0;
    config.optics.psf_field_px = 31;
    config.object = ObjectConfig { rows: 18, cols: 22, pixel_um: 2.8 };
    config.scan = ScanConfig { rows: 2, cols: 3, bead_e: 30_000.0, ..ScanConfig::default() };
    config.stacks.dark_frames = 3;
    config.stacks.flat_levels = vec![0.2, 0.4];
    config.stacks.flat_frames = 2;
    config.stacks.scene_frames = 3;
    config
}

fn context() -> FrameContext<'static> {
    FrameContext { exposure_ms: 10.0, illumination: 1.0, ..FrameContext::default() }
}

fn in_focus(at_um: [f64; 2]) -> Point {
    Point { at_um, z_um: 0.0 }
}

fn bead(at_um: [f64; 2]) -> Bead {
    Bead { point: in_focus(at_um), index: None }
}

fn effect(id: &str, name: &str, value: f64) -> EffectSetting {
    EffectSetting::new(id, &[(name, value)])
}

fn correlation(a: &Array2<f32>, b: &Array2<f32>) -> f64 {
    let (a, b) = (a.mapv(f64::from), b.mapv(f64::from));
    let (a, b) = (&a - a.mean().unwrap(), &b - b.mean().unwrap());
    (&a * &b).sum() / ((&a * &a).sum() * (&b * &b).sum()).sqrt()
}

#[test]
fn a_session_opens_and_its_sizes_are_the_configured_ones() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("s");
    let summary = small().build(&[]).unwrap().measure(&path, 3, |_| ()).unwrap();
    let session = Session::open(&path).unwrap();
    for (role, n) in [(Role::Dark, 3), (Role::Flat, 4), (Role::Bead, 6), (Role::Scene, 3)] {
        assert_eq!(session.need(role).unwrap()[0].len(), n);
        assert_eq!(summary.frames[role.name()], n);
    }
    let bead = session.need(Role::Bead).unwrap()[0];
    assert!((bead.info()[5].x_um - 10.5 * 2.8).abs() < 1e-9 && (bead.info()[5].y_um - 8.5 * 2.8).abs() < 1e-9);
    let truth: BenchTruth = serde_json::from_slice(&std::fs::read(path.join(TRUTH_FILE)).unwrap()).unwrap();
    assert_eq!((truth.anchors_px.len(), truth.anchors_px[0].len()), (1, 2));
    assert_eq!(truth.config, small());
    // The scene's expectation is what its noisy frame scatters about.
    let scene = session.need(Role::Scene).unwrap()[0];
    let frame = scene.frames().unwrap().read(1).unwrap();
    let expected = scene.expected().unwrap().unwrap().read(1).unwrap();
    // Lit pixels: there the fixed pattern, 1.5 DN, counts for nothing in the variance.
    let lit = frame.iter().zip(&expected).filter(|(_, e)| **e > 200.0);
    let variance = |e: f32| 0.4 * (e - 64.0) + 0.64 + 1.0 / 12.0;
    let pulls: Vec<f32> = lit.map(|(y, e)| (y - e) / variance(*e).sqrt()).collect();
    let n = pulls.len() as f32;
    let (mean, square) = (pulls.iter().sum::<f32>() / n, pulls.iter().map(|p| p * p).sum::<f32>() / n);
    // Five standard errors of the mean and of the mean square of n unit normals.
    assert!(n > 100.0, "{n}");
    assert!(mean.abs() < 5.0 / n.sqrt(), "{mean}");
    assert!((square - 1.0).abs() < 5.0 * (2.0 / n).sqrt(), "{square}");
}

#[test]
fn the_same_seed_gives_the_same_bytes_on_any_number_of_threads() {
    let dir = tempfile::tempdir().unwrap();
    let bytes = |threads: usize, seed: u64| {
        let path = dir.path().join(format!("{threads}-{seed}"));
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| small().build(&[]).unwrap().measure(&path, seed, |_| ()).unwrap());
        ["dark.npy", "flat.npy", "bead.npy", "scene.npy", "scene_expected.npy", "scene_truth.npy"]
            .map(|f| std::fs::read(path.join(f)).unwrap())
    };
    let one = bytes(1, 5);
    assert!(one == bytes(3, 5));
    assert!(one.iter().zip(bytes(1, 6)).all(|(a, b)| *a != b));
}

#[test]
fn no_light_is_lost_between_the_object_and_the_sensor() {
    let instrument = small().build(&[]).unwrap();
    let moves = Moves { effects: &Chain::default(), cx: &context() };
    let mut work = instrument.optics.work();
    let at = [3.0, -5.0];
    let passed: f64 = (0..2).map(|l| instrument.optics.focus(l, in_focus(at), moves, &mut work).transmission).sum();
    let light = instrument.bead_light(bead(at), &context()).mapv(f64::from).sum();
    assert!((light / (30_000.0 * passed) - 1.0).abs() < 2e-3, "{light} {passed}");
}

#[test]
fn a_bead_on_an_object_pixel_is_that_pixel_lit() {
    let instrument = small().build(&[]).unwrap();
    let mut object = Array2::zeros((18, 22));
    object[[4, 15]] = 1.0f32;
    let moves = Moves { effects: &Chain::default(), cx: &context() };
    let objects = [object];
    let emission = Emission { objects: &objects, unit_e: 30_000.0, z_um: 0.0, kept: None };
    let images: Array2<f32> = (0..2)
        .map(|l| instrument.optics.lens_images(l, &emission, moves))
        .fold(Array2::zeros((50, 70)), |sum, image| sum + image.slice(s![0, .., ..]));
    let light = instrument.bead_light(bead(instrument.optics.position_um(4, 15)), &context());
    let worst = (&images - &light).fold(0.0f32, |m, v| m.max(v.abs()));
    assert!(worst <= 1e-4 * light.fold(0.0f32, |m, v| m.max(*v)), "{worst}");
}

#[test]
fn foci_without_aberrations_are_centred_on_their_chief_rays() {
    let mut config = small();
    config.aberrations = AberrationConfig {
        defocus: 0.0,
        spherical: 0.0,
        field_curvature: 0.0,
        astigmatism: 0.0,
        coma: 0.0,
        scatter: 0.0,
        tilt_scatter: 0.0,
    };
    config.optics.distortion_px = 0.0;
    config.optics.magnification_error = 0.01;
    config.array = ArrayConfig { rows: 1, cols: 1, pitch_px: 0.0, placement_rms_px: 0.4, lenses_px: None };
    let instrument = config.build(&[]).unwrap();
    let anchor = instrument.optics.anchors_px()[0];
    for at in [[0.0, 0.0], [11.0, -17.3]] {
        let light = instrument.bead_light(bead(at), &context()).mapv(f64::from);
        for axis in 0..2 {
            let centroid: f64 =
                light.indexed_iter().map(|((r, c), v)| v * [r, c][axis] as f64).sum::<f64>() / light.sum();
            // Eq. 1: magnification over pixel pitch times the position.
            let expected = anchor[axis] + 1.01 * 0.660714 / 1.85 * at[axis];
            assert!((centroid - expected).abs() < 0.02, "{centroid} {expected}");
        }
    }
}

/// Windows of every focus of the demo instrument for a bead at (r, c) object pixels, and the share of the norm outside
/// them.
fn demo_foci(instrument: &VirtualInstrument, r: usize, c: usize) -> (Vec<Array2<f32>>, f64) {
    let moves = Moves { effects: &Chain::default(), cx: &context() };
    let mut work = instrument.optics.work();
    let at = instrument.optics.position_um(r, c);
    let (mut windows, mut inside, mut total) = (Vec::new(), 0.0, 0.0);
    for l in 0..instrument.optics.lenses() {
        let transmission = instrument.optics.focus(l, in_focus(at), moves, &mut work).transmission;
        let psf = &work.psf;
        let image = Array2::from_shape_vec((psf.side, psf.side), psf.share.clone()).unwrap();
        let image = image.mapv(|v| v * transmission as f32);
        let (half, window) = (psf.side / 2, 7);
        let part = image.slice(s![half - window..=half + window, half - window..=half + window]).to_owned();
        inside += part.mapv(|v| f64::from(v).powi(2)).sum();
        total += image.mapv(|v| f64::from(v).powi(2)).sum();
        windows.push(part);
    }
    (windows, (1.0 - inside / total).sqrt())
}

#[test]
fn the_demo_instrument_is_a_hard_but_fair_one() {
    let instrument = BenchConfig::default().build(&[]).unwrap();
    let (centre, _) = demo_foci(&instrument, 48, 48);
    let mut worst_outside = 0.0f64;
    let mut edge = Vec::new();
    for (r, c) in [(0, 0), (0, 95), (95, 0), (95, 95), (0, 48), (48, 95), (24, 24), (48, 48)] {
        let (windows, outside) = demo_foci(&instrument, r, c);
        worst_outside = worst_outside.max(outside);
        let pcc: Vec<f64> = windows.iter().zip(&centre).map(|(w, m)| correlation(w, m)).collect();
        println!("({r:2}, {c:2}): outside {outside:.4}, PCC {pcc:.2?}");
        if r == 0 && c == 0 {
            edge = pcc;
        }
    }
    // The window holds the foci; the PSF differs over the field, and between lenses.
    assert!(worst_outside < 0.012, "{worst_outside}");
    assert!(edge.iter().copied().fold(1.0, f64::min) < 0.9, "{edge:?}");
    assert!(correlation(&centre[5], &centre[8]) < 0.99);
}

#[test]
fn effects_act_at_their_stage_and_nothing_changes_without_them() {
    let cx = context();
    let plain = small().build(&[]).unwrap();
    let off = small().build(&[effect("halo", "weight", 0.0)]).unwrap();
    let at = [4.0, 9.0];
    let light = plain.bead_light(bead(at), &cx);
    assert_eq!(light, off.bead_light(bead(at), &cx));
    // Lens: the first lens at half its gain.
    let gain = small().build(&[effect("excitation_profile", "falloff", 0.5)]).unwrap();
    let [r, c] = small().manifest().object.pixel_of_um(at[0], at[1]);
    let rho2 = ((r - 8.5).powi(2) + (c - 10.5).powi(2)) / (9f64.powi(2) + 11f64.powi(2));
    let share = f64::from(gain.bead_light(bead(at), &cx).sum() / light.sum());
    assert!((share - (1.0 - 0.5 * rho2)).abs() < 0.02, "{share} {rho2}");
}

const FILES: [&str; 6] = ["dark.npy", "flat.npy", "bead.npy", "scene.npy", "scene_expected.npy", "scene_truth.npy"];

fn bytes_of(instrument: &VirtualInstrument, dir: &Path) -> Vec<Vec<u8>> {
    let path = dir.join("s");
    instrument.measure(&path, 5, |_| ()).unwrap();
    FILES.iter().map(|f| std::fs::read(path.join(f)).unwrap()).collect()
}

#[test]
fn kept_foci_give_the_same_bytes() {
    let dir = tempfile::tempdir().unwrap();
    let mut config = small();
    // More than one batch of scenes, so that something is kept even without another instrument.
    config.stacks.scene_frames = 18;
    config.scan.depths_um = vec![-20.0, 20.0];
    let first = config.build(&[]).unwrap();
    let mut other = config.clone();
    other.stacks.scene_depths_um = vec![30.0];
    for settings in [
        vec![],
        vec![effect("halo", "weight", 0.1)],
        vec![effect("array_shift", "row_px", 1.25)],
        vec![effect("thermal_drift", "row_px_per_s", 5.0), effect("lens_gain", "change_1", 0.2)],
    ] {
        for config in [&config, &other] {
            let shared = config.build_like(&first, &settings).unwrap();
            let mut alone = config.build(&settings).unwrap();
            alone.forget();
            assert!(bytes_of(&shared, dir.path()) == bytes_of(&alone, dir.path()), "{settings:?}");
        }
    }
}

/// Expected frames and truths of the scenes, and the session.
fn scenes_of(config: &BenchConfig, settings: &[EffectSetting]) -> (Vec<Array2<f32>>, Vec<Array2<f32>>, Session) {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("s");
    config.build(settings).unwrap().measure(&path, 3, |_| ()).unwrap();
    let session = Session::open(&path).unwrap();
    let scene = session.need(Role::Scene).unwrap()[0];
    let (mut expected, mut truth) = (scene.expected().unwrap().unwrap(), scene.truth().unwrap().unwrap());
    let frames = 0..scene.len();
    let expected = frames.clone().map(|i| expected.read(i).unwrap()).collect();
    let truth = frames.map(|i| truth.read(i).unwrap()).collect();
    (expected, truth, session)
}

#[test]
fn effects_see_the_frame_before_across_batches_of_scenes() {
    let mut config = small();
    config.stacks.scene_frames = 18;
    config.sensor.offset_rms_dn = 0.0;
    let (clean, ..) = scenes_of(&config, &[]);
    let (with, ..) = scenes_of(&config, &[EffectSetting::new("lag", &[("share", 0.1), ("tau_s", 0.02)])]);
    for k in [0, 1, 15, 16, 17] {
        let before = if k > 0 { &clean[k - 1] - 64.0 } else { &clean[0] * 0.0 };
        let left = (&with[k] - &clean[k]) - before * (0.1 * (-1f32).exp());
        let worst = left.iter().fold(0.0f32, |m, v| m.max(v.abs()));
        assert!(worst < 0.02, "{k}: {worst}");
    }
}

#[test]
fn the_same_fault_of_the_record_puts_it_right() {
    let (expected, truths, _) = scenes_of(&small(), &[]);
    for faults in [
        [("exposure_factor", 1.25), ("frame", 1.0), ("flip_rows", 1.0), ("flip_cols", 1.0)].to_vec(),
        [("swapped_with_next", 1.0), ("flip_cols", 1.0)].to_vec(),
        [("swapped_with_next", 1.0), ("frame", 1.0), ("flip_rows", 1.0)].to_vec(),
    ] {
        let setting = EffectSetting::new("metadata_fault", &faults);
        let (same, recorded, session) = scenes_of(&small(), std::slice::from_ref(&setting));
        assert_eq!(expected, same, "frames are as they were");
        assert_ne!(truths, recorded);
        let chain = Chain::build(&[setting], Layout { lenses: 2, sensor: [50, 70] }).unwrap();
        for (k, info) in session.need(Role::Scene).unwrap()[0].info().iter().enumerate() {
            let mut record = Record::honest(k, recorded.len());
            chain.on_record(&mut record, &FrameContext { frame: k, ..context() });
            assert_eq!(record.object(&recorded).unwrap(), truths[k], "{faults:?}");
            assert!((info.exposure_ms * record.exposure_factor - 10.0).abs() < 1e-9);
        }
    }
}

#[test]
fn depths_and_exposures_are_scanned() {
    let mut config = small();
    config.scan.depths_um = vec![-40.0, 0.0];
    config.stacks.scene_depths_um = vec![-40.0, 20.0];
    config.stacks.flat_exposures_ms = vec![5.0, 40.0];
    config.stacks.dark_exposures_ms = vec![1.0, 100.0];
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("s");
    let dark = EffectSetting::new("dark_current", &[("rate_e_per_ms", 2.0)]);
    let instrument = config.build(&[dark]).unwrap();
    let summary = instrument.measure(&path, 3, |_| ()).unwrap();
    assert_eq!(summary.frames.values().sum::<usize>(), instrument.frames());
    let session = Session::open(&path).unwrap();
    let stack = |role| session.need(role).unwrap()[0];
    let depths: Vec<f64> = stack(Role::Bead).info().iter().map(|i| i.z_um).collect();
    assert_eq!(depths, [vec![-40.0; 6], vec![0.0; 6]].concat());
    let mean = |role, i| f64::from(stack(role).frames().unwrap().read(i).unwrap().mean().unwrap());
    let scenes: Vec<f64> = stack(Role::Scene).info().iter().map(|i| i.z_um).collect();
    assert_eq!(scenes, [vec![-40.0; 3], vec![20.0; 3]].concat());
    // The same specimens at both depths, whatever scale their light has; other frames.
    let mut truths = stack(Role::Scene).truth().unwrap().unwrap();
    let [near, far] = [1, 4].map(|i| truths.read(i).unwrap());
    let [a, b] = [&near, &far].map(|t| t / t.fold(0.0f32, |m, v| m.max(*v)));
    assert!((&a - &b).iter().all(|d| d.abs() < 1e-5));
    assert_ne!(mean(Role::Scene, 1), mean(Role::Scene, 4));
    let flats = stack(Role::Flat);
    let levels: Vec<_> = flats.info().iter().map(|i| (i.exposure_ms, i.illumination)).collect();
    assert_eq!(levels[..4], [(5.0, 0.2), (5.0, 0.2), (5.0, 0.4), (5.0, 0.4)]);
    // 0.2 of full scale in 10 ms, half of it in 5, four times in 40; 0.4 DN an electron of dark current.
    let full = config.full_scale_e() * 0.4;
    assert!((mean(Role::Flat, 0) - 64.0 - 0.1 * full - 4.0).abs() < 2.0);
    assert!((mean(Role::Flat, 4) - 64.0 - 0.8 * full - 32.0).abs() < 5.0);
    assert!((mean(Role::Dark, 3) - mean(Role::Dark, 0) - 79.2).abs() < 1.0);
    // One exposure is over before the next begins.
    assert!((flats.info()[1].time_s - 0.04).abs() < 1e-12 && stack(Role::Bead).info()[1].time_s == 0.02);
}

#[test]
fn configurations_are_checked() {
    let toml = toml::to_string(&small()).unwrap();
    // The truth of a session without scans has the same keys as before scans existed.
    assert!(
        !toml.contains("depths_um") && !toml.contains("exposures_ms") && !toml.contains("scene_depths_um"),
        "{toml}"
    );
    assert_eq!(toml::from_str::<BenchConfig>(&toml).unwrap(), small());
    assert_eq!(toml::from_str::<BenchConfig>("").unwrap(), BenchConfig::default());
    assert!(toml::from_str::<BenchConfig>("[sensor]\nrow = 3").unwrap_err().to_string().contains("row"));
    let refused = |change: fn(&mut BenchConfig), message: &str| {
        let mut config = small();
        change(&mut config);
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("s");
        let result = config.build(&[]).and_then(|i| i.measure(&path, 1, |_| ()).map(drop));
        let error = result.unwrap_err().to_string();
        assert!(error.contains(message), "{error}");
        assert_eq!(std::fs::read_dir(dir.path()).unwrap().count(), 0, "nothing is left behind");
    };
    refused(|c| c.sensor.gain_dn_per_e = 0.0, "sensor.gain_dn_per_e");
    refused(|c| c.sensor.black_level_dn = 5000.0, "sensor.black_level_dn");
    refused(|c| c.optics.aperture_um = 30.0, "optics.aperture_um");
    refused(|c| c.optics.oversampling = 2, "oversampling");
    refused(|c| c.optics.psf_field_px = 11, "psf_field_px");
    refused(|c| c.object.pixel_um = 3.5, "object.pixel_um");
    refused(|c| c.stacks.flat_levels = vec![f64::NAN], "flat_levels");
    refused(|c| c.scan.rows = 0, "scan.rows");
    refused(|c| c.scan.depths_um = vec![], "scan.depths_um");
    refused(|c| c.stacks.dark_exposures_ms = vec![0.0], "stacks.dark_exposures_ms");
    refused(|c| c.stacks.scene_depths_um = vec![f64::INFINITY], "stacks.scene_depths_um");
    refused(|c| c.stacks.scene_depths_um = vec![], "stacks.scene_depths_um");
    let unknown = small().build(&[effect("gremlin", "x", 1.0)]).unwrap_err().to_string();
    assert!(unknown.contains("gremlin") && unknown.contains("halo"), "{unknown}");
}

#[test]
fn computed_frames_are_those_that_would_be_written() {
    use std::sync::Arc;
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("s");
    let config = BenchConfig { scan: ScanConfig { rows: 3, ..small().scan }, ..small() };
    let built = config.build(&[effect("lag", "share", 0.1)]).unwrap();
    built.measure(&path, 5, |_| ()).unwrap();
    let (written, live) = (Session::open(&path).unwrap(), Arc::new(built).live(&path, 5));
    assert!(live.is_computed() && !written.is_computed());
    for (a, b) in written.stacks().iter().zip(live.stacks()) {
        assert_eq!((a.info(), a.role()), (b.info(), b.role()));
        let (mut x, mut y) = (a.frames().unwrap(), b.frames().unwrap());
        // In any order, as from a file.
        for i in (0..a.len()).rev().chain(0..a.len()) {
            assert_eq!(x.read(i).unwrap(), y.read(i).unwrap());
        }
        assert!(y.read(a.len()).is_err());
    }
}
