//! Screening of the records: finds frames that contradict what the session states of their objects. It is done before
//! the first fit, since a wrong object spoils every fit.

use super::model::Model;
use super::state::State;
use crate::data::{Fault, FaultKind, Observations, ScenesShow, Shown};
use ndarray::{Array2, Axis};
use ommatidia_model::forward::ForwardError;
use ommatidia_model::metrics::Moments;
use ommatidia_physics::effects::{blur_within, displacement_px};
use rayon::prelude::*;

/// Another record is accepted if it leaves less than this share of the unexplained variance (1 - correlation).
const BETTER: f64 = 0.5;
/// A scene fits another record if it leaves at most so many times the variance that the scenes usually leave, and this
/// much of its own.
const AS_USUAL: f64 = 4.0;
const SLACK: f64 = 0.05;
/// What correlates with a record by less does not show its object, however badly it fits its own: under strong blur
/// every smooth object fits every scene in part.
const ALIKE: f64 = 0.85;
/// A scene that leaves so many times that variance may show none of the objects.
const UNLIKE: f64 = 10.0;
/// Scenes that usually correlate with their records by more than this are where they are expected.
pub(super) const IN_PLACE: f64 = 0.9;
/// Number of scenes by which a common displacement is found.
const LOOKED_AT: usize = 12;
/// Standard deviation of the Gaussian blur before the light of a frame is compared with its record, pixels: frames of
/// sparse sources correlate less with a model that is out of place by a few pixels, and must not seem darker for it.
pub(super) const SMOOTH_PX: f64 = 6.0;

/// A scene holds the light of its own object where the slope against its record differs from that of the others by at
/// most this share, and its correlation exceeds the second: something was added to it, and it is not another object.
const OWN_LIGHT: f64 = 0.1;
const IN_PART: f64 = 0.5;
/// A pixel counts as saturated from this share of full scale on.
const SATURATED: f64 = 0.98;
/// A frame with a smaller share of other pixels says nothing of its record.
const OPEN: f64 = 0.25;
/// Share of full scale from which on a pixel may saturate where its record does.
const BRIGHT: f32 = 0.5;
/// Rounds in which the light of a frame and its saturated pixels are found: each depends on the other.
const ROUNDS: usize = 4;

/// A scene as measured and as its records predict it: light above the black level, DN, [sensor rows, sensor cols].
pub struct Seen {
    /// Index of the frame.
    pub frame: usize,
    /// As measured. Saturated pixels have the light of its own record, which is not cut off.
    pub measured: Array2<f32>,
    /// As measured, moved to where the scenes are expected; None: they are not clearly displaced together.
    pub moved: Option<Array2<f32>>,
    /// As its own record predicts it.
    pub own: Array2<f32>,
    /// As its own object predicts it, turned or mirrored. Computed only if its own record predicts it badly.
    pub turned: Vec<Turned>,
}

impl Seen {
    /// How well the scene fits predicted light, where it was measured or where it is expected: a record is not wrong
    /// because the array has moved, and another one must not seem better for it.
    fn agreement(&self, light: &Array2<f32>) -> f64 {
        agreement(self.places(), light)
    }

    /// The slope of the scene's light against that of its own record.
    fn light(&self) -> f64 {
        let of = |y: &Array2<f32>| (correlation(y, &self.own), slope(y, &self.own));
        let best = self.places().map(of).max_by(|a, b| a.0.total_cmp(&b.0));
        best.map_or(0.0, |(_, slope)| slope)
    }

    /// What is left without the light of its own record, `light` times, in the tenth of the pixels where that is
    /// faintest (median), DN above the black level.
    fn dark_dn(&self, light: f64) -> Option<f64> {
        let mut pairs: Vec<(f32, f32)> = self.own.iter().copied().zip(self.measured.iter().copied()).collect();
        let faint = pairs.len().div_ceil(10);
        pairs.select_nth_unstable_by(faint.checked_sub(1)?, |a, b| a.0.total_cmp(&b.0));
        median(pairs[..faint].iter().map(|(own, y)| f64::from(*y) - light * f64::from(*own)).collect())
    }

    /// The scene as measured and, if all are displaced, moved to where it is expected.
    fn places(&self) -> impl Iterator<Item = &Array2<f32>> {
        std::iter::once(&self.measured).chain(&self.moved)
    }
}

/// A scene as a turned or mirrored object predicts it.
pub struct Turned {
    /// How the object is turned.
    pub turn: Turn,
    /// Predicted light above the black level, DN, [sensor rows, sensor cols].
    pub light: Array2<f32>,
}

/// A turn of an object: rows and columns are exchanged first, then reversed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Turn {
    /// Whether rows become columns.
    pub exchanged: bool,
    /// Whether the order of rows is reversed.
    pub rows: bool,
    /// Whether the order of columns is reversed.
    pub cols: bool,
}

impl Turn {
    /// All turns of an object of [rows, cols] but none at all; rows and columns of a square alone are exchanged.
    pub(super) fn all((rows, cols): (usize, usize)) -> impl Iterator<Item = Self> {
        let bit = |i: u8, n: u8| i >> n & 1 == 1;
        let of = move |i: u8| Self { exchanged: bit(i, 2), rows: bit(i, 0), cols: bit(i, 1) };
        (1..if rows == cols { 8 } else { 4 }).map(of)
    }

    pub(super) fn of(self, object: &Array2<f32>) -> Array2<f32> {
        let mut object = if self.exchanged { object.t().to_owned() } else { object.clone() };
        if self.rows {
            object.invert_axis(Axis(0));
        }
        if self.cols {
            object.invert_axis(Axis(1));
        }
        object.as_standard_layout().into_owned()
    }

    pub(super) fn fault(self) -> FaultKind {
        let Self { exchanged, rows, cols } = self;
        if exchanged { FaultKind::Exchanged { rows, cols } } else { FaultKind::Flipped { rows, cols } }
    }
}

/// Predicts all scenes with known objects under a state.
///
/// # Errors
/// An object holds negative or non-finite light.
pub fn look(model: &Model<'_>, state: &State) -> Result<Vec<Seen>, ForwardError> {
    let chain = model.chain(&state.terms);
    let scenes = model.scenes(state)?;
    let predicted = model.predict(state, &scenes);
    let noise = model.forward.noise();
    let black = noise.black_level_dn as f32;
    let frames = &model.seen.frames;
    let known: Vec<usize> = (0..frames.len()).filter(|k| matches!(frames[*k].shown, Shown::Object(_))).collect();
    let light = |k: usize| {
        let gain = noise.gain_dn_per_e as f32;
        predicted[k].light_e.mapv(|e| e * gain)
    };
    let full_dn = (SATURATED * noise.saturation_dn) as f32 - black;
    let seen = |k: &usize| {
        let own = light(*k);
        let measured = filled(&frames[*k].measured - black, &own, full_dn)?;
        Some(Seen { frame: *k, measured, moved: None, own, turned: Vec::new() })
    };
    let mut all: Vec<Seen> = known.iter().filter_map(seen).collect();
    move_back(&mut all);
    let agreement: Vec<f64> = all.iter().map(|s| s.agreement(&s.own)).collect();
    let mut sorted = agreement.clone();
    sorted.sort_by(f64::total_cmp);
    let usual = sorted.get(sorted.len() / 2).copied().unwrap_or(1.0);
    for (s, r) in all.iter_mut().zip(&agreement) {
        if 1.0 - r < 4.0 * (1.0 - usual) + 1e-3 && usual > 0.8 {
            continue;
        }
        let Shown::Object(truth) = frames[s.frame].shown else { continue };
        for turn in Turn::all(model.seen.truths[truth].dim()) {
            let object = turn.of(&model.seen.truths[truth]);
            let cx = model.context(s.frame, None);
            let scene = model.forward.scene(object.view(), &chain, &cx)?;
            let light = model.forward.light_e(&scene, &chain, &cx);
            s.turned.push(Turned { turn, light });
        }
    }
    Ok(all)
}

/// A frame whose saturated pixels have the light of its own record in their place, in the proportion of the other
/// pixels: a frame that is cut off at full scale would seem darker than its record, and unlike it. Pixels where the
/// record saturates count as well, since a choice by the measured values alone would keep the dark ones. None: too few
/// others are left. `full_dn` is where pixels saturate, DN above the black level.
fn filled(mut measured: Array2<f32>, own: &Array2<f32>, full_dn: f32) -> Option<Array2<f32>> {
    let mut ratio = 0.0f32;
    // A dark pixel does not saturate, whatever a wrong record predicts.
    let open = |y: f32, m: f32, ratio: f32| y < BRIGHT * full_dn || y < full_dn && ratio * m < full_dn;
    let mut left = 0;
    for _ in 0..ROUNDS {
        let (mut light, mut expected) = (0.0f64, 0.0f64);
        left = 0;
        for (y, m) in measured.iter().zip(own).filter(|(y, m)| open(**y, **m, ratio)) {
            light += f64::from(*y);
            expected += f64::from(*m);
            left += 1;
        }
        ratio = (light / f64::max(expected, 1e-30)).max(0.0) as f32;
    }
    measured.zip_mut_with(own, |y, m| {
        if !open(*y, *m, ratio) {
            *y = ratio * m;
        }
    });
    (left as f64 >= OPEN * measured.len() as f64).then_some(measured)
}

/// Moves scenes that are displaced together to where they are expected. Some of them may have wrong records.
fn move_back(all: &mut [Seen]) {
    let agreement = all.iter().map(|s| correlation(&s.measured, &s.own)).collect();
    if median(agreement).is_none_or(|usual| usual > IN_PLACE) {
        return;
    }
    let pairs = all.iter().take(LOOKED_AT).map(|s| [s.measured.clone(), s.own.clone()]);
    let Some(d) = displacement_px(pairs) else { return };
    for s in all {
        let (rows, cols) = s.measured.dim();
        let from = |at: usize, by: isize, n: usize| at.checked_add_signed(by).filter(|at| *at < n);
        s.moved = Some(Array2::from_shape_fn((rows, cols), |(r, c)| {
            from(r, d[0], rows).zip(from(c, d[1], cols)).map_or(0.0, |at| s.measured[at])
        }));
    }
}

/// How many times as bright as their records the scenes usually are, and their level where these predict no light.
/// `black_dn` is the black level of the calibration. None: there are none.
pub(crate) fn usual(frames: &[Seen], black_dn: f64) -> Option<ScenesShow> {
    let light = median(frames.iter().map(Seen::light).collect())?;
    let levels = frames.iter().filter_map(|s| s.dark_dn(light)).collect();
    Some(ScenesShow { light, level_dn: black_dn + median(levels)? })
}

/// How well a scene fits its own record, the object of another scene of its stack, and its own object, turned.
struct Match<'s> {
    own: f64,
    other: Option<(f64, usize)>,
    turn: Option<(f64, &'s Turn)>,
}

impl<'s> Match<'s> {
    fn of(seen: &Observations, frames: &'s [Seen], i: usize) -> Self {
        let s = &frames[i];
        let best = |a: &f64, b: &f64| a.total_cmp(b);
        let other = (0..frames.len())
            .filter(|j| *j != i && seen.frames[frames[*j].frame].stack == seen.frames[s.frame].stack)
            .map(|j| (s.agreement(&frames[j].own), j));
        let turn = s.turned.iter().map(|t| (s.agreement(&t.light), &t.turn));
        Self {
            own: s.agreement(&s.own),
            other: other.max_by(|a, b| best(&a.0, &b.0)),
            turn: turn.max_by(|a, b| best(&a.0, &b.0)),
        }
    }

    fn best(&self) -> f64 {
        let [other, turn] = [self.other.map_or(-1.0, |o| o.0), self.turn.map_or(-1.0, |t| t.0)];
        self.own.max(other).max(turn)
    }
}

/// Whether a scene, blurred, fits the object of another scene at least as well as its own.
fn resembles_another(frames: &[Seen], i: usize) -> bool {
    let blurred = |image: &Array2<f32>| blur_within(image, SMOOTH_PX);
    let measured: Vec<Array2<f32>> = frames[i].places().map(blurred).collect();
    let own = agreement(&measured, &blurred(&frames[i].own));
    (0..frames.len()).any(|j| j != i && agreement(&measured, &blurred(&frames[j].own)) >= own)
}

/// Finds scenes that show another object than their record says, a turned or mirrored one, or none of those that are
/// recorded, and corrects the observations.
pub fn objects(seen: &mut Observations, frames: &[Seen]) -> Vec<Fault> {
    let mut faults = Vec::new();
    let mut shown: Vec<(usize, Shown)> = Vec::new();
    let matches: Vec<Match<'_>> = (0..frames.len()).map(|i| Match::of(seen, frames, i)).collect();
    let usual = median(matches.iter().map(Match::best).collect()).unwrap_or(1.0);
    let light: Vec<f64> = frames.iter().map(Seen::light).collect();
    let usual_light = median(light.clone()).unwrap_or(1.0);
    for (i, (s, m)) in frames.iter().zip(&matches).enumerate() {
        let holds_its_own = m.own > IN_PART && (light[i] / usual_light - 1.0).abs() < OWN_LIGHT;
        // An improvement alone is no match: the frame must fit about as well as the others.
        let better =
            |r: f64| r > ALIKE && 1.0 - r < BETTER * (1.0 - m.own) && 1.0 - r < AS_USUAL * (1.0 - usual) + SLACK;
        let fault = |kind, correlation_after| Fault {
            frame: seen.frames[s.frame].info.frame,
            kind,
            z: fisher(m.own, correlation_after, s.measured.len()),
            correlation_before: m.own,
            correlation_after,
        };
        match (m.other, m.turn) {
            (Some((r, j)), turn) if better(r) && turn.is_none_or(|(t, _)| r >= t) => {
                let truth_of = seen.frames[frames[j].frame].info.frame;
                faults.push(fault(FaultKind::Shows { truth_of }, r));
                shown.push((s.frame, seen.frames[frames[j].frame].shown.clone()));
            }
            (_, Some((r, turn))) if better(r) => {
                faults.push(fault(turn.fault(), r));
                if let Shown::Object(truth) = seen.frames[s.frame].shown {
                    seen.truths.push(turn.of(&seen.truths[truth]));
                    shown.push((s.frame, Shown::Object(seen.truths.len() - 1)));
                }
            }
            _ if usual > OWN
                && 1.0 - m.own > UNLIKE * (1.0 - usual) + SLACK
                && !holds_its_own
                && resembles_another(frames, i) =>
            {
                let z = fisher(m.own, usual, s.measured.len());
                faults.push(Fault { z, ..fault(FaultKind::Unlike, m.own) });
                shown.push((s.frame, Shown::Unknown));
            }
            _ => {}
        }
    }
    for (k, shows) in shown {
        seen.frames[k].shown = shows;
    }
    faults
}

/// Share of the scenes that resemble the object of another scene more than their own, from which on the frames do not
/// show these objects; by chance it is all but one of them.
const OTHERS: f64 = 0.6;
/// Where the median correlation of the scenes with their own objects exceeds this, the frames show them.
const OWN: f64 = 0.8;
/// Number of scenes that this takes.
const SCENES: usize = 4;

/// Whether the frames show other objects than their records say: so many of so many scenes resemble another scene's
/// object more than their own, with the median correlation with their own. Light is blurred before, so that no
/// displacement of a few pixels counts.
pub fn others(frames: &[Seen]) -> Option<(usize, usize, f64)> {
    let sharp = frames.iter().map(|s| s.agreement(&s.own)).collect();
    if frames.len() < SCENES || median(sharp)? > OWN {
        return None;
    }
    let blurred = |image: &Array2<f32>| blur_within(image, SMOOTH_PX);
    let all: Vec<(Vec<Array2<f32>>, Array2<f32>)> =
        frames.par_iter().map(|s| (s.places().map(blurred).collect(), blurred(&s.own))).collect();
    let resembles_another = |i: usize| {
        let (measured, own) = &all[i];
        let own = agreement(measured, own);
        let other = (0..all.len()).filter(|j| *j != i).map(|j| agreement(measured, &all[j].1));
        (own, other.fold(f64::MIN, f64::max) > own + 1e-3)
    };
    let seen: Vec<(f64, bool)> = (0..all.len()).into_par_iter().map(resembles_another).collect();
    let own = median(seen.iter().map(|s| s.0).collect())?;
    let others = seen.iter().filter(|s| s.1).count();
    let foreign = others as f64 > OTHERS * all.len() as f64 && own < OWN;
    foreign.then_some((others, all.len(), own))
}

/// Difference of two correlation coefficients over `n` pixels, standard deviations (Fisher's z transformation).
pub(crate) fn fisher(a: f64, b: f64, n: usize) -> f64 {
    let z = |r: f64| r.clamp(-0.999_999, 0.999_999).atanh();
    (z(b) - z(a)).abs() * (n.max(4) as f64 - 3.0).sqrt() / std::f64::consts::SQRT_2
}

/// The largest correlation of a scene at any of its places with predicted light.
fn agreement<'a>(places: impl IntoIterator<Item = &'a Array2<f32>>, light: &Array2<f32>) -> f64 {
    places.into_iter().map(|measured| correlation(measured, light)).fold(-1.0, f64::max)
}

/// Pearson correlation coefficient; 0 if an image does not vary.
pub(super) fn correlation(a: &Array2<f32>, b: &Array2<f32>) -> f64 {
    Moments::of(a.view(), b.view()).map_or(0.0, |m| m.pcc())
}

/// Slope of the regression of an image on another; 0 if that does not vary.
pub(super) fn slope(y: &Array2<f32>, on: &Array2<f32>) -> f64 {
    let [mean_y, mean] = [y, on].map(|image| f64::from(image.mean().unwrap_or(0.0)));
    let (mut both, mut square) = (0.0, 0.0);
    for (y, m) in y.iter().zip(on) {
        both += (f64::from(*y) - mean_y) * (f64::from(*m) - mean);
        square += (f64::from(*m) - mean).powi(2);
    }
    if square > 0.0 { both / square } else { 0.0 }
}

/// The middle of some values; None of none.
pub(crate) fn median(mut values: Vec<f64>) -> Option<f64> {
    values.sort_by(f64::total_cmp);
    values.get(values.len() / 2).copied()
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use rand::RngExt;

    /// Blobs of light that differ from scene to scene.
    fn blobs(k: usize) -> Array2<f32> {
        let mut rng = ommatidia_session::rng::stream(k as u64, "blobs", 0);
        let at: Vec<[f32; 2]> = (0..5).map(|_| [0, 0].map(|_: u8| rng.random_range(10.0..86.0))).collect();
        Array2::from_shape_fn((96, 96), |(r, c)| {
            let light = |[y, x]: &[f32; 2]| (-((r as f32 - y).powi(2) + (c as f32 - x).powi(2)) / 18.0).exp();
            at.iter().map(|at| 500.0 * light(at)).sum()
        })
    }

    fn seen(object_of: impl Fn(usize) -> usize) -> Vec<Seen> {
        let one =
            |k: usize| Seen { frame: k, measured: blobs(k), moved: None, own: blobs(object_of(k)), turned: Vec::new() };
        (0..8).map(one).collect()
    }

    #[test]
    fn objects_of_another_session_are_seen_and_those_of_this_one_are_not_doubted() {
        let (others_of, scenes, own) = others(&seen(|k| k + 100)).unwrap();
        assert!(others_of >= 6 && scenes == 8 && own < 0.5, "{others_of} of {scenes}, {own}");
        assert_eq!(others(&seen(|k| k)), None);
        // All scenes show one specimen.
        assert_eq!(others(&seen(|_| 3)), None);
    }

    #[test]
    fn scenes_that_are_displaced_together_are_moved_back_although_one_has_a_wrong_record() {
        let moved = |d: [isize; 2], k: usize| {
            let all = blobs(k);
            Array2::from_shape_fn((96, 96), |(r, c)| {
                let [r, c] = [r as isize - d[0], c as isize - d[1]].map(|v| v.clamp(0, 95) as usize);
                all[[r, c]]
            })
        };
        for d in [[7, -4], [0, 0]] {
            let mut all = seen(|k| if k == 3 { 100 } else { k });
            all.iter_mut().for_each(|s| s.measured = moved(d, s.frame));
            move_back(&mut all);
            let agreement: Vec<f64> = all.iter().map(|s| s.agreement(&s.own)).collect();
            assert!((0..8).all(|k| (agreement[k] > 0.9) == (k != 3)), "{d:?}: {agreement:?}");
            assert_eq!(all[0].moved.is_some(), d != [0, 0]);
        }
    }

    #[test]
    fn a_frame_that_is_cut_off_at_full_scale_is_as_bright_as_its_record() {
        let own = blobs(1);
        let cut = |light: f32, at: f32| own.mapv(|v| (light * v).min(at));
        // Nothing saturates: the same bits.
        assert_eq!(filled(cut(0.5, 1e9), &own, 1e6).unwrap(), cut(0.5, 1e9));
        for light in [0.6, 1.0, 1.7] {
            let found = filled(cut(light, 200.0), &own, 196.0).unwrap();
            let most = found.iter().zip(&own).fold(0.0f32, |most, (y, m)| most.max((y - light * m).abs()));
            assert!(most < 0.02 * 500.0 * light, "{light}: {most}");
        }
        assert!(filled(own.mapv(|_| 300.0), &own, 196.0).is_none());
    }

    #[test]
    fn every_turn_but_none_is_tried_and_brings_a_turned_object_back() {
        let square = Array2::from_shape_fn((5, 5), |(r, c)| (5 * r + c) as f32);
        let turned: Vec<Array2<f32>> = Turn::all((5, 5)).map(|t| t.of(&square)).collect();
        assert!(turned.len() == 7 && turned.iter().all(|t| *t != square));
        assert!((0..7).all(|i| (0..i).all(|j| turned[i] != turned[j])));
        // A quarter turn clockwise: the first row becomes the last column.
        let clockwise = Array2::from_shape_fn((5, 5), |(r, c)| square[[4 - c, r]]);
        let back = Turn::all((5, 5)).find(|t| t.of(&clockwise) == square).unwrap();
        assert_eq!(back.fault(), FaultKind::Exchanged { rows: true, cols: false });
        assert_eq!(Turn::all((5, 6)).count(), 3);
    }
}
