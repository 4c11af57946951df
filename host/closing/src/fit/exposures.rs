//! Light that contradicts the records: single exposures, and objects in units of their own.
//!
//! An exposure is doubted before the first fit and decided after the search: an effect that the model lacks can make
//! single frames darker or brighter too. Units are corrected before: what makes all frames differ at random, by a tenth
//! and more, is no effect of an instrument.

use super::record::{SMOOTH_PX, Seen, correlation, median, slope};
use super::solve::pseudo_inverse;
use crate::data::{Fault, FaultKind, Frame, Observations, Shown};
use ndarray::{Array1, Array2, ArrayView1};
use ommatidia_physics::effects::blur_within;
use rayon::prelude::*;

/// An exposure is doubted if the light of its frame differs from the others by more than this share, and by much more
/// than their scatter.
const LIGHT: f64 = 0.04;
/// Objects have units of their own if the light of the frames relative to them scatters by more than this share
/// (median), and what may explain that ([`is_explained`]) leaves no less than [`UNEXPLAINED`] of it.
const SCATTER: f64 = 0.1;
const UNEXPLAINED: f64 = 0.3;
/// Number of scenes that this takes.
pub(super) const SCENES: usize = 6;
/// Number of scenes from which a falloff of the light has a centre of its own.
const CENTRED: usize = 8;
/// Correlation with the objects that it takes.
pub(super) const ALIKE: f64 = 0.8;
/// A wrong exposure changes the light of a frame and not its form: the frame leaves at most so many times the variance
/// that the scenes usually leave, and this much of its own. What misses a source at its edge leaves more.
const AS_USUAL: f64 = 4.0;
const SLACK: f64 = 0.01;
/// It changes all parts of a frame alike: their mean factor, of [`PARTS`] x [`PARTS`] parts, differs from 1 by more
/// than [`LIGHT`] as well, and by so many times its standard error by their scatter. Light that falls into a frame from
/// elsewhere is not even.
const EVEN: f64 = 4.0;
const PARTS: usize = 3;

/// Light of each frame over that of its record, both blurred, and their correlation. The regression has an intercept,
/// so that an even background is no light of the specimen.
fn slopes(frames: &[Seen]) -> Vec<[f64; 2]> {
    let of = |s: &Seen| {
        let [y, m] = [&s.measured, &s.own].map(|image| blur_within(image, SMOOTH_PX));
        [slope(&y, &m), correlation(&y, &m)]
    };
    frames.par_iter().map(of).collect()
}

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

/// Median of the sizes of some values.
pub(super) fn scatter(values: &[f64]) -> f64 {
    median(values.iter().map(|v| v.abs()).collect()).unwrap_or(0.0)
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

/// Finds scenes whose light differs from that of the others by a factor of their own. An effect that the model lacks
/// may do that as well, so nothing is corrected yet.
pub fn exposures(seen: &Observations, frames: &[Seen]) -> Vec<Fault> {
    let mut faults = Vec::new();
    let (slopes, alike): (Vec<f64>, Vec<f64>) = slopes(frames).into_iter().map(|[slope, r]| (slope, r)).unzip();
    if slopes.len() < 4 {
        return faults;
    }
    let usual = median(slopes.clone()).unwrap_or(1.0);
    let scatter = median(slopes.iter().map(|v| (v / usual - 1.0).abs()).collect()).unwrap_or(0.0);
    let usually_left = median(alike.iter().map(|r| 1.0 - r).collect()).unwrap_or(0.0);
    // What does not look like its object has no light relative to it.
    let looks_like_it = |r: f64| r > ALIKE && 1.0 - r < AS_USUAL * usually_left + SLACK;
    let unlike = |factor: f64| (factor - 1.0).abs();
    // One frame against all others: a drift of the lamp changes all of them.
    let stands_out = |i: usize, factor: f64| {
        looks_like_it(alike[i]) && unlike(factor) > LIGHT.max(12.0 * scatter) + at_the_border(seen, frames[i].frame)
    };
    let factors: Vec<f64> = slopes.iter().map(|slope| slope / usual).collect();
    if !factors.iter().enumerate().any(|(i, factor)| stands_out(i, *factor)) {
        return faults;
    }
    let parts: Vec<Parts> = frames.par_iter().map(Parts::of).collect();
    for (i, (s, factor)) in frames.iter().zip(factors).enumerate() {
        let [even, error] = parts[i].factor(&parts);
        if stands_out(i, factor) && unlike(even) > LIGHT.max(EVEN * error) {
            let r = correlation(&s.measured, &s.own);
            let kind = FaultKind::Exposure { factor };
            faults.push(Fault {
                frame: seen.frames[s.frame].info.frame,
                kind,
                z: (factor - 1.0).abs() / scatter.max(1e-4),
                correlation_before: r,
                correlation_after: r,
            });
        }
    }
    faults
}

/// The light of the parts of a frame over that of its record, and how much each part says of it.
struct Parts(Vec<[f64; 2]>);

impl Parts {
    fn of(s: &Seen) -> Self {
        let [y, m] = [&s.measured, &s.own].map(|image| blur_within(image, SMOOTH_PX));
        let (rows, cols) = m.dim();
        let part = |i: usize, n: usize| i * n / PARTS..(i + 1) * n / PARTS;
        let of = |k: usize| {
            let at = ndarray::s![part(k / PARTS, rows), part(k % PARTS, cols)];
            let (y, m) = (y.slice(at).to_owned(), m.slice(at).to_owned());
            let weight = m.len() as f64 * f64::from(m.var(0.0));
            [if weight > 0.0 { slope(&y, &m) } else { 1.0 }, weight]
        };
        Self((0..PARTS * PARTS).map(of).collect())
    }

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

/// Share of the light of a frame's object that its record loses, or has too much of, where it is displaced by up to a
/// pixel: that of the brighter one of the first and the last row, and of the first and the last column. The exposure is
/// not wrong for it. The regression counts places by the square of their light.
fn at_the_border(seen: &Observations, frame: usize) -> f64 {
    let Shown::Object(truth) = seen.frames[frame].shown else { return 0.0 };
    let object = &seen.truths[truth];
    let (rows, cols) = object.dim();
    let share = |power: i32| {
        let sum = |line: ArrayView1<'_, f32>| line.iter().map(|v| f64::from(*v).powi(power)).sum::<f64>();
        let [top, bottom, left, right] =
            [object.row(0), object.row(rows - 1), object.column(0), object.column(cols - 1)].map(sum);
        let all: f64 = object.rows().into_iter().map(sum).sum();
        (top.max(bottom) + left.max(right)) / all.max(1e-30)
    };
    share(1).max(share(2))
}

/// Corrects the recorded exposures of scenes.
pub fn correct_exposures(seen: &mut Observations, faults: &[Fault]) {
    for fault in faults {
        let FaultKind::Exposure { factor } = fault.kind else { continue };
        let of = |f: &&mut Frame| f.info.frame == fault.frame && matches!(f.shown, Shown::Object(_));
        seen.frames.iter_mut().filter(of).for_each(|f| f.info.exposure_ms *= factor);
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
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
    fn scenes(moved_px: f64, factor: impl Fn(usize) -> f32) -> (Observations, Vec<Seen>) {
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

    fn faults(moved_px: f64, factor: f32) -> Vec<Fault> {
        let (observations, seen) = scenes(moved_px, |k| if k == 2 { factor } else { 1.0 });
        exposures(&observations, &seen)
    }

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

    #[test]
    fn an_object_that_misses_a_source_has_no_wrong_exposure() {
        let (observations, mut seen) = scenes(0.0, |_| 1.0);
        // Of the frame of 21 sources the object misses those of one side.
        seen[2].own.slice_mut(ndarray::s![.., ..40]).fill(0.0);
        let [slope, r] = slopes(&seen)[2];
        assert!((slope - 1.0).abs() > LIGHT && r < 0.97, "{slope} {r}");
        assert!(exposures(&observations, &seen).is_empty());
    }

    #[test]
    fn light_from_elsewhere_in_one_frame_is_no_wrong_exposure() {
        let (mut observations, mut seen) = scenes(0.0, |k| if k == 2 { 1.1 } else { 1.0 });
        for truth in &mut observations.truths {
            truth.fill(0.0);
            truth[[4, 4]] = 1.0;
        }
        assert_eq!(exposures(&observations, &seen).len(), 1);
        // A gradient of light, stronger where the specimen is brighter: the slope changes by more than doubt begins at.
        let own = Array2::from_shape_fn((96, 96), |(r, c)| seen[2].own[[r, c]] * c as f32 / 48.0);
        let mean = own.mean().unwrap();
        seen[2].measured = Array2::from_shape_fn((96, 96), |(r, c)| own[[r, c]] + 0.2 * mean * c as f32 / 48.0);
        seen[2].own = own;
        let [slope, r] = slopes(&seen)[2];
        assert!(slope > 1.0 + LIGHT && r > 1.0 - SLACK, "{slope} {r}");
        assert!(exposures(&observations, &seen).is_empty(), "{slope} {r}");
    }

    #[test]
    fn light_at_the_border_of_a_record_is_no_wrong_exposure() {
        let (mut observations, seen) = scenes(0.0, |k| if k == 2 { 1.2 } else { 1.0 });
        for truth in &mut observations.truths {
            truth.fill(0.0);
            truth[[4, 4]] = 1.0;
        }
        assert_eq!(exposures(&observations, &seen).len(), 1);
        // A third of its light in the first row.
        observations.truths[2][[0, 3]] = 0.5;
        assert!((at_the_border(&observations, 2) - 1.0 / 3.0).abs() < 1e-9);
        assert!(exposures(&observations, &seen).is_empty());
    }

    #[test]
    fn frames_out_of_place_are_no_faults_of_exposure() {
        for moved_px in [0.0, 0.8, 2.0] {
            assert!(faults(moved_px, 1.0).is_empty(), "moved by {moved_px} px: {:?}", faults(moved_px, 1.0));
        }
        for moved_px in [0.0, 0.8] {
            let found = faults(moved_px, 1.5);
            let [Fault { frame: 2, kind: FaultKind::Exposure { factor }, .. }] = found[..] else {
                panic!("moved by {moved_px} px: {found:?}")
            };
            assert!((factor - 1.5).abs() < 0.05, "{factor}");
        }
    }
}
