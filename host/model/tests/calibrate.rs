//! Calibration of made-up and of measured sessions, from files to predictions.

#![allow(clippy::unwrap_used)]

use ndarray::{Array2, Axis};
use ommatidia_bench::truth::{BenchTruth, TRUTH_FILE};
use ommatidia_bench::{ArrayConfig, BenchConfig, ScanConfig};
use ommatidia_model::calibrate::{CalibrateConfig, Calibration, calibrate};
use ommatidia_model::forward::Forward;
use ommatidia_model::instrument::{Instrument, LightUnit};
use ommatidia_model::psf::OperatorConfig;
use ommatidia_model::testing::Testbed;
use ommatidia_physics::noise::Source;
use ommatidia_session::artifact::Provenance;
use ommatidia_session::{Role, Session};

fn run(bed: &Testbed, config: CalibrateConfig) -> Result<Calibration, String> {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("session");
    bed.write(&path);
    let session = Session::open(&path).map_err(|e| e.to_string())?;
    calibrate(&session, &config, || {}).map_err(|e| e.to_string())
}

fn small() -> Testbed {
    Testbed { flat_levels_e: vec![500.0, 4000.0], flat_frames: 3, dark_frames: 4, scan: 5, scenes: 0, ..Testbed::new() }
}

#[test]
fn a_session_becomes_an_instrument_that_predicts_scenes_it_has_not_seen() {
    let bed = Testbed::new();
    let Calibration { instrument: i, notes, .. } = run(&bed, CalibrateConfig::default()).unwrap();
    assert!(notes.is_empty(), "{notes:?}");
    let n = &i.noise;
    assert!((n.gain_dn_per_e / bed.gain_dn_per_e - 1.0).abs() < 0.02, "{n:?}");
    assert!((n.read_noise_e / bed.read_noise_e - 1.0).abs() < 0.05, "{n:?}");
    assert!((n.black_level_dn - bed.black_level_dn).abs() < 0.05, "{n:?}");
    assert!((n.gain_dn_per_e - bed.gain_dn_per_e).abs() < 5.0 * n.gain_sigma && n.gain_sigma < 0.01 * n.gain_dn_per_e);
    assert_eq!([n.sources.gain, n.sources.read_noise, n.sources.black_level], [Source::Measured; 3]);
    for (got, want) in i.geometry.anchors_px.iter().zip(&bed.anchors_px) {
        assert!((0..2).all(|a| (got[a] - want[a]).abs() < 0.1), "{got:?} {want:?}");
    }
    assert!((i.geometry.magnification - 0.5).abs() < 0.005);
    // A truth unit is half a bead.
    let LightUnit::Truth { per_bead } = i.light_unit else { panic!("{:?}", i.light_unit) };
    assert!((per_bead - 2.0).abs() < 0.01, "{per_bead}");
    let forward = Forward::new(&i).unwrap();
    let unseen = bed.scenes + 1;
    let got = forward.expected_e(bed.object(unseen).view(), &forward.context()).unwrap();
    let want = bed.expected_e(unseen);
    let misfit: f64 = got.iter().zip(&want).map(|(g, w)| (f64::from(*g) - w).powi(2)).sum();
    let nrmse = (misfit / want.iter().map(|w| w * w).sum::<f64>()).sqrt();
    assert!(nrmse < 0.01, "{nrmse}");
    // What is left out is predicted almost as well as noise allows, and far better than by one PSF.
    let q = &i.quality;
    assert!(q.off_grid_error < 1.3 * q.noise_floor && q.one_psf_error > 5.0 * q.off_grid_error, "{q:?}");
}

/// Responses of the pixels are found in the flats and carried to predictions, and what is corrected has none left.
#[test]
fn unlike_pixels_are_predicted_unlike() {
    let bed = Testbed { prnu: 0.02, ..Testbed::new() };
    let Calibration { instrument: i, .. } = run(&bed, CalibrateConfig::default()).unwrap();
    let truth = bed.response();
    let rms = |a: &Array2<f64>| (a.iter().map(|v| v * v).sum::<f64>() / a.len() as f64).sqrt();
    let found = i.response.as_ref().unwrap().mapv(f64::from);
    assert!(rms(&(&found - &truth)) < 0.005, "{}", rms(&(&found - &truth)));
    let forward = Forward::new(&i).unwrap();
    let got = forward.expected_e(bed.object(7).view(), &forward.context()).unwrap().mapv(f64::from);
    let want = bed.expected_e(7) * &truth;
    let nrmse = rms(&(&got - &want)) / rms(&want);
    assert!(nrmse < 0.01, "{nrmse}");
    let plain = Forward::new(&Instrument { response: None, ..i }).unwrap();
    let without = plain.expected_e(bed.object(7).view(), &plain.context()).unwrap().mapv(f64::from);
    assert!(rms(&(&without - &want)) > 2.0 * rms(&(&got - &want)));
    let none = run(&Testbed::new(), CalibrateConfig::default()).unwrap().instrument;
    assert!(none.response.is_none());
}

/// The jackknife says how far predictions scatter from session to session.
#[test]
fn replicates_tell_the_scatter_of_calibrations() {
    let bed = |seed| Testbed { seed, scenes: 0, flat_levels_e: vec![500.0, 4000.0], flat_frames: 3, ..Testbed::new() };
    let predict = |i: &Instrument| {
        let forward = Forward::new(i).unwrap();
        let e = forward.expected_e(bed(0).object(7).view(), &forward.context()).unwrap();
        (e.mapv(f64::from) * i.noise.gain_dn_per_e, e.sum())
    };
    // One total and all lit pixels: their variances over a set of predictions.
    let variances = |set: &[(Array2<f64>, f32)], factor: f64| {
        let n = set.len() as f64;
        let spread = |get: &dyn Fn(usize) -> f64| {
            let mean = (0..set.len()).map(get).sum::<f64>() / n;
            factor * (0..set.len()).map(|j| (get(j) - mean).powi(2)).sum::<f64>()
        };
        let lit: Vec<usize> = (0..set[0].0.len()).filter(|p| set[0].0.as_slice().unwrap()[*p] > 100.0).collect();
        let pixels = lit.iter().map(|p| spread(&|j| set[j].0.as_slice().unwrap()[*p])).sum::<f64>() / lit.len() as f64;
        [spread(&|j| set[j].0.sum()), pixels].map(f64::sqrt)
    };
    let sessions: Vec<Instrument> =
        (0..10).map(|seed| run(&bed(seed), CalibrateConfig::default()).unwrap().instrument).collect();
    let scatter = variances(&sessions.iter().map(predict).collect::<Vec<_>>(), 1.0 / 9.0);
    // One jackknife variance of a single figure has some seven degrees of freedom: take the mean of all.
    let mut jackknife = [0.0; 2];
    for i in &sessions {
        assert_eq!(i.replicates.len(), 8);
        let set: Vec<_> = (0..8).map(|j| predict(&i.replicate(j).unwrap())).collect();
        for (sum, v) in jackknife.iter_mut().zip(variances(&set, 7.0 / 8.0)) {
            *sum += v / sessions.len() as f64;
        }
    }
    for (j, s) in jackknife.iter().zip(&scatter) {
        assert!((0.5..2.0).contains(&(j / s)), "{jackknife:?} {scatter:?}");
    }
}

#[test]
fn one_psf_a_lens_is_the_mean_of_the_scan() {
    let bed = Testbed { scenes: 1, ..small() };
    let config = CalibrateConfig { one_psf: true, ..CalibrateConfig::default() };
    let i = run(&bed, config).unwrap().instrument;
    assert_eq!(i.psf.basis.dim().1, 1);
    let first = i.psf.coefficients[[2, 0, 0, 0, 0]];
    assert!(first > 0.0 && i.psf.coefficients.index_axis(Axis(0), 2).iter().all(|v| *v == first));
    assert!(i.quality.off_grid_error == i.quality.one_psf_error && i.quality.off_grid_error > 0.05, "{:?}", i.quality);
    let low_rank = run(&bed, CalibrateConfig::default()).unwrap().instrument;
    assert!((low_rank.quality.one_psf_error - i.quality.one_psf_error).abs() < 1e-12);
    assert!(i.replicates.len() == 8 && low_rank.quality.off_grid_error < 0.5 * i.quality.off_grid_error);
}

#[test]
fn each_depth_has_its_own_psfs_and_those_between_are_interpolated() {
    let bed = Testbed { depths_um: vec![-15.0, 0.0, 15.0, 30.0], scan: 7, scenes: 2, ..small() };
    let i = run(&bed, CalibrateConfig { replicates: 2, ..CalibrateConfig::default() }).unwrap().instrument;
    assert_eq!(i.psf.node_depths_um, bed.depths_um);
    assert_eq!((i.psf.depth_nearest(2.0), i.psf.depth_nearest(99.0)), (1, 3));
    // The scenes lie in focus: the light unit is theirs although that plane is not the first.
    assert!(
        matches!(i.light_unit, LightUnit::Truth { per_bead } if (per_bead - 2.0).abs() < 0.02),
        "{:?}",
        i.light_unit
    );
    let misfit = |i: &Instrument, z_um: f64| {
        let depth = i.psf.depth_nearest(z_um);
        let forward = Forward::with_config(i, OperatorConfig { depth, ..OperatorConfig::default() }).unwrap();
        let got = forward.expected_e(bed.object(7).view(), &forward.context()).unwrap();
        let want = bed.expected_at(7, z_um);
        let off: f64 = got.iter().zip(&want).map(|(g, w)| (f64::from(*g) - w).powi(2)).sum();
        (off / want.iter().map(|w| w * w).sum::<f64>()).sqrt()
    };
    for z_um in &bed.depths_um {
        assert!(misfit(&i, *z_um) < 0.015, "{z_um}: {}", misfit(&i, *z_um));
    }
    let between = Instrument { psf: i.psf.at_depth(6.0), ..i.clone() };
    assert!(misfit(&between, 6.0) < 0.02 && misfit(&i, 6.0) > 0.04, "{} {}", misfit(&between, 6.0), misfit(&i, 6.0));
    // Without depth as without replicates nothing is assumed about one plane.
    assert_eq!(i.replicate(1).unwrap().psf.coefficients.dim().2, 4);
}

/// One measured frame and nothing else: the sensor alone.
#[test]
fn a_session_without_beads_gives_the_sensor_alone() {
    use ommatidia_session::*;
    let mut manifest = Testbed::new().manifest;
    (manifest.object.rows, manifest.object.cols) = (manifest.sensor.rows, manifest.sensor.cols);
    manifest.array = ArrayGeometry::grid(1, 1, 0.0);
    let write = |path: &std::path::Path, manifest: &Manifest| {
        let mut writer = SessionWriter::create(path, manifest, Existing::Keep).unwrap();
        let [rows, cols] = [manifest.sensor.rows, manifest.sensor.cols];
        let spec = StackSpec { frames: 1, rows, cols, samples: SampleType::U16, pixel_um: None };
        let mut frames = writer.frames("scene.npy", spec).unwrap();
        let frame = Array2::from_shape_fn((rows, cols), |(r, c)| if r < 4 { 20.0 } else { 30.0 + (r * c % 50) as f32 });
        frames.push(frame.view()).unwrap();
        frames.finish().unwrap();
        writer.add(StackEntry::plain(Role::Scene, "scene.npy", 3.0));
        writer.finish().unwrap();
        calibrate(&Session::open(path).unwrap(), &CalibrateConfig::default(), || {}).map_err(|e| e.to_string())
    };
    let folder = tempfile::tempdir().unwrap();
    let Calibration { instrument, notes, .. } = write(&folder.path().join("a"), &manifest).unwrap();
    assert!(notes.iter().any(|n| n.contains("only the sensor is modelled")), "{notes:?}");
    assert!(notes.iter().any(|n| n.contains("quantile of the scenes")) && instrument.noise.black_level_dn == 20.0);
    let path = folder.path().join("a.instrument");
    instrument.write(&path, Provenance::new("calibrate", 1, &())).unwrap();
    let read = Instrument::read(&path).unwrap();
    assert!(read.sensor_only() && read.light_unit == LightUnit::Dn);
    let forward = Forward::new(&read).unwrap();
    let object = Array2::from_shape_fn((118, 122), |(r, c)| (r * 7 + c * 3) as f32);
    let frame = forward.expected_dn(object.view(), &forward.context()).unwrap();
    assert!(frame.iter().zip(&object).all(|(f, o)| (f - 20.0 - o).abs() < 1e-2));
    manifest.object.rows -= 1;
    let error = write(&folder.path().join("b"), &manifest).unwrap_err();
    assert!(error.contains("role = \"bead\""), "{error}");
}

#[test]
fn a_dead_lens_is_marked_and_a_dim_one_kept() {
    let bed = Testbed { lens_gain: vec![1.0, 0.0, 1.0, 0.2], ..small() };
    let Calibration { instrument, notes, .. } = run(&bed, CalibrateConfig::default()).unwrap();
    assert_eq!(instrument.geometry.dead, [false, true, false, false]);
    assert!(
        notes.iter().any(|n| n.contains("lens 1 shows no focus")) && notes.iter().any(|n| n.contains("lens 3 passes"))
    );
    assert!((0..2).all(|a| (instrument.geometry.anchors_px[3][a] - bed.anchors_px[3][a]).abs() < 0.2));
    assert!(
        run(&Testbed { lens_gain: vec![0.0; 4], ..small() }, CalibrateConfig::default())
            .unwrap_err()
            .contains("no focus")
    );
}

#[test]
fn foci_that_hang_over_the_edge_are_used_as_far_as_they_go() {
    let mut bed = Testbed { scenes: 1, scan: 7, ..small() };
    // The whole array sits too high: the first row of foci leaves the sensor.
    bed.anchors_px.iter_mut().for_each(|a| a[0] -= 17.0);
    let Calibration { instrument, notes, .. } = run(&bed, CalibrateConfig::default()).unwrap();
    assert!(notes.iter().any(|n| n.contains("extend beyond the edge")), "{notes:?}");
    let forward = Forward::new(&instrument).unwrap();
    let got = forward.expected_e(bed.object(7).view(), &forward.context()).unwrap();
    let want = bed.expected_e(7);
    let misfit: f64 = got.iter().zip(&want).map(|(g, w)| (f64::from(*g) - w).powi(2)).sum();
    let nrmse = (misfit / want.iter().map(|w| w * w).sum::<f64>()).sqrt();
    assert!(nrmse < 0.02, "{nrmse}");
}

#[test]
fn bad_bead_frames_are_named() {
    let refused = |spoil: fn(usize, &mut Array2<f32>)| {
        run(&Testbed { spoil, ..small() }, CalibrateConfig::default()).unwrap_err()
    };
    let saturated = refused(|n, f| {
        if n == 12 {
            f.mapv_inplace(|v| if v > 300.0 { 4095.0 } else { v });
        }
    });
    assert!(
        saturated.contains("bead.npy: frame 12, focus of lens") && saturated.contains("shorter exposure"),
        "{saturated}"
    );
    let dark = refused(|n, f| {
        if n == 3 {
            f.fill(64.0);
        }
    });
    assert!(dark.contains("bead.npy: frame 3: no light"), "{dark}");
}

#[test]
fn frames_that_are_marked_as_damaged_change_nothing() {
    let bed = small();
    let folder = tempfile::tempdir().unwrap();
    let calibrated = |name: &str, damage: bool| {
        let path = folder.path().join(name);
        bed.write(&path);
        for (stack, frame) in [("flat", 1), ("bead", 7)] {
            let table = path.join(format!("{stack}.csv"));
            let text = std::fs::read_to_string(&table).unwrap();
            // The first line is the header.
            let marked = text.lines().enumerate().map(|(i, line)| match i {
                0 => format!("{line},data\n"),
                _ if i == frame + 1 => format!("{line},damaged\n"),
                _ => format!("{line},whole\n"),
            });
            std::fs::write(&table, marked.collect::<String>()).unwrap();
            let file = path.join(format!("{stack}.npy"));
            let mut bytes = std::fs::read(&file).unwrap();
            let size = 4 * bed.manifest.sensor.rows * bed.manifest.sensor.cols;
            let frames = bytes.len() / size;
            let at = bytes.len() - (frames - frame) * size;
            if damage {
                bytes[at..at + size].as_chunks_mut::<4>().0.iter_mut().for_each(|v| *v = 3000f32.to_le_bytes());
            }
            std::fs::write(&file, bytes).unwrap();
        }
        calibrate(&Session::open(&path).unwrap(), &CalibrateConfig::default(), || {}).unwrap().instrument
    };
    let [whole, damaged] = [calibrated("whole", false), calibrated("damaged", true)];
    assert_eq!(whole.noise, damaged.noise);
    assert_eq!(whole.psf.basis, damaged.psf.basis);
    assert_eq!(whole.psf.coefficients, damaged.psf.coefficients);
    assert_eq!(whole.diagnostics.positions_px.len_of(Axis(0)), bed.scan * bed.scan - 1);
}

#[test]
fn a_value_that_is_no_number_names_its_frame() {
    let bed = small();
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("session");
    bed.write(&path);
    let file = path.join("bead.npy");
    let mut bytes = std::fs::read(&file).unwrap();
    let frame = 4 * bed.manifest.sensor.rows * bed.manifest.sensor.cols;
    let at = bytes.len() - (25 - 7) * frame + 400;
    bytes[at..at + 4].copy_from_slice(&f32::NAN.to_le_bytes());
    std::fs::write(&file, bytes).unwrap();
    let error = calibrate(&Session::open(&path).unwrap(), &CalibrateConfig::default(), || {}).unwrap_err().to_string();
    assert!(error.contains("bead.npy") && error.contains("frame 7") && error.contains("NaN"), "{error}");
}

#[test]
fn what_a_session_cannot_tell_is_nominal_and_said() {
    let bed = Testbed { flat_levels_e: Vec::new(), dark_frames: 0, ..small() };
    let Calibration { instrument, notes, .. } = run(&bed, CalibrateConfig::default()).unwrap();
    assert_eq!(instrument.noise.sources.gain, Source::Nominal);
    assert_eq!(instrument.noise.sources.black_level, Source::Inferred);
    assert!(instrument.offset_dn.is_none() && (instrument.noise.black_level_dn - 64.25).abs() < 1.0);
    assert!(
        notes.iter().any(|n| n.contains("no dark frames"))
            && notes.iter().any(|n| n.contains("gain is nominal, 1 DN/e-"))
    );
    let config = CalibrateConfig { rank: Some(26), ..CalibrateConfig::default() };
    assert!(run(&small(), config).unwrap_err().contains("expected 1 to 25"));
}

/// The virtual instrument forms its images by physical optics, with its own code: the model must agree with it.
#[test]
fn the_virtual_instruments_scenes_are_predicted() {
    let mut config = BenchConfig::default();
    (config.sensor.rows, config.sensor.cols) = (90, 124);
    config.array = ArrayConfig { rows: 1, cols: 2, pitch_px: 50.0, ..config.array };
    (config.object.rows, config.object.cols) = (40, 40);
    config.scan = ScanConfig { rows: 9, cols: 9, ..config.scan };
    config.stacks.scene_frames = 2;
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("session");
    let virtual_instrument = config.build(&[]).unwrap();
    virtual_instrument.measure(&path, 3, |_| ()).unwrap();
    let session = Session::open(&path).unwrap();
    let Calibration { instrument: i, .. } = calibrate(&session, &CalibrateConfig::default(), || {}).unwrap();
    let truth: BenchTruth = serde_json::from_slice(&std::fs::read(path.join(TRUTH_FILE)).unwrap()).unwrap();
    assert!((i.noise.gain_dn_per_e / truth.gain_dn_per_e - 1.0).abs() < 0.02, "{:?}", i.noise);
    assert!((i.noise.read_noise_e / truth.read_noise_e - 1.0).abs() < 0.05, "{:?}", i.noise);
    for (got, want) in i.geometry.anchors_px.iter().zip(truth.anchors_px.iter().flatten()) {
        assert!((0..2).all(|a| (got[a] - want[a]).abs() < 0.1), "{got:?} {want:?}");
    }
    let forward = Forward::new(&i).unwrap();
    let scene = session.need(Role::Scene).unwrap()[0];
    let (mut truths, mut expected) = (scene.truth().unwrap().unwrap(), scene.expected().unwrap().unwrap());
    let (mut misfit, mut light) = (0.0, 0.0);
    for n in 0..scene.len() {
        let got = forward.expected_dn(truths.read(n).unwrap().view(), &forward.context()).unwrap();
        for (g, w) in got.iter().zip(&expected.read(n).unwrap()) {
            misfit += f64::from(g - w).powi(2);
            light += (f64::from(*w) - truth.black_level_dn).powi(2);
        }
    }
    assert!((misfit / light).sqrt() < 0.01, "{}", (misfit / light).sqrt());
}

/// Frames of unequal brightness are seen in the data, and a bead of one brightness is left as it was measured.
#[test]
fn unequal_beads_are_normalised_and_equal_ones_are_not() {
    let bed = Testbed { scan: 9, ..small() };
    let equal = run(&bed, CalibrateConfig::default()).unwrap();
    assert!(!equal.beads_normalised && equal.bead_scatter.unwrap() < 0.01, "{:?}", equal.bead_scatter);
    // About a tenth, as of frames that were normalised by their maxima.
    let spoil = |n: usize, frame: &mut Array2<f32>| {
        let factor = 0.8 + 0.4 * (n * 7919 % 101) as f32 / 101.0;
        frame.mapv_inplace(|v| ((v - 64.25) * factor + 64.25).round());
    };
    assert_eq!(bed.black_level_dn, 64.25);
    let spoiled = Testbed { spoil, ..bed };
    let unequal = run(&spoiled, CalibrateConfig { accept: true, ..CalibrateConfig::default() }).unwrap();
    assert!(unequal.beads_normalised && unequal.notes.iter().any(|n| n.contains("--normalise-beads=no")));
    let scatter = unequal.bead_scatter.unwrap();
    // The factors scatter by 0.12; a bead is predicted from others that scatter too, at the border by extrapolation.
    assert!((0.12..0.36).contains(&scatter), "{scatter}");
    let forced = |normalise_beads| {
        let config = CalibrateConfig { normalise_beads: Some(normalise_beads), accept: true, ..Default::default() };
        run(&spoiled, config).unwrap()
    };
    let (yes, no) = (forced(true), forced(false));
    assert_eq!(unequal.instrument.psf.basis, yes.instrument.psf.basis);
    assert!(!no.beads_normalised && no.bead_scatter.is_none());
    assert!(yes.instrument.quality.off_grid_error < 0.5 * no.instrument.quality.off_grid_error);
}
