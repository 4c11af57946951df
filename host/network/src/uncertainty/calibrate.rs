//! Scenes -> widths: the fit of the scale, and conformal calibration.

use super::UncertaintyError;
use super::neighbours::{conformal_quantile, units};
use super::observer::{GROUPS, Observer, PIXEL, RINGS, Seen, ring_of};
use super::scale::Scale;
use super::scores::{BINS, bin};
use super::virtual_scenes::{VirtualFrame, VirtualScenes};
use super::widths::{Made, Widths};
use crate::methods::Reconstruct;
use ndarray::Array2;
use ommatidia_model::instrument::Instrument;
use ommatidia_session::rng;
use rand::RngExt;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

/// Pixels of a scene that the scale is fitted to.
const SAMPLES: usize = 800;
/// Share of the scenes that the scale is fitted to; the others calibrate.
const FOR_SCALE: f64 = 0.2;
/// Share of frames that an alarm may name wrongly, for each of two figures.
const FALSE_ALARMS: f64 = 0.005;
/// Errors smaller than this part of the propagated noise count as that large in the fit of the scale.
const LEAST_ERROR: f32 = 0.03;
/// The light of the scenes reaches this far beyond its range, so that frames at its ends have neighbours on both sides.
const BEYOND: [f64; 2] = [1.0 / 1.4, 1.2];
/// Scenes that pass together: their pixels are in memory.
const AT_ONCE: usize = 32;

/// Settings of the calibration of widths.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CalibrateWidths {
    /// Number of virtual scenes.
    pub count: usize,
    /// Nominal coverage, such as 0.9.
    pub coverage: f64,
    /// Scenes that the limits of one frame are taken from.
    pub neighbours: usize,
}

impl Default for CalibrateWidths {
    fn default() -> Self {
        Self { count: 1680, coverage: 0.9, neighbours: 16 }
    }
}

/// Errors of one scene: what was seen, and truth minus reconstruction, both in the light unit of the instrument.
#[derive(Clone, Debug)]
pub(super) struct Judged {
    pub(super) seen: Seen,
    pub(super) errors: Vec<f32>,
}

impl Judged {
    /// Reconstructs a frame, looks at it, and compares with its object (in any unit), which is scaled so that the frame
    /// that the instrument predicts from it has the light of the measured one.
    ///
    /// # Errors
    /// The method refuses the frame, or a shape is wrong.
    pub(super) fn of(
        observer: &Observer,
        method: &dyn Reconstruct,
        index: usize,
        frame_dn: &Array2<f32>,
        object: &Array2<f32>,
    ) -> Result<Self, UncertaintyError> {
        let found = method.reconstruct(frame_dn.view());
        let found = found.map_err(|e| UncertaintyError::Reconstruction { index, detail: format!("{e:#}") })?;
        let seen = observer.see(frame_dn.view(), &found)?;
        let light = observer.light(frame_dn.view(), object)? as f32;
        let errors = object.iter().zip(&seen.object).map(|(t, x)| light * t - x).collect();
        Ok(Self { seen, errors })
    }
}

/// Judges scenes `range` in order, some at a time.
pub(super) fn judge_each(
    range: std::ops::Range<usize>,
    one: impl Fn(usize) -> Result<(VirtualFrame, Judged), UncertaintyError> + Sync,
    mut take: impl FnMut(usize, VirtualFrame, Judged),
) -> Result<(), UncertaintyError> {
    for first in range.clone().step_by(AT_ONCE) {
        let some = first..(first + AT_ONCE).min(range.end);
        let judged: Vec<_> = some.clone().into_par_iter().map(&one).collect::<Result<_, _>>()?;
        some.zip(judged).for_each(|(i, (frame, judged))| take(i, frame, judged));
    }
    Ok(())
}

impl CalibrateWidths {
    fn check(&self) -> Result<(), UncertaintyError> {
        let wrong = |field, expected: &str, found: String| {
            Err(UncertaintyError::Config { field, expected: expected.into(), found })
        };
        if self.count < 40 {
            return wrong("count", "40 scenes or more", self.count.to_string());
        }
        if !(self.coverage > 0.0 && self.coverage < 1.0) {
            return wrong("coverage", "a share above 0 and below 1, such as 0.9", self.coverage.to_string());
        }
        if self.neighbours < 10 || self.neighbours > self.count / 2 {
            return wrong("neighbours", "10 to half the number of scenes", self.neighbours.to_string());
        }
        Ok(())
    }

    /// Learns widths of `method` on virtual scenes of an instrument. `hashes` are those of the files of method and
    /// instrument. Calls `done` with the number of scenes after each step.
    ///
    /// # Errors
    /// A setting is out of range, or the method refuses the frames of the instrument.
    pub fn run(
        &self,
        method: &dyn Reconstruct,
        instrument: &Instrument,
        scenes: &VirtualScenes,
        hashes: [String; 2],
        seed: u64,
        mut done: impl FnMut(usize),
    ) -> Result<Widths, UncertaintyError> {
        self.check()?;
        let observer = Observer::new(instrument)?;
        let [low, high] = scenes.peak_e();
        let peak_e = [low * BEYOND[0], high * BEYOND[1]];
        let fitted = (FOR_SCALE * self.count as f64) as usize;
        let one = |i: usize| {
            let frame = scenes.frame_within(peak_e, seed, "uncertainty", i)?;
            let judged = Judged::of(&observer, method, i, &frame.frame_dn, &frame.object)?;
            Ok((frame, judged))
        };
        let mut samples: Vec<([f32; PIXEL], f32)> = Vec::new();
        judge_each(0..fitted, one, |i, _, judged| {
            sample(seed, i, &judged, &mut samples);
            done(1);
        })?;
        if samples.is_empty() {
            return Err(UncertaintyError::Dark { scenes: fitted });
        }
        let scale = Scale::fit(&samples)?;
        drop(samples);
        let (mut frames, mut misfits) = (Vec::new(), Vec::new());
        let count = self.count - fitted;
        let mut histograms = Vec::with_capacity(count * GROUPS * BINS);
        judge_each(fitted..self.count, one, |_, _, judged| {
            frames.push(judged.seen.frame);
            misfits.push(judged.seen.misfit);
            histograms.extend(histogram(&scale, &judged));
            done(1);
        })?;
        let [method_file, instrument_file] = hashes;
        let mut widths = Widths {
            made: Made {
                method: method.name().into(),
                method_file,
                instrument: instrument_file,
                coverage: self.coverage,
                scale_scenes: fitted,
                scenes: count,
                neighbours: self.neighbours,
                object: observer.object_shape(),
                peak_e: scenes.peak_e(),
                miss: [1.0 - self.coverage; RINGS],
                alarm: [f64::INFINITY; 2],
                far: f64::INFINITY,
                units: units(&frames),
            },
            scale,
            frames,
            misfits,
            histograms,
        };
        widths.settle();
        Ok(widths)
    }
}

/// Draws pixels of a scene for the fit of the scale.
fn sample(seed: u64, scene: usize, judged: &Judged, samples: &mut Vec<([f32; PIXEL], f32)>) {
    let mut draws = rng::stream(seed, "uncertainty/pixels", scene as u64);
    for _ in 0..SAMPLES.min(judged.errors.len()) {
        let at = draws.random_range(0..judged.errors.len());
        let features = judged.seen.pixels[at];
        // The fourth feature is the logarithm of the propagated noise.
        let error = judged.errors[at].abs().max(LEAST_ERROR * features[3].exp());
        if error.is_finite() && error > 0.0 && features.iter().all(|f| f.is_finite()) {
            samples.push((features, error));
        }
    }
}

/// Histogram of the scores of a scene: group, bin.
pub(super) fn histogram(scale: &Scale, judged: &Judged) -> Vec<f32> {
    let mut counts = vec![0.0f32; GROUPS * BINS];
    for ((features, error), group) in judged.seen.pixels.iter().zip(&judged.errors).zip(&judged.seen.groups) {
        let score = f64::from(*error) / f64::from(scale.of(features));
        counts[usize::from(*group) * BINS + bin(score)] += 1.0;
    }
    counts
}

impl Widths {
    /// Sets what depends on scenes that are left out of their own calibration: the share that is left out in each ring,
    /// and the thresholds of the warnings.
    fn settle(&mut self) {
        let count = self.frames.len();
        let near: Vec<_> = (0..count).into_par_iter().map(|i| self.near(&self.frames[i], Some(i))).collect();
        let off: Vec<[f64; 2]> = (0..count).map(|i| self.relative_misfit(&self.misfits[i], &near[i])).collect();
        for k in 0..2 {
            let values: Vec<f64> = off.iter().map(|o| o[k]).collect();
            self.made.alarm[k] = finite(conformal_quantile(&values, FALSE_ALARMS), &values);
        }
        let far: Vec<f64> = near.iter().map(|n| n.last().map_or(0.0, |(_, d)| *d)).collect();
        self.made.far = finite(conformal_quantile(&far, FALSE_ALARMS), &far);
        // Conformal risk control: the mean share of missed pixels over n scenes may be (alpha (n + 1) - 1) / n.
        let n = count as f64;
        let wanted = ((1.0 - self.made.coverage) * (n + 1.0) - 1.0) / n;
        let (mut low, mut high) = ([0.0; RINGS], [1.0; RINGS]);
        for _ in 0..20 {
            let middle: [f64; RINGS] = std::array::from_fn(|r| (low[r] + high[r]) / 2.0);
            let missed = self.missed(&near, &middle);
            for ring in 0..RINGS {
                if missed[ring] <= wanted { low[ring] = middle[ring] } else { high[ring] = middle[ring] }
            }
        }
        self.made.miss = low;
    }

    /// Mean share of missed pixels in each ring over all scenes, each with limits from its neighbours.
    fn missed(&self, near: &[Vec<(usize, f64)>], miss: &[f64; RINGS]) -> [f64; RINGS] {
        let of_scene = |i: usize| {
            let limits = self.limits(&near[i], miss);
            let (mut missed, mut all) = ([0.0f64; RINGS], [0.0f64; RINGS]);
            for (group, limits) in limits.iter().enumerate() {
                let own: Vec<f64> = self.histogram(i, group).iter().map(|n| f64::from(*n)).collect();
                let pixels: f64 = own.iter().sum();
                all[ring_of(group)] += pixels;
                missed[ring_of(group)] += pixels * (1.0 - limits.holds(&own));
            }
            std::array::from_fn(|r| missed[r] / all[r].max(1.0))
        };
        let each: Vec<[f64; RINGS]> = (0..self.frames.len()).into_par_iter().map(of_scene).collect();
        std::array::from_fn(|r| each.iter().map(|m| m[r]).sum::<f64>() / each.len().max(1) as f64)
    }
}

/// The value, or the largest of all where there are too few for it.
fn finite(value: f64, all: &[f64]) -> f64 {
    if value.is_finite() { value } else { all.iter().fold(f64::MIN, |m, v| m.max(*v)) }
}
