//! Single exposures that contradict the records.
//!
//! An exposure is doubted before the search and decided after it: an effect that the model lacks can make single frames
//! darker or brighter too. It is judged by the light of each scene under a fit of what all scenes share, which weighs
//! the pixels by their noise and knows what noise makes of it.

use super::record::{Seen, correlation, median};
use super::scene_light::{Light, logs, scatter, slopes};
use crate::data::{Fault, FaultKind, Observations};
use ommatidia_model::forward::ForwardError;

/// An exposure is doubted if the light of its frame differs from the others by more than this share, and by much more
/// than their scatter.
const LIGHT: f64 = 0.04;
/// A wrong exposure changes all parts of a frame alike: their mean factor differs from 1 by more than [`LIGHT`] as
/// well, and by so many times its standard error by their scatter. Light that falls into a frame from elsewhere is not
/// even.
const EVEN: f64 = 4.0;
/// Noise alone changes the light of a frame by less than so many standard deviations.
const NOISE: f64 = 6.0;
/// A light is doubted by so many times the scatter of the frames.
const STANDS_OUT: f64 = 12.0;
/// The regression of dim frames scatters by more than their light does: a fit is worth its time from so many times its
/// scatter on.
const MAY_STAND_OUT: f64 = 3.0;
/// Blurred images, and a fit beside the light at the borders of an object, show more than this share of the factor.
const MOST: f64 = 0.5;
/// A scene that is dark is as dark as this, relative to its prediction.
const DARK: f64 = -0.99;

/// Number of scenes of a stack that it takes to say which of them differs from the others.
const SCENES: usize = 4;

/// A wrong exposure.
pub(crate) struct Wrong {
    /// Index of the frame: its number alone names one in each stack.
    pub(crate) index: usize,
    pub(crate) fault: Fault,
}

/// Light of scenes by a regression of images, each relative to the median of its stack: a stack may have a lamp of its
/// own.
pub(crate) fn by_regression(seen: &Observations, frames: &[Seen]) -> Vec<f64> {
    let slopes: Vec<f64> = slopes(frames).into_iter().map(|[slope, _]| slope).collect();
    let stack = |i: usize| seen.frames[frames[i].frame].stack;
    let usual = |i: usize| median((0..slopes.len()).filter(|j| stack(*j) == stack(i)).map(|j| slopes[j]).collect());
    (0..slopes.len()).map(|i| slopes[i] / usual(i).filter(|v| *v > 0.0).unwrap_or(f64::NAN)).collect()
}

/// Whether a scene's light may differ from that of the others by a factor of its own, so that it is worth a fit to find
/// out. `relative` is [`by_regression`].
pub(crate) fn may_be_wrong(relative: &[f64]) -> bool {
    let by: Vec<f64> = relative.iter().filter(|v| v.is_finite()).map(|v| (v - 1.0).abs()).collect();
    let least = LIGHT.max(MAY_STAND_OUT * scatter(&by));
    tracing::debug!("light of scenes by regression, beside their median: {by:.3?}");
    by.len() >= SCENES && by.iter().any(|v| *v > least)
}

/// Finds scenes whose light differs from that of the others by a factor of their own, under a fit and in a regression
/// of images. An effect that the model lacks may do that as well, so nothing is corrected yet. `frames`, `relative`
/// ([`by_regression`]) and `light` are of the same scenes; `beside_borders` gives the light of one of them beside that
/// of the borders of its object ([`super::scene_light::beside_borders`]), which a record loses or doubles where it is
/// displaced.
///
/// # Errors
/// `beside_borders` fails.
pub(crate) fn exposures(
    seen: &Observations,
    frames: &[Seen],
    relative: &[f64],
    light: &[Light],
    beside_borders: impl Fn(usize) -> Result<[f64; 2], ForwardError>,
) -> Result<Vec<Wrong>, ForwardError> {
    let of_stack = |i: usize| {
        let stack = |s: &Seen| seen.frames[s.frame].stack;
        frames.iter().filter(|s| stack(s) == stack(&frames[i])).count()
    };
    let log_of = |by: f64| by.max(DARK).ln_1p();
    let all: Vec<f64> = light.iter().map(|l| log_of(l.by)).collect();
    let usual_log = median(all.clone()).unwrap_or(0.0);
    let logs: Vec<f64> = all.iter().map(|log| log - usual_log).collect();
    let parts: Vec<Parts<'_>> = light.iter().map(|l| Parts(&l.parts)).collect();
    // Noise alone makes the median difference two thirds of a standard error, and of few frames up to all of it.
    let by_noise = median(light.iter().map(|l| l.sigma).collect()).unwrap_or(0.0);
    let scatter = (scatter(&logs).powi(2) - by_noise.powi(2)).max(0.0).sqrt();
    // In standard errors; None: a factor of this logarithm does not stand out.
    let stands_out = |log: f64, sigma: f64| {
        let z = log.abs() * (log + usual_log).exp() / sigma;
        (z > NOISE && log.abs() > LIGHT.max(STANDS_OUT * scatter)).then_some(z)
    };
    // What the light of a scene does not explain of its excess: a scene that leaves much more than the others holds
    // something else.
    let left: Vec<f64> = light.iter().map(|l| l.excess - l.fall()).collect();
    let usually_left = median(left.clone()).unwrap_or(0.0);
    let noise = NOISE * (2.0 * (seen.sensor[0] * seen.sensor[1]) as f64).sqrt();
    let mut wrong = Vec::new();
    for (i, s) in frames.iter().enumerate() {
        let [even, error] = parts[i].factor(&parts);
        let frame = seen.frames[s.frame].info.frame;
        tracing::debug!(
            "light of frame {frame}: {:+.4} +- {:.4}, {even:.4} +- {error:.4} in its parts, left {:.0}",
            logs[i],
            light[i].sigma,
            left[i]
        );
        let Some(z) = stands_out(logs[i], light[i].sigma) else { continue };
        let factor = logs[i].exp();
        let is_even = (even - 1.0).abs() > LIGHT.max(EVEN * error);
        // Sources that are out of place seem darker in a fit, and not in images that are blurred.
        let is_in_place = (relative[i] - 1.0) / (factor - 1.0) > MOST;
        let holds_more = left[i] > usually_left + noise + light[i].fall();
        if of_stack(i) < SCENES || !is_even || !is_in_place || holds_more {
            continue;
        }
        let [by, sigma] = beside_borders(i)?;
        let log = log_of(by) - usual_log;
        tracing::debug!("beside the borders of its object: {log:+.4} +- {sigma:.4}");
        if log / logs[i] > MOST && stands_out(log, sigma).is_some() {
            let r = correlation(&s.measured, &s.own);
            let kind = FaultKind::Exposure { factor };
            let fault = Fault { frame, kind, z, correlation_before: r, correlation_after: r };
            wrong.push(Wrong { index: s.frame, fault });
        }
    }
    Ok(wrong)
}

/// Refines the factors of wrong exposures by the light of the scenes once they are corrected. Before, the pixels that
/// saturate are taken from a prediction with the wrong light, so that those of a frame that is too bright count as they
/// are cut off.
///
/// `light` is that of the scenes whose indices among the frames are given.
pub(crate) fn refine(wrong: &mut [Wrong], scenes: &[usize], light: &[Light]) {
    for (k, log) in scenes.iter().zip(logs(light)) {
        for w in wrong.iter_mut().filter(|w| w.index == *k) {
            if let FaultKind::Exposure { factor } = &mut w.fault.kind {
                *factor *= log.exp();
            }
        }
    }
}

/// The light of the parts of a frame over that of their prediction, and how much each part says of it.
struct Parts<'a>(&'a [[f64; 2]]);

impl Parts<'_> {
    /// The light of the frame relative to that of all frames, as the parts say, and its standard error from their
    /// scatter. That is 0 where the light is in one part.
    fn factor(&self, all: &[Self]) -> [f64; 2] {
        let usual = |k: usize| median(all.iter().map(|of| of.0[k]).filter(|p| p[1] > 0.0).map(|p| p[0]).collect());
        let relative: Vec<[f64; 2]> = (self.0.iter().enumerate())
            .filter_map(|(k, [slope, weight])| Some([slope / usual(k).filter(|v| *v > 0.0)?, *weight]))
            .collect();
        let sum = |of: &dyn Fn(&[f64; 2]) -> f64| relative.iter().map(of).sum::<f64>();
        let weights = sum(&|p| p[1]).max(1e-30);
        let mean = sum(&|p| p[0] * p[1]) / weights;
        let variance = sum(&|p| p[1] * (p[0] - mean).powi(2)) / weights;
        // So many parts of one weight would say as much.
        let count = weights * weights / sum(&|p| p[1] * p[1]).max(1e-30);
        [mean, if count < 1.5 { 0.0 } else { (variance / (count - 1.0)).sqrt() }]
    }
}

/// Corrects the recorded exposures of scenes.
pub(crate) fn correct_exposures(seen: &mut Observations, wrong: &[Wrong]) {
    for w in wrong {
        if let FaultKind::Exposure { factor } = w.fault.kind {
            seen.frames[w.index].info.exposure_ms *= factor;
        }
    }
}

#[cfg(test)]
pub(crate) mod tests {
    #![allow(clippy::unwrap_used)]
    use super::super::scene_light::PARTS;
    use super::*;
    use crate::data::{Frame, Shown};
    use ndarray::Array2;
    use ommatidia_session::{FrameInfo, Role};

    /// Sparse sources of a frame, as dense as `k` says, moved by some pixels.
    fn sources(k: usize, moved_px: f64) -> Array2<f32> {
        let at = |i: usize| [(i * 29 + k * 13) % 80 + 8, (i * 47 + k * 19) % 80 + 8].map(|v| v as f64 + moved_px);
        Array2::from_shape_fn((96, 96), |(r, c)| {
            let light = |i: usize| {
                let [y, x] = at(i);
                (-((r as f64 - y).powi(2) + (c as f64 - x).powi(2)) / 2.0).exp()
            };
            (0..3 + 9 * k).map(|i| 500.0 * light(i)).sum::<f64>() as f32
        })
    }

    /// Six scenes whose light is `factor` of each times what their records say.
    pub(crate) fn scenes(moved_px: f64, factor: impl Fn(usize) -> f32) -> (Observations, Vec<Seen>) {
        let seen = |k: usize| {
            let light = factor(k);
            Seen {
                frame: k,
                measured: sources(k, moved_px) * light,
                moved: None,
                own: sources(k, 0.0),
                turned: Vec::new(),
            }
        };
        let frame = |k: usize| Frame {
            stack: 0,
            role: Role::Scene,
            info: FrameInfo::plain(k, 10.0),
            measured: Array2::zeros((1, 1)),
            cut: None,
            shown: Shown::Object(k),
            held_out: false,
            previous: None,
        };
        let observations = Observations {
            frames: (0..6).map(frame).collect(),
            truths: vec![Array2::ones((8, 8)); 6],
            registrations: Vec::new(),
            pixels: Vec::new(),
            blocks: Vec::new(),
            held_out_blocks: Vec::new(),
            sensor: [96, 96],
            recorded: 0,
            not_estimated: None,
        };
        (observations, (0..6).map(seen).collect())
    }

    /// Faults of scenes with noise of 1 DN a pixel, by the light of each beside its own record.
    fn faults(observations: &Observations, seen: &[Seen]) -> Vec<Fault> {
        let light = |s: &Seen| Light::of(&s.own, &(&s.measured - &s.own), &Array2::ones(s.own.dim()));
        of(observations, seen, &seen.iter().map(light).collect::<Vec<_>>())
    }

    /// Faults of scenes whose objects have no light at their borders.
    fn of(observations: &Observations, seen: &[Seen], light: &[Light]) -> Vec<Fault> {
        let relative = by_regression(observations, seen);
        let wrong = exposures(observations, seen, &relative, light, |i| Ok([light[i].by, light[i].sigma])).unwrap();
        wrong.into_iter().map(|w| w.fault).collect()
    }

    /// The light of six dim scenes with a standard error of `sigma`, of which the third has `factor` times its own.
    /// Each part scatters by its noise; the third has `more` of chi-squared that no light explains.
    fn of_light(sigma: f64, factor: f64, more: f64) -> Vec<Light> {
        let noise = [0.3, -0.9, 0.6, 1.1, -0.2, -1.4];
        let of = |(k, noise): (usize, f64)| {
            let own = if k == 2 { factor } else { 1.0 };
            let by = own * (1.0 + noise * sigma) - 1.0;
            let of_part = |i: usize| own * (1.0 + 3.0 * sigma * noise * (((i * 5 + k) % 9) as f64 - 4.0) / 3.0);
            let parts = (0..PARTS * PARTS).map(|i| [of_part(i), 1.0 / (9.0 * sigma * sigma)]).collect();
            let excess = (by / sigma).powi(2) + if k == 2 { more } else { 0.0 };
            Light { by, sigma, excess, parts }
        };
        noise.into_iter().enumerate().map(of).collect()
    }

    #[test]
    fn a_wrong_exposure_of_a_dim_scene_is_seen_in_its_light() {
        let (observations, seen) = scenes(0.0, |k| if k == 2 { 1.25 } else { 1.0 });
        let found = |light: &[Light]| of(&observations, &seen, light);
        let faults = found(&of_light(0.025, 1.25, 0.0));
        let [Fault { frame: 2, kind: FaultKind::Exposure { factor }, z, .. }] = faults[..] else {
            panic!("{faults:?}")
        };
        assert!((factor - 1.25).abs() < 0.04 && z > NOISE, "{factor} {z}");
        // What the corrected scenes still show is a factor of its own.
        let mut refined = [Wrong { index: 2, fault: faults[0].clone() }];
        refine(&mut refined, &[0, 1, 2, 3, 4, 5], &of_light(0.0, 1.02, 0.0));
        let FaultKind::Exposure { factor: after } = refined[0].fault.kind else { panic!() };
        assert!((after / factor - 1.02).abs() < 1e-9, "{after}");
        // Of the size of the noise; small, however certain; and not the only thing that is wrong with the scene.
        assert!(found(&of_light(0.025, 1.08, 0.0)).is_empty());
        assert!(found(&of_light(0.0002, 1.03, 0.0)).is_empty());
        assert!(found(&of_light(0.025, 1.25, 1e4)).is_empty());
        // Blurred images do not show it.
        let (_, even) = scenes(0.8, |_| 1.0);
        assert!(of(&observations, &even, &of_light(0.025, 1.25, 0.0)).is_empty());
        // Beside the light at the borders of its object it has no factor, or nothing else says so.
        let light = of_light(0.025, 1.25, 0.0);
        let relative = by_regression(&observations, &seen);
        for beside in [[0.1, 0.01], [0.25, 0.05], [-0.25, 0.02]] {
            assert!(exposures(&observations, &seen, &relative, &light, |_| Ok(beside)).unwrap().is_empty());
        }
    }

    #[test]
    fn an_object_that_misses_a_source_has_no_wrong_exposure() {
        let (observations, mut seen) = scenes(0.0, |_| 1.0);
        // Of the frame of 21 sources the object misses those of one side.
        seen[2].own.slice_mut(ndarray::s![.., ..40]).fill(0.0);
        let [slope, r] = slopes(&seen)[2];
        assert!((slope - 1.0).abs() > LIGHT && r < 0.97, "{slope} {r}");
        assert!(faults(&observations, &seen).is_empty());
    }

    #[test]
    fn light_from_elsewhere_in_one_frame_is_no_wrong_exposure() {
        let (observations, mut seen) = scenes(0.0, |k| if k == 2 { 1.1 } else { 1.0 });
        assert_eq!(faults(&observations, &seen).len(), 1);
        // A gradient of light, stronger where the specimen is brighter: the slope changes by more than doubt begins at.
        let own = Array2::from_shape_fn((96, 96), |(r, c)| seen[2].own[[r, c]] * c as f32 / 48.0);
        let mean = own.mean().unwrap();
        seen[2].measured = Array2::from_shape_fn((96, 96), |(r, c)| own[[r, c]] + 0.2 * mean * c as f32 / 48.0);
        seen[2].own = own;
        let [slope, r] = slopes(&seen)[2];
        assert!(slope > 1.0 + LIGHT && r > 0.99, "{slope} {r}");
        assert!(faults(&observations, &seen).is_empty(), "{slope} {r}");
    }

    #[test]
    fn scenes_out_of_place_have_no_wrong_exposures() {
        for moved_px in [0.0, 0.8, 2.0] {
            let (observations, seen) = scenes(moved_px, |_| 1.0);
            let found = faults(&observations, &seen);
            assert!(found.is_empty(), "moved by {moved_px} px: {found:?}");
        }
        let (observations, seen) = scenes(0.0, |k| if k == 2 { 1.5 } else { 1.0 });
        let found = faults(&observations, &seen);
        let [Fault { frame: 2, kind: FaultKind::Exposure { factor }, .. }] = found[..] else { panic!("{found:?}") };
        assert!((factor - 1.5).abs() < 0.001, "{factor}");
    }

    #[test]
    fn each_stack_has_a_lamp_of_its_own() {
        let (mut observations, seen) = scenes(0.0, |k| if k < 4 { 1.0 } else { 1.5 });
        assert!(may_be_wrong(&by_regression(&observations, &seen)));
        for frame in &mut observations.frames[4..] {
            (frame.stack, frame.info.frame) = (1, frame.info.frame - 4);
        }
        assert!(!may_be_wrong(&by_regression(&observations, &seen)));
        // Two scenes do not say which of them is wrong, and a frame's number is that of one in each stack.
        let (_, seen) = scenes(0.0, |k| if k == 5 { 1.25 } else { 1.0 });
        assert!(faults(&observations, &seen).is_empty());
        let (_, seen) = scenes(0.0, |k| if k == 1 { 1.25 } else { 1.0 });
        let [fault] = &faults(&observations, &seen)[..] else { panic!() };
        correct_exposures(&mut observations, &[Wrong { index: 1, fault: fault.clone() }]);
        let exposures_ms: Vec<f64> = observations.frames.iter().map(|f| f.info.exposure_ms).collect();
        assert!((exposures_ms[1] - 12.5).abs() < 0.01 && exposures_ms[5] == 10.0, "{exposures_ms:?}");
    }
}
