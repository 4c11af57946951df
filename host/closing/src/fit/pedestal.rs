//! Objects with a pedestal: their darkest places are not dark, because the camera that took them was read with its
//! black level, for example.

use super::model::Model;
use super::record::{Seen, median};
use super::solve::pseudo_inverse;
use super::state::State;
use crate::data::{Fault, FaultKind, Observations, Shown};
use ndarray::{Array1, Array2};
use ommatidia_model::forward::ForwardError;
use rayon::prelude::*;
use std::sync::Arc;

/// Number of scenes that this takes.
const SCENES: usize = 4;
/// A pedestal is at least this share of the objects' maximum (median).
const LEAST: f64 = 0.003;
/// Without it the light that the objects do not explain falls to at most this share (median).
const FALL: f64 = 0.5;
/// In this share of the scenes its size is within half of the median.
const COMMON: f64 = 0.75;

/// What a scene shows of a pedestal.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sign {
    /// Its level, in the unit of the objects.
    level: f64,
    /// What is left of the squared residual without it.
    left: f64,
}

/// What the light of an even object depends on.
#[derive(PartialEq)]
struct Light {
    stack: usize,
    exposure_ms: f64,
    illumination: f64,
}

/// Light of an even object of one unit in each scene with a known object, DN, [sensor rows, sensor cols]. Scenes of one
/// stack with the same light share an image: what effects change from frame to frame is small beside a pedestal.
///
/// # Errors
/// The parts of the model disagree.
pub fn even_light(model: &Model<'_>, state: &State, frames: &[Seen]) -> Result<Vec<Arc<Array2<f32>>>, ForwardError> {
    let chain = model.chain(&state.terms);
    let gain = model.forward.noise().gain_dn_per_e as f32;
    let mut known: Vec<(Light, Arc<Array2<f32>>)> = Vec::new();
    let mut one = |s: &Seen| {
        let frame = &model.seen.frames[s.frame];
        let Shown::Object(truth) = frame.shown else { return Ok(Arc::new(Array2::zeros(s.own.dim()))) };
        let light =
            Light { stack: frame.stack, exposure_ms: frame.info.exposure_ms, illumination: frame.info.illumination };
        if let Some((_, image)) = known.iter().find(|(of, _)| *of == light) {
            return Ok(Arc::clone(image));
        }
        let cx = model.context(s.frame, None);
        let scene = model.forward.scene(Array2::ones(model.seen.truths[truth].dim()).view(), &chain, &cx)?;
        let image = Arc::new(model.forward.light_e(&scene, &chain, &cx).mapv(|e| e * gain));
        known.push((light, Arc::clone(&image)));
        Ok(image)
    };
    frames.iter().map(&mut one).collect()
}

/// Fits `measured = a own + b even + c` by least squares, with the variance of light as weight: a pedestal is -b / a.
/// None: the three cannot be told apart, or the light of the object is not in the frame.
pub fn sign(measured: &Array2<f32>, own: &Array2<f32>, even: &Array2<f32>) -> Option<Sign> {
    let floor = 1e-3 * own.iter().fold(0.0f32, |m, v| m.max(*v)).max(1e-3);
    let sums = |with_even: bool| -> Option<(Array1<f64>, f64)> {
        let n = if with_even { 3 } else { 2 };
        let (mut gram, mut right, mut total) = (Array2::<f64>::zeros((n, n)), Array1::<f64>::zeros(n), 0.0);
        for ((y, m), e) in measured.iter().zip(own).zip(even) {
            let w = f64::from(1.0 / (m.max(0.0) + floor));
            let x = [f64::from(*m), 1.0, f64::from(*e)];
            for i in 0..n {
                right[i] += w * x[i] * f64::from(*y);
                (0..n).for_each(|j| gram[[i, j]] += w * x[i] * x[j]);
            }
            total += w * f64::from(*y).powi(2);
        }
        let values = pseudo_inverse(&gram).dot(&right);
        (values[0] > 0.0).then(|| (values.clone(), (total - values.dot(&right)).max(0.0)))
    };
    let ((_, without), (values, with)) = (sums(false)?, sums(true)?);
    Some(Sign { level: -values[2] / values[0], left: if without > 0.0 { with / without } else { 1.0 } })
}

/// Finds objects with a pedestal common to all scenes, and takes it from them: no light is negative, so that an object
/// which predicts too much everywhere is brighter than its specimen everywhere. `even` are the images of
/// [`even_light`].
pub fn pedestals(seen: &mut Observations, frames: &[Seen], even: &[Arc<Array2<f32>>]) -> Vec<Fault> {
    let signs: Vec<Option<Sign>> =
        frames.par_iter().zip(even).map(|(s, even)| sign(&s.measured, &s.own, even)).collect();
    let known: Vec<Sign> = signs.into_iter().flatten().collect();
    let of = |value: &dyn Fn(&Sign) -> f64| median(known.iter().map(value).collect()).unwrap_or(0.0);
    let (level, left) = (of(&|s| s.level), of(&|s| s.left));
    let tops = frames.iter().filter_map(|s| match seen.frames[s.frame].shown {
        Shown::Object(truth) => Some(f64::from(seen.truths[truth].iter().fold(0.0f32, |m, v| m.max(*v)))),
        _ => None,
    });
    let top = median(tops.collect()).unwrap_or(0.0);
    let alike = known.iter().filter(|s| (s.level - level).abs() < 0.5 * level).count() as f64;
    let common = known.len() >= SCENES && alike >= COMMON * frames.len() as f64;
    if !(common && level > LEAST * top && left < FALL) {
        return Vec::new();
    }
    let mut faults = Vec::new();
    for s in frames {
        let Shown::Object(truth) = seen.frames[s.frame].shown else { continue };
        let without = seen.truths[truth].mapv(|v| (v - level as f32).max(0.0));
        seen.truths.push(without);
        seen.frames[s.frame].shown = Shown::Object(seen.truths.len() - 1);
        let r = super::record::correlation(&s.measured, &s.own);
        faults.push(Fault {
            frame: seen.frames[s.frame].info.frame,
            kind: FaultKind::Pedestal { level },
            z: (s.measured.len() as f64 * (1.0 / left - 1.0)).sqrt(),
            correlation_before: r,
            correlation_after: r,
        });
    }
    faults
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;

    /// Light of a few foci, of an even object, and a deterministic scatter of 1 DN.
    fn parts() -> [Array2<f32>; 3] {
        let foci = Array2::from_shape_fn((48, 48), |(r, c)| {
            let light = |i: usize| {
                let [y, x] = [(i * 17 % 40 + 4) as f32, (i * 29 % 40 + 4) as f32];
                (-((r as f32 - y).powi(2) + (c as f32 - x).powi(2)) / 4.0).exp()
            };
            (0..6).map(|i| 400.0 * light(i)).sum::<f32>()
        });
        let even = Array2::from_shape_fn((48, 48), |(r, c)| {
            800.0 * (-((r as f32 - 24.0).powi(2) + (c as f32 - 24.0).powi(2)) / 900.0).exp()
        });
        let scatter = Array2::from_shape_fn((48, 48), |(r, c)| ((r * 31 + c * 17) % 7) as f32 / 3.0 - 1.0);
        [foci, even, scatter]
    }

    #[test]
    fn a_pedestal_is_measured_and_backgrounds_of_other_kinds_are_none() {
        let [foci, even, scatter] = parts();
        // The object has 0.03 too much everywhere; the frame is 5 DN above its black level besides.
        let own = &foci + &(&even * 0.03);
        let found = sign(&(&(&foci * 1.2) + &scatter + 5.0), &own, &even).unwrap();
        assert!((found.level - 0.03).abs() < 1e-3 && found.left < 0.1, "{found:?}");
        // Nothing wrong, more light than expected, and another black level.
        let level = |measured: Array2<f32>| sign(&measured, &foci, &even).unwrap();
        assert!(level(&foci + &scatter).left > 0.9);
        assert!(level(&(&foci + &scatter) + &(&even * 0.02)).level < 0.0);
        assert!(level(&foci + &scatter - 9.0).left > 0.9);
    }
}
