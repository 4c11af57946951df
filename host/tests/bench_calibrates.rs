//! Sessions of the virtual instrument can be calibrated, from files and from computed frames alike.
#![allow(clippy::unwrap_used)]

use ommatidia_host::bench::{ArrayConfig, BenchConfig, ObjectConfig, ScanConfig};
use ommatidia_host::calibrate::{CalibrateConfig, calibrate};
use ommatidia_host::effects::EffectSetting;
use ommatidia_host::session::Session;
use std::sync::Arc;

/// Two lenses before a small sensor; quick to compute.
fn small() -> BenchConfig {
    let mut config = BenchConfig::default();
    config.sensor.rows = 50;
    config.sensor.cols = 70;
    config.array = ArrayConfig { rows: 1, cols: 2, pitch_px: 20.0, placement_rms_px: 0.3 };
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
