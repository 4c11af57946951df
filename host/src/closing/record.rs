//! Metadata faults: what the session says of a frame and should not. They are looked for first, since they wreck every fit, and they
//! are the commonest "mystery residual" of all.

use super::model::Model;
use super::observe::{Observations, Shown};
use super::state::State;
use crate::forward::ForwardError;
use crate::metrics::Moments;
use ndarray::{Array2, Axis};
use serde::{Deserialize, Serialize};

/// A fault of one frame's record.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Fault {
    /// Index of the frame in its stack, as the session numbers it.
    pub frame: usize,
    /// What is wrong.
    pub kind: FaultKind,
    /// Strength of the evidence, standard deviations.
    pub z: f64,
    /// Correlation of the frame with what the record predicts.
    pub correlation_before: f64,
    /// The same once the record is put right.
    pub correlation_after: f64,
}

/// What can be wrong with a record.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum FaultKind {
    /// The frame shows the object that is written down for another frame.
    Shows {
        /// That frame.
        truth_of: usize,
    },
    /// The object is written down upside down or the wrong way round.
    Flipped {
        /// Rows.
        rows: bool,
        /// Columns.
        cols: bool,
    },
    /// The exposure or light level is written down wrong.
    Exposure {
        /// True over written.
        factor: f64,
    },
}

impl Fault {
    /// In words.
    pub fn words(&self) -> String {
        match self.kind {
            FaultKind::Shows { truth_of } => {
                format!("scene frame {} shows the object that is written down for frame {truth_of}", self.frame)
            }
            FaultKind::Flipped { rows, cols } => {
                let axis = match (rows, cols) {
                    (true, true) => "turned by 180 degrees",
                    (true, false) => "upside down",
                    _ => "mirrored left to right",
                };
                format!("the object of scene frame {} is written down {axis}", self.frame)
            }
            FaultKind::Exposure { factor } => {
                format!("scene frame {} was exposed {factor:.4} times as much as is written down", self.frame)
            }
        }
    }
}

/// A record is doubted when another explains this share of what it leaves unexplained.
const BETTER: f64 = 0.5;
/// Frames whose light differs from the rest by this share are doubted, if the rest agree much better.
const LIGHT: f64 = 0.04;

/// Finds faults of the scenes' records and puts the observations right.
///
/// # Errors
/// An object is no light.
pub fn screen(
    seen: &mut Observations,
    look: impl Fn(&Observations) -> Result<Vec<Seen>, ForwardError>,
) -> Result<Vec<Fault>, ForwardError> {
    let mut frames = look(seen)?;
    let mut faults = objects(seen, &frames);
    if !faults.is_empty() {
        frames = look(seen)?;
    }
    faults.extend(exposures(seen, &frames));
    Ok(faults)
}

/// A scene as measured and as each record would have it: light above black, DN.
pub struct Seen {
    /// Index of the frame.
    pub frame: usize,
    /// Measured.
    pub measured: Array2<f32>,
    /// Predicted by its own record.
    pub own: Array2<f32>,
    /// Predicted for its own object, turned: rows, columns, both. Only where its own record does badly.
    pub turned: Vec<([bool; 2], Array2<f32>)>,
}

/// Predictions for the screening.
///
/// # Errors
/// An object is no light.
pub fn look(model: &Model<'_>, state: &State) -> Result<Vec<Seen>, ForwardError> {
    let chain = model.chain(&state.terms);
    let scenes = model.scenes(&chain)?;
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
        .map(|k| Seen { frame: *k, measured: &frames[*k].measured - black, own: light(*k), turned: Vec::new() })
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
            let object = turned(&model.seen.truths[truth], rows, cols);
            let cx = model.context(s.frame, None);
            let scene = model.forward.scene(object.view(), &chain, &cx)?;
            let light = model.forward.light_e(&scene, &chain, &cx);
            s.turned.push(([rows, cols], light));
        }
    }
    Ok(all)
}

fn turned(object: &Array2<f32>, rows: bool, cols: bool) -> Array2<f32> {
    let mut object = object.clone();
    if rows {
        object.invert_axis(Axis(0));
    }
    if cols {
        object.invert_axis(Axis(1));
    }
    object.as_standard_layout().into_owned()
}

fn objects(seen: &mut Observations, frames: &[Seen]) -> Vec<Fault> {
    let mut faults = Vec::new();
    let mut shown: Vec<(usize, Shown)> = Vec::new();
    for (i, s) in frames.iter().enumerate() {
        let own = correlation(&s.measured, &s.own);
        let other = (0..frames.len())
            .filter(|j| *j != i && seen.frames[frames[*j].frame].stack == seen.frames[s.frame].stack)
            .map(|j| (correlation(&s.measured, &frames[j].own), j))
            .max_by(|a, b| a.0.total_cmp(&b.0));
        let flip =
            s.turned.iter().map(|(f, light)| (correlation(&s.measured, light), *f)).max_by(|a, b| a.0.total_cmp(&b.0));
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
            (_, Some((r, [rows, cols]))) if better(r) => {
                faults.push(fault(FaultKind::Flipped { rows, cols }, r));
                if let Shown::Object(truth) = seen.frames[s.frame].shown {
                    seen.truths.push(turned(&seen.truths[truth], rows, cols));
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

fn exposures(seen: &mut Observations, frames: &[Seen]) -> Vec<Fault> {
    let mut faults = Vec::new();
    let slope = |s: &Seen| {
        let (mut top, mut bottom) = (0.0, 0.0);
        for (y, m) in s.measured.iter().zip(&s.own) {
            top += f64::from(y * m);
            bottom += f64::from(m * m);
        }
        top / f64::max(bottom, 1e-30)
    };
    let slopes: Vec<f64> = frames.iter().map(slope).collect();
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
        // One frame against the rest: a lamp that drifts moves them all.
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
            seen.frames[s.frame].info.exposure_ms *= factor;
        }
    }
    faults
}

/// How far two correlations over `n` pixels are apart, standard deviations (Fisher's z).
fn fisher(a: f64, b: f64, n: usize) -> f64 {
    let z = |r: f64| r.clamp(-0.999_999, 0.999_999).atanh();
    (z(b) - z(a)).abs() * (n.max(4) as f64 - 3.0).sqrt() / std::f64::consts::SQRT_2
}

/// Pearson correlation; 0 of images that do not vary.
fn correlation(a: &Array2<f32>, b: &Array2<f32>) -> f64 {
    Moments::of(a.view(), b.view()).map_or(0.0, |m| m.pcc())
}
