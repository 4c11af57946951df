//! What a calibration says of its errors in bead frames, against other frames of the same bench.

#![allow(clippy::unwrap_used)]

use ommatidia_bench::{BenchConfig, FamilyName, ScanConfig};
use ommatidia_model::calibrate::{CalibrateConfig, calibrate};
use ommatidia_model::forward::Forward;
use ommatidia_model::instrument::Instrument;
use ommatidia_model::testing::Testbed;
use ommatidia_session::{Role, Session};

fn small(family: FamilyName) -> BenchConfig {
    let mut c = BenchConfig { family, instrument_seed: 506, ..BenchConfig::default() };
    (c.sensor.rows, c.sensor.cols) = (98, 98);
    c.array.pitch_px = 26.0;
    (c.object.rows, c.object.cols) = (30, 30);
    c.optics.psf_field_px = 23;
    c.optics.aperture_um = 28.9;
    c.optics.object_distance_um = 300.0;
    c.scan = ScanConfig { rows: 11, cols: 11, depths_um: vec![0.0], bead_e: 80_000.0, ..c.scan };
    c
}

/// NRMSE without noise of the bead frames of a session, each at its own brightness.
fn error_of_frames(instrument: &Instrument, session: &Session) -> f64 {
    let forward = Forward::new(instrument).unwrap();
    let cx = forward.context();
    let noise = instrument.noise;
    let (mut excess, mut light) = (0.0, 0.0);
    for stack in session.need(Role::Bead).unwrap() {
        let mut frames = stack.frames().unwrap();
        for (n, info) in stack.info().iter().enumerate() {
            let at = session.manifest().object.pixel_of_um(info.y_um, info.x_um);
            let scene = forward.point(at, &Default::default(), &cx).unwrap();
            let expected = forward.light_e(&scene, &Default::default(), &cx);
            let measured = frames.read(n).unwrap();
            let both =
                || measured.iter().zip(&expected).map(|(y, e)| (f64::from(*y) - noise.black_level_dn, f64::from(*e)));
            let scale = both().map(|(y, e)| y * e).sum::<f64>() / both().map(|(_, e)| e * e).sum::<f64>();
            for (y, e) in both() {
                let light_dn = scale * e;
                excess += (y - light_dn).powi(2) - noise.variance_dn2(noise.black_level_dn + light_dn);
                light += light_dn * light_dn;
            }
        }
    }
    (excess / light).max(0.0).sqrt()
}

/// The bench draws foci that are sharper than its pixels: windows that were moved by fractions of a pixel agree better
/// with one another than any of them does with a frame. New beads at other positions say which figure is right.
#[test]
fn the_error_of_bead_frames_is_that_of_new_ones() {
    let folder = tempfile::tempdir().unwrap();
    for family in [FamilyName::Kernels, FamilyName::Pupils] {
        let config = small(family);
        let bench = config.build(&[]).unwrap();
        let path = folder.path().join(format!("{family:?}"));
        bench.measure(&path, 3, |_| ()).unwrap();
        let instrument =
            calibrate(&Session::open(&path).unwrap(), &CalibrateConfig::default(), || {}).unwrap().instrument;
        let new = BenchConfig { scan: ScanConfig { rows: 7, cols: 7, ..config.scan.clone() }, ..config.clone() };
        let later = folder.path().join(format!("{family:?}-later"));
        new.build(&[]).unwrap().measure_some(&later, 4, &[Role::Bead], |_| ()).unwrap();
        let found = error_of_frames(&instrument, &Session::open(&later).unwrap());
        let (stated, of_windows) = (instrument.quality.frame_error, instrument.quality.off_grid_excess());
        assert!((stated / found - 1.0).abs() < 0.25, "{family:?}: stated {stated}, found {found}");
        assert!(found > 1.5 * of_windows, "{family:?}: found {found}, of windows {of_windows}");
        assert_eq!(instrument.quality.bead_error(), stated);
    }
}

/// Dim beads, so that most of a window is dark: noise below the black level is noise as well.
#[test]
fn positions_that_were_left_out_err_by_the_noise_and_a_little_more() {
    let bed = Testbed { bead_e: 1_500.0, scenes: 0, ..Testbed::new() };
    let folder = tempfile::tempdir().unwrap();
    bed.write(folder.path());
    let config = CalibrateConfig { replicates: 0, ..CalibrateConfig::default() };
    let quality = calibrate(&Session::open(folder.path()).unwrap(), &config, || {}).unwrap().instrument.quality;
    let ratio = quality.off_grid_error / quality.noise_floor;
    assert!((1.0..1.06).contains(&ratio), "{ratio} {quality:?}");
    assert_eq!(quality.frame_error, 0.0);
}
