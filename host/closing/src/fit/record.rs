//! Screening of the records: finds frames that contradict what the session states of them.
//!
//! Objects are screened before the first fit, since a wrong object spoils every fit. An exposure is doubted before, and
//! decided after the search: an effect that the model lacks can make single frames darker or brighter too.

use super::model::Model;
use super::state::State;
use crate::data::{Fault, FaultKind, Frame, Observations, Shown};
use ndarray::{Array2, Axis};
use ommatidia_model::forward::ForwardError;
use ommatidia_model::metrics::Moments;
use ommatidia_physics::effects::blur_within;
use rayon::prelude::*;

/// Another record is accepted if it leaves less than this share of the unexplained variance (1 - correlation).
const BETTER: f64 = 0.5;
/// Standard deviation of the Gaussian blur before the light of a frame is compared with its record, pixels: frames of
/// sparse sources correlate less with a model that is out of place by a few pixels, and must not seem darker for it.
const SMOOTH_PX: f64 = 6.0;
/// An exposure is doubted if the light of its frame differs from the others by more than this share, and by much more
/// than their scatter.
const LIGHT: f64 = 0.04;

/// A scene as measured and as its records predict it: light above the black level, DN, [sensor rows, sensor cols].
pub struct Seen {
    /// Index of the frame.
    pub frame: usize,
    /// As measured.
    pub measured: Array2<f32>,
    /// As its own record predicts it.
    pub own: Array2<f32>,
    /// As flips of its own object predict it. Computed only if its own record predicts it badly.
    pub flipped: Vec<Flipped>,
}

/// A scene as a flipped object predicts it.
pub struct Flipped {
    /// Whether rows are reversed.
    pub rows: bool,
    /// Whether columns are reversed.
    pub cols: bool,
    /// Predicted light above the black level, DN, [sensor rows, sensor cols].
    pub light: Array2<f32>,
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
    let mut all: Vec<Seen> = known
        .iter()
        .map(|k| Seen { frame: *k, measured: &frames[*k].measured - black, own: light(*k), flipped: Vec::new() })
        .collect();
    let agreement: Vec<f64> = all.iter().map(|s| correlation(&s.measured, &s.own)).collect();
    let mut sorted = agreement.clone();
    sorted.sort_by(f64::total_cmp);
    let usual = sorted.get(sorted.len() / 2).copied().unwrap_or(1.0);
    for (s, r) in all.iter_mut().zip(&agreement) {
        if 1.0 - r < 4.0 * (1.0 - usual) + 1e-3 && usual > 0.8 {
            continue;
        }
        let Shown::Object(truth) = frames[s.frame].shown else { continue };
        for [rows, cols] in [[true, false], [false, true], [true, true]] {
            let object = flipped(&model.seen.truths[truth], rows, cols);
            let cx = model.context(s.frame, None);
            let scene = model.forward.scene(object.view(), &chain, &cx)?;
            let light = model.forward.light_e(&scene, &chain, &cx);
            s.flipped.push(Flipped { rows, cols, light });
        }
    }
    Ok(all)
}

fn flipped(object: &Array2<f32>, rows: bool, cols: bool) -> Array2<f32> {
    let mut object = object.clone();
    if rows {
        object.invert_axis(Axis(0));
    }
    if cols {
        object.invert_axis(Axis(1));
    }
    object.as_standard_layout().into_owned()
}

/// Finds scenes that show another object than their record says, or a flipped one, and corrects the observations.
pub fn objects(seen: &mut Observations, frames: &[Seen]) -> Vec<Fault> {
    let mut faults = Vec::new();
    let mut shown: Vec<(usize, Shown)> = Vec::new();
    for (i, s) in frames.iter().enumerate() {
        let own = correlation(&s.measured, &s.own);
        let other = (0..frames.len())
            .filter(|j| *j != i && seen.frames[frames[*j].frame].stack == seen.frames[s.frame].stack)
            .map(|j| (correlation(&s.measured, &frames[j].own), j))
            .max_by(|a, b| a.0.total_cmp(&b.0));
        let flip = s.flipped.iter().map(|f| (correlation(&s.measured, &f.light), f)).max_by(|a, b| a.0.total_cmp(&b.0));
        let better = |r: f64| 1.0 - r < BETTER * (1.0 - own);
        let frame = seen.frames[s.frame].info.frame;
        let fault = |kind, correlation_after| Fault {
            frame,
            kind,
            z: fisher(own, correlation_after, s.measured.len()),
            correlation_before: own,
            correlation_after,
        };
        match (other, flip) {
            (Some((r, j)), flip) if better(r) && flip.is_none_or(|(f, _)| r >= f) => {
                let truth_of = seen.frames[frames[j].frame].info.frame;
                faults.push(fault(FaultKind::Shows { truth_of }, r));
                shown.push((s.frame, seen.frames[frames[j].frame].shown.clone()));
            }
            (_, Some((r, &Flipped { rows, cols, .. }))) if better(r) => {
                faults.push(fault(FaultKind::Flipped { rows, cols }, r));
                if let Shown::Object(truth) = seen.frames[s.frame].shown {
                    seen.truths.push(flipped(&seen.truths[truth], rows, cols));
                    shown.push((s.frame, Shown::Object(seen.truths.len() - 1)));
                }
            }
            _ => {}
        }
    }
    for (k, shows) in shown {
        seen.frames[k].shown = shows;
    }
    faults
}

/// Finds scenes whose light differs from that of the others by a factor of their own. An effect that the model lacks
/// may do that as well, so nothing is corrected yet.
pub fn exposures(seen: &Observations, frames: &[Seen]) -> Vec<Fault> {
    let mut faults = Vec::new();
    // The regression has an intercept, so that an even background is no light of the specimen.
    let slope = |s: &Seen| {
        let [y, m] = [&s.measured, &s.own].map(|image| blur_within(image, SMOOTH_PX));
        let [mean_y, mean_m] = [&y, &m].map(|image| f64::from(image.mean().unwrap_or(0.0)));
        let (mut top, mut bottom) = (0.0, 0.0);
        for (y, m) in y.iter().zip(&m) {
            top += (f64::from(*y) - mean_y) * (f64::from(*m) - mean_m);
            bottom += (f64::from(*m) - mean_m).powi(2);
        }
        top / f64::max(bottom, 1e-30)
    };
    let slopes: Vec<f64> = frames.par_iter().map(slope).collect();
    let median = |mut v: Vec<f64>| {
        v.sort_by(f64::total_cmp);
        v.get(v.len() / 2).copied().unwrap_or(1.0)
    };
    if slopes.len() < 4 {
        return faults;
    }
    let usual = median(slopes.clone());
    let scatter = median(slopes.iter().map(|v| (v / usual - 1.0).abs()).collect());
    for (s, slope) in frames.iter().zip(&slopes) {
        let factor = slope / usual;
        // One frame against all others: a drift of the lamp changes all of them.
        if (factor - 1.0).abs() > LIGHT.max(12.0 * scatter) {
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

/// Corrects the recorded exposures of scenes.
pub fn correct_exposures(seen: &mut Observations, faults: &[Fault]) {
    for fault in faults {
        let FaultKind::Exposure { factor } = fault.kind else { continue };
        let of = |f: &&mut Frame| f.info.frame == fault.frame && matches!(f.shown, Shown::Object(_));
        seen.frames.iter_mut().filter(of).for_each(|f| f.info.exposure_ms *= factor);
    }
}

/// Difference of two correlation coefficients over `n` pixels, standard deviations (Fisher's z transformation).
fn fisher(a: f64, b: f64, n: usize) -> f64 {
    let z = |r: f64| r.clamp(-0.999_999, 0.999_999).atanh();
    (z(b) - z(a)).abs() * (n.max(4) as f64 - 3.0).sqrt() / std::f64::consts::SQRT_2
}

/// Pearson correlation coefficient; 0 if an image does not vary.
fn correlation(a: &Array2<f32>, b: &Array2<f32>) -> f64 {
    Moments::of(a.view(), b.view()).map_or(0.0, |m| m.pcc())
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

    fn faults(moved_px: f64, factor: f32) -> Vec<Fault> {
        let seen = |k: usize| {
            let light = if k == 2 { factor } else { 1.0 };
            Seen { frame: k, measured: sources(k, moved_px) * light, own: sources(k, 0.0), flipped: Vec::new() }
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
            truths: Vec::new(),
            registrations: Vec::new(),
            pixels: Vec::new(),
            blocks: Vec::new(),
            held_out_blocks: Vec::new(),
            sensor: [96, 96],
            recorded: 0,
        };
        exposures(&observations, &(0..6).map(seen).collect::<Vec<_>>())
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
