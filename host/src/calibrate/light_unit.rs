//! The unit of light in objects: the bead, or the unit of the scene truths.

use super::error::CalibrateError;
use crate::effects::FrameContext;
use crate::forward::Forward;
use crate::instrument::{Instrument, LightUnit};
use crate::psf::OperatorConfig;
use crate::session::{Role, Session};
use std::collections::btree_map::{BTreeMap, Entry};

/// Largest number of scene frames with truth that the light unit is fitted to.
const UNIT_FRAMES: usize = 16;

/// Fits the light of one truth unit in units of the bead: the slope of measured against predicted light, pooled over
/// the scenes with truth. Each frame has an intercept of its own, so that a uniform background has no influence. None
/// where there are no such scenes or no light in them.
///
/// The weights come from the prediction alone, never from the noisy frame, so the slope is unbiased.
pub(super) fn fit_light_unit(session: &Session, instrument: &Instrument) -> Result<Option<f64>, CalibrateError> {
    let noise = &instrument.noise;
    let mut at_depths: BTreeMap<usize, Forward> = BTreeMap::new();
    let (mut top, mut bottom) = (0.0, 0.0);
    for stack in session.stacks_of(Role::Scene) {
        let Some(mut truths) = stack.truth()? else { continue };
        let mut frames = stack.frames()?;
        for info in stack.info().iter().take(UNIT_FRAMES) {
            let (mut frame, object) = (frames.read(info.frame)?, truths.read(info.frame)?);
            let depth = instrument.psf.depth_nearest(info.z_um);
            let forward = match at_depths.entry(depth) {
                Entry::Occupied(planned) => planned.into_mut(),
                Entry::Vacant(place) => {
                    let config = OperatorConfig { depth, ..OperatorConfig::default() };
                    place.insert(Forward::with_config(instrument, config)?)
                }
            };
            let cx =
                FrameContext { exposure_ms: info.exposure_ms, illumination: info.illumination, ..forward.context() };
            let light_e = forward.expected_e(object.view(), &cx)?;
            if let Some(offset) = &instrument.offset_dn {
                frame -= offset;
            }
            let pairs = light_e.iter().zip(&frame).filter(|(_, y)| f64::from(**y) < noise.saturation_dn);
            let (covariance, variance) = moments(
                pairs.map(|(e, y)| (f64::from(*e) * noise.gain_dn_per_e, f64::from(*y) - noise.black_level_dn)),
            );
            top += covariance;
            bottom += variance;
        }
    }
    Ok((bottom > 0.0 && top > 0.0).then_some(top / bottom))
}

/// Sums of `(x - mean x)(y - mean y)` and `(x - mean x)^2`.
fn moments(pairs: impl Iterator<Item = (f64, f64)>) -> (f64, f64) {
    let mut s = [0.0; 5];
    for (x, y) in pairs {
        for (sum, v) in s.iter_mut().zip([1.0, x, y, x * y, x * x]) {
            *sum += v;
        }
    }
    let n = f64::max(s[0], 1.0);
    (s[3] - s[1] * s[2] / n, s[4] - s[1] * s[1] / n)
}

/// Changes the unit of objects to truth units; one truth unit is `old_per_unit` old units.
pub(super) fn set_light_unit(instrument: &mut Instrument, old_per_unit: f64) {
    for psf in std::iter::once(&mut instrument.psf).chain(&mut instrument.replicates) {
        psf.coefficients.mapv_inplace(|v| (f64::from(v) * old_per_unit) as f32);
    }
    instrument.light_unit = LightUnit::Truth { per_bead: 1.0 / old_per_unit };
}
