//! A session without a bead scan: the sensor as measured, behind optics that copy each object pixel to one sensor
//! pixel.

use super::error::CalibrateError;
use crate::bead::check_grid;
use crate::instrument::{Diagnostics, Instrument, LightUnit, Quality};
use crate::psf::{ChiefRays, LowRankPsf};
use ndarray::{Array4, Array5};
use ommatidia_physics::effects::EffectSetting;
use ommatidia_physics::noise::{Bend, NoiseCalibration};
use ommatidia_session::{Manifest, Role, Session};

/// Note for the user where the optics were not measured.
pub(super) const NOTE: &str = "no bead scan: only the sensor is modelled; the optics copy each object pixel to its \
                               sensor pixel, and one unit of \
     light is 1 DN there";

/// Whether only the sensor can be calibrated: there are no beads, and object and sensor share one grid behind one lens.
pub(super) fn applies(session: &Session) -> bool {
    let m = session.manifest();
    session.stacks_of(Role::Bead).next().is_none()
        && m.array.lenses() == 1
        && [m.object.rows, m.object.cols] == [m.sensor.rows, m.sensor.cols]
}

/// The bend of the response as an effect of the instrument.
pub(super) fn bend_effect(bend: &Bend) -> EffectSetting {
    EffectSetting::new("nonlinearity", &[("beta", bend.beta)])
}

/// The instrument of a session without a bead scan, with the identity as its optics.
pub(super) fn instrument(
    session: &Session,
    manifest: Manifest,
    noise: NoiseCalibration,
) -> Result<Instrument, CalibrateError> {
    check_grid(&manifest)?;
    let side = manifest.optics.psf_window_px;
    let mut basis = Array4::zeros((1, 1, side, side));
    basis[[0, 0, side / 2, side / 2]] = 1.0;
    let middle = [manifest.object.rows, manifest.object.cols].map(|n| (n as f64 - 1.0) / 2.0);
    let first = session.stacks_of(Role::Scene).chain(session.stacks()).next();
    Ok(Instrument {
        psf: LowRankPsf {
            basis,
            coefficients: Array5::ones((1, 1, 1, 1, 1)),
            node_depths_um: vec![0.0],
            node_rows_px: vec![middle[0]],
            node_cols_px: vec![middle[1]],
            exposure_ms: first.map_or(1.0, |s| s.entry().exposure_ms),
        },
        replicates: Vec::new(),
        geometry: ChiefRays {
            anchors_px: vec![middle],
            magnification: manifest.optics.magnification,
            dead: vec![false],
        },
        manifest,
        noise: noise.model,
        offset_dn: noise.offset_dn,
        response: noise.response,
        reading_dn2: noise.reading_dn2,
        effects: noise.bend.iter().map(bend_effect).collect(),
        light_unit: LightUnit::Dn,
        pupils: Default::default(),
        quality: Quality { maps: noise.map_errors, ..Quality::default() },
        diagnostics: Diagnostics { photon_transfer: noise.photon_transfer, ..Diagnostics::default() },
    })
}
