//! The unit of light in objects: the bead, or the unit of the scene truths.

use super::error::CalibrateError;
use crate::forward::Forward;
use crate::instrument::{Instrument, LightUnit};
use crate::psf::OperatorConfig;
use crate::slopes::slope_terms;
use ndarray::Array2;
use ommatidia_physics::effects::FrameContext;
use ommatidia_physics::linalg::least_squares;
use ommatidia_session::{Role, Session};
use std::collections::btree_map::{BTreeMap, Entry};

/// Largest number of scene frames with truth that the light unit is fitted to.
const UNIT_FRAMES: usize = 16;

/// Fits the light of one truth unit in units of the bead: the slope of measured against predicted light, pooled over
/// the scenes with truth. Each frame has a level and slopes of its own, so that a background has no influence. None
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
        for info in stack.whole().take(UNIT_FRAMES) {
            let (mut frame, object) = (frames.read(info.frame)?, truths.read(info.frame)?);
            let depth = instrument.psf.depth_nearest(info.z_um);
            let forward = match at_depths.entry(depth) {
                Entry::Occupied(planned) => planned.into_mut(),
                Entry::Vacant(place) => place.insert(Forward::with_config(instrument, OperatorConfig::exact(depth))?),
            };
            let cx =
                FrameContext { exposure_ms: info.exposure_ms, illumination: info.illumination, ..forward.context() };
            let light_e = forward.expected_e(object.view(), &cx)?;
            if let Some(offset) = &instrument.offset_dn {
                frame -= offset;
            }
            let gain = noise.gain_dn_per_e;
            let pairs = light_e.indexed_iter().zip(&frame).filter(|(_, y)| f64::from(**y) < noise.saturation_dn);
            let (covariance, variance) = moments(frame.dim(), || {
                pairs.clone().map(|((at, e), y)| (at, f64::from(*e) * gain, f64::from(*y) - noise.black_level_dn))
            });
            top += covariance;
            bottom += variance;
        }
    }
    Ok((bottom > 0.0 && top > 0.0).then_some(top / bottom))
}

/// Sums of `x' y` and `x' x`, where x' is x less its level and slopes over the frame: what is left of x has no
/// background in common with y.
fn moments<I>(dim: (usize, usize), pairs: impl Fn() -> I) -> (f64, f64)
where
    I: Iterator<Item = ((usize, usize), f64, f64)>,
{
    let mut gram = Array2::<f64>::zeros((3, 3));
    let mut right = Array2::<f64>::zeros((3, 1));
    for ((r, c), x, _) in pairs() {
        let t = slope_terms(dim, [r, c]);
        for i in 0..3 {
            right[[i, 0]] += t[i] * x;
            (0..3).for_each(|j| gram[[i, j]] += t[i] * t[j]);
        }
    }
    let Ok(fit) = least_squares(&gram, &right) else { return (0.0, 0.0) };
    pairs().fold((0.0, 0.0), |(xy, xx), ((r, c), x, y)| {
        let rest = x - slope_terms(dim, [r, c]).iter().zip(&fit).map(|(t, f)| t * f).sum::<f64>();
        (xy + rest * y, xx + rest * rest)
    })
}

/// Changes the unit of objects to truth units; one truth unit is `old_per_unit` old units.
pub(super) fn set_light_unit(instrument: &mut Instrument, old_per_unit: f64) {
    for psf in std::iter::once(&mut instrument.psf).chain(&mut instrument.replicates) {
        psf.coefficients.mapv_inplace(|v| (f64::from(v) * old_per_unit) as f32);
    }
    instrument.light_unit = LightUnit::Truth { per_bead: 1.0 / old_per_unit };
}
