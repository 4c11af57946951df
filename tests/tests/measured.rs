//! Real measurements: the method on other real optics. Where the data are absent these tests count as skipped.
#![allow(clippy::unwrap_used)]

use ommatidia_host::instrument::{CalibrateConfig, calibrate};
use ommatidia_host::session::{Role, Session};
use ommatidia_tests::measured_data;

#[test]
fn measured_sessions_open() {
    let Some(sessions) = measured_data("measured_sessions_open", "sessions") else { return };
    let session = Session::open(sessions.join("fibre")).unwrap();
    let bead = session.need(Role::Bead).unwrap()[0];
    assert_eq!(bead.len(), 169);
    assert_eq!((bead.info()[0].x_um, bead.info()[0].y_um), (-143.76, -143.76));
    let frame = bead.frames().unwrap().read(84).unwrap();
    assert_eq!(frame.dim(), (360, 360));
    assert!(frame.iter().any(|v| *v > 100.0));
    let tardigrade = Session::open(sessions.join("tardigrade")).unwrap();
    assert_eq!(tardigrade.stacks()[0].frames().unwrap().read(0).unwrap().dim(), (1100, 1100));
}

/// Focal spots of a fibre microscope, 13 x 13, strongly field-dependent. With the checkerboard held out, one PSF misses them by
/// 0.298 (known from the data's own analysis).
#[test]
fn measured_spots_are_predicted_where_they_were_left_out() {
    let Some(folder) = measured_data("measured_spots_are_predicted_where_they_were_left_out", "sessions/fibre") else {
        return;
    };
    let session = Session::open(&folder).unwrap();
    let config = CalibrateConfig { normalise_beads: true, ..CalibrateConfig::default() };
    let q = calibrate(&session, &config, || {}).unwrap().instrument.quality;
    assert!(q.off_grid_error <= 0.14, "{q:?}");
    let raw = calibrate(&session, &CalibrateConfig::default(), || {}).unwrap().instrument.quality;
    assert!((raw.one_psf_error - 0.298).abs() < 0.002, "{raw:?}");
}
