//! Objects in units of light of their own.
//!
//! They are corrected before the first fit: what makes all frames differ at random, by a tenth and more, is no effect
//! of an instrument.

use super::record::{SMOOTH_PX, Seen, correlation, median};
use super::scene_light::{ALIKE, scatter, slopes};
use super::solve::pseudo_inverse;
use crate::data::{Fault, FaultKind, Observations, Shown};
use ndarray::{Array1, Array2};
use ommatidia_physics::effects::blur_within;

/// Objects have units of their own if the light of the frames relative to them scatters by more than this share
/// (median), and what may explain that ([`is_explained`]) leaves no less than [`UNEXPLAINED`] of it.
const SCATTER: f64 = 0.1;
const UNEXPLAINED: f64 = 0.3;
/// Number of scenes that this takes.
pub(super) const SCENES: usize = 6;
/// Number of scenes from which a falloff of the light has a centre of its own.
const CENTRED: usize = 8;

/// Finds scenes whose objects are recorded in units of light of their own, and corrects the observations: the light of
/// nearly all frames differs from that of their objects by a factor that follows neither their order nor their
/// exposure.
pub fn units(seen: &mut Observations, frames: &[Seen]) -> Vec<Fault> {
    let slopes = slopes(frames);
    let alike = median(slopes.iter().map(|s| s[1]).collect()).unwrap_or(0.0);
    if frames.len() < SCENES || alike < ALIKE || slopes.iter().any(|s| s[0] <= 0.0) {
        return Vec::new();
    }
    let all: Vec<f64> = slopes.iter().map(|s| s[0].ln()).collect();
    let usual = median(all.clone()).unwrap_or(0.0);
    let logs: Vec<f64> = all.iter().map(|v| v - usual).collect();
    if scatter(&logs) < SCATTER || is_explained(seen, frames, &logs) {
        return Vec::new();
    }
    let factors: Vec<f64> = logs.iter().map(|log| log.exp()).collect();
    let z = |i: usize| logs[i].abs() / (1.0 - slopes[i][1].powi(2)).max(1e-6).sqrt();
    scaled(seen, frames, &factors, z)
}

/// Gives each scene its own unit of light: `factors` of its object, as certain as `z` says, in standard deviations.
pub(super) fn scaled(
    seen: &mut Observations,
    frames: &[Seen],
    factors: &[f64],
    z: impl Fn(usize) -> f64,
) -> Vec<Fault> {
    let mut faults = Vec::new();
    for (i, (s, factor)) in frames.iter().zip(factors).enumerate() {
        let Shown::Object(truth) = seen.frames[s.frame].shown else { continue };
        seen.truths.push(seen.truths[truth].mapv(|v| v * *factor as f32));
        seen.frames[s.frame].shown = Shown::Object(seen.truths.len() - 1);
        let r = correlation(&blur_within(&s.measured, SMOOTH_PX), &blur_within(&s.own, SMOOTH_PX));
        faults.push(Fault {
            frame: seen.frames[s.frame].info.frame,
            kind: FaultKind::Unit { factor: *factor },
            z: z(i),
            correlation_before: r,
            correlation_after: r,
        });
    }
    faults
}

/// Whether a drift with the exposures, a lamp that alternates, the places of the light or its level leave little of the
/// differences between the light of scenes, whose logarithms are given.
pub(super) fn is_explained(seen: &Observations, frames: &[Seen], logs: &[f64]) -> bool {
    // A falloff is linear in the light itself.
    let factors: Vec<f64> = logs.iter().map(|v| v.exp() - 1.0).collect();
    let all = scatter(logs);
    let left = [
        unexplained(seen, frames, logs),
        beside_alternation(seen, frames, logs),
        beside_places(seen, frames, &factors),
        beside_levels(seen, frames, &factors),
    ];
    // Values that are fitted leave less of what they do not explain, too.
    let n = frames.len() as f64;
    let left = left.map(|(left, fitted)| scatter(&left) * (n / (n - fitted as f64).max(1.0)).sqrt());
    left.iter().any(|left| *left < UNEXPLAINED * all)
}

/// What a drift (a parabola over the frames) and an error of the exposures do not explain of some values of the frames.
fn unexplained(seen: &Observations, frames: &[Seen], values: &[f64]) -> (Vec<f64>, usize) {
    let of = |s: &Seen| {
        let info = &seen.frames[s.frame].info;
        let t = info.frame as f64 / frames.len() as f64;
        [1.0, t, t * t, 1.0 / info.exposure_ms.max(1e-9)]
    };
    let rows: Vec<[f64; 4]> = frames.iter().map(of).collect();
    left_by(&Array2::from_shape_fn((rows.len(), 4), |(i, j)| rows[i][j]), values)
}

/// What a lamp that alternates from frame to frame does not explain of some values of the frames.
fn beside_alternation(seen: &Observations, frames: &[Seen], values: &[f64]) -> (Vec<f64>, usize) {
    let odd = |s: &Seen| seen.frames[s.frame].info.frame % 2;
    let mean = |parity: usize| {
        let of = frames.iter().zip(values).filter(|(s, _)| odd(s) == parity).map(|(_, v)| *v);
        let (n, sum) = of.fold((0.0, 0.0), |(n, sum), v| (n + 1.0, sum + v));
        sum / f64::max(n, 1.0)
    };
    let means = [mean(0), mean(1)];
    (frames.iter().zip(values).map(|(s, v)| v - means[odd(s)]).collect(), means.len())
}

/// What the places of the light in the objects do not explain of some values of the frames. Where the light falls off
/// over the field, objects at its rim seem darker than those in its middle. As in a regression of images, places count
/// by the square of their light.
fn beside_places(seen: &Observations, frames: &[Seen], values: &[f64]) -> (Vec<f64>, usize) {
    let of = |s: &Seen| -> [f64; 4] {
        let Shown::Object(truth) = seen.frames[s.frame].shown else { return [1.0, 0.0, 0.0, 0.0] };
        let object = &seen.truths[truth];
        let (rows, cols) = object.dim();
        let at = |i: usize, n: usize| (2.0 * i as f64 + 1.0) / n as f64 - 1.0;
        let mut sums = [0.0; 4];
        for ((r, c), light) in object.indexed_iter() {
            let (y, x, weight) = (at(r, rows), at(c, cols), f64::from(*light).powi(2));
            for (sum, v) in sums.iter_mut().zip([1.0, y * y + x * x, y, x]) {
                *sum += weight * v;
            }
        }
        let all = sums[0].max(1e-30);
        sums.map(|v| v / all)
    };
    // With few frames the place of the centre would explain too much by chance.
    let terms = if frames.len() < CENTRED { 2 } else { 4 };
    let rows: Vec<[f64; 4]> = frames.iter().map(of).collect();
    left_by(&Array2::from_shape_fn((rows.len(), terms), |(i, j)| rows[i][j]), values)
}

/// What the light of the objects does not explain of some values of the frames: a sensor that is not linear makes
/// bright frames too bright or too dark.
fn beside_levels(seen: &Observations, frames: &[Seen], values: &[f64]) -> (Vec<f64>, usize) {
    let of = |s: &Seen| {
        let Shown::Object(truth) = seen.frames[s.frame].shown else { return [0.0; 2] };
        let [sum, squares] = [1, 2].map(|p| seen.truths[truth].iter().map(|v| f64::from(*v).powi(p)).sum::<f64>());
        [sum, squares / sum.max(1e-30)].map(|v| v * seen.frames[s.frame].info.exposure_ms)
    };
    let levels: Vec<[f64; 2]> = frames.iter().map(of).collect();
    let most = [0, 1].map(|i| levels.iter().map(|l| l[i]).fold(1e-30, f64::max));
    // The light of a whole frame, and that of the pixels that hold most of it.
    let x = Array2::from_shape_fn((levels.len(), 3), |(i, j)| j.checked_sub(1).map_or(1.0, |j| levels[i][j] / most[j]));
    left_by(&x, values)
}

/// What a linear regression on the columns of `x` [values, columns] leaves of some values, and the number of values
/// that it fits.
fn left_by(x: &Array2<f64>, values: &[f64]) -> (Vec<f64>, usize) {
    let y = Array1::from_vec(values.to_vec());
    let fit = x.dot(&pseudo_inverse(&x.t().dot(x)).dot(&x.t().dot(&y)));
    ((y - fit).to_vec(), x.ncols())
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::super::exposures::tests::scenes;
    use super::*;

    #[test]
    fn objects_that_were_scaled_one_by_one_are_scaled_back() {
        let own = [1.0, 2.5, 0.6, 1.4, 0.8, 3.1];
        let (mut observations, seen) = scenes(0.8, |k| own[k]);
        let found = units(&mut observations, &seen);
        let factors: Vec<f64> = found
            .iter()
            .map(|f| match f.kind {
                FaultKind::Unit { factor } => factor,
                _ => panic!("{f:?}"),
            })
            .collect();
        assert_eq!(factors.len(), 6);
        // Relative to the median, 1.4.
        for (k, (factor, own)) in factors.iter().zip(own).enumerate() {
            assert!((factor * 1.4 / f64::from(own) - 1.0).abs() < 0.05, "{factors:?}");
            let Shown::Object(truth) = observations.frames[k].shown else { panic!("no object") };
            assert!((f64::from(observations.truths[truth][[0, 0]]) - factor).abs() < 1e-6);
        }
    }

    #[test]
    fn light_that_fades_and_one_wrong_exposure_are_no_units() {
        let alternates = |k: usize| if k.is_multiple_of(2) { 1.3 } else { 1.0 };
        let one = |k: usize| if k == 2 { 2.0 } else { 1.0 };
        for factor in [|k: usize| 0.7f32.powi(k as i32), one, alternates, |_| 1.0] {
            let (mut observations, seen) = scenes(0.0, factor);
            assert!(units(&mut observations, &seen).is_empty());
        }
    }

    /// Objects whose light lies at places of their own, under light that falls off over the field.
    #[test]
    fn light_that_falls_off_over_the_field_is_no_unit() {
        let places = [[3, 4], [1, 6], [4, 3], [0, 0], [6, 5], [2, 2]];
        let at = |i: usize| (2 * i + 1) as f64 / 8.0 - 1.0;
        let light = |k: usize| {
            let [y, x] = places[k].map(at);
            (1.0 - 0.4 * (y * y + x * x)) as f32
        };
        let (mut observations, seen) = scenes(0.0, light);
        for (truth, place) in observations.truths.iter_mut().zip(places) {
            truth.fill(0.0);
            truth[place] = 1.0;
        }
        assert!(units(&mut observations, &seen).is_empty());
        // The same factors on objects that fill the field alike are units.
        let (mut observations, seen) = scenes(0.0, light);
        assert_eq!(units(&mut observations, &seen).len(), 6);
    }
}
