//! How often the truth is inside the interval, by specimen, photon level and field radius.

use super::UncertaintyError;
use super::calibrate::{Judged, judge_each};
use super::observer::{LIT, RINGS, rings};
use super::virtual_scenes::VirtualScenes;
use super::widths::{Intervals, Ready};
use crate::methods::Reconstruct;
use ndarray::Array2;
use ommatidia_physics::scene::Specimen;
use serde::Serialize;
use std::collections::BTreeMap;

/// Photon levels of the table: equal steps of the logarithm over the range.
const LEVELS: usize = 4;

/// Coverage in one stratum.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Stratum {
    /// Kind of specimen; None where it is not known.
    pub specimen: Option<Specimen>,
    /// Range of the brightest pixel of the frames, electrons.
    pub peak_e: [f64; 2],
    /// Range of the field radius; 1 is the corner of the field.
    pub radius: [f64; 2],
    /// Number of scenes.
    pub scenes: usize,
    /// Share of pixels whose truth is inside.
    pub coverage: f64,
    /// Its standard error, from the scatter between scenes; None for a single scene.
    pub standard_error: Option<f64>,
    /// The same share over pixels whose reconstruction is above 5 % of the brightest in its frame; None: there are
    /// none.
    pub lit: Option<f64>,
    /// Mean width of the interval relative to the brightest pixels of the reconstruction.
    pub width: f64,
    /// Share of frames with a warning.
    pub warned: f64,
}

/// Coverage over all scenes.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct CoverageTotals {
    /// Number of scenes.
    pub scenes: usize,
    /// Share of pixels whose truth is inside.
    pub coverage: f64,
    /// The same over lit pixels.
    pub lit: f64,
    /// The same over the scenes without a warning; 0 where there are none.
    pub coverage_without_warning: f64,
    /// Share of frames with a warning.
    pub warned: f64,
    /// Share of frames that are not consistent with their reconstruction.
    pub inconsistent: f64,
    /// Share of frames that are unlike those of the calibration.
    pub unlike: f64,
    /// Lowest coverage of a stratum.
    pub worst: f64,
    /// Highest coverage of a stratum.
    pub highest: f64,
    /// Number of strata.
    pub strata: usize,
    /// Number of strata within 2 % of the nominal coverage.
    pub within: usize,
}

/// Figures of one ring of one scene.
#[derive(Clone, Copy, Debug, Default)]
struct Ring {
    pixels: usize,
    inside: usize,
    lit: usize,
    lit_inside: usize,
    width: f64,
}

/// Figures of one scene.
#[derive(Clone, Debug)]
struct Scene {
    specimen: Option<Specimen>,
    peak_e: f64,
    rings: [Ring; RINGS],
    inconsistent: bool,
    unlike: bool,
}

/// Coverage as it is measured, scene by scene.
#[derive(Clone, Debug)]
pub struct Coverage {
    peak_e: [f64; 2],
    nominal: f64,
    ring_of_pixel: Array2<u8>,
    scenes: Vec<Scene>,
}

impl Coverage {
    /// Coverage of these widths, without scenes.
    pub fn new(ready: &Ready) -> Self {
        let made = &ready.widths.made;
        Self { peak_e: made.peak_e, nominal: made.coverage, ring_of_pixel: rings(made.object), scenes: Vec::new() }
    }

    /// Adds `count` virtual scenes of a seed. Calls `done` after each.
    ///
    /// # Errors
    /// The method refuses a frame, or no light reaches the sensor.
    pub fn add_virtual(
        &mut self,
        ready: &Ready,
        method: &dyn Reconstruct,
        scenes: &VirtualScenes,
        seed: u64,
        count: usize,
        mut done: impl FnMut(),
    ) -> Result<(), UncertaintyError> {
        let one = |i: usize| {
            let frame = scenes.frame(seed, "coverage", i)?;
            let judged = Judged::of(&ready.observer, method, i, &frame.frame_dn, &frame.object)?;
            Ok((frame, judged))
        };
        judge_each(0..count, one, |_, frame, judged| {
            self.add(ready, Some(frame.specimen), frame.peak_e, &judged);
            done();
        })
    }

    /// Adds one measured frame, DN, with its known object in any unit.
    ///
    /// # Errors
    /// The method refuses the frame, or a shape is wrong.
    pub fn add_measured(
        &mut self,
        ready: &Ready,
        method: &dyn Reconstruct,
        index: usize,
        frame_dn: &Array2<f32>,
        object: &Array2<f32>,
    ) -> Result<(), UncertaintyError> {
        let judged = Judged::of(&ready.observer, method, index, frame_dn, object)?;
        self.add(ready, None, judged.seen.frame[0].exp(), &judged);
        Ok(())
    }

    fn add(&mut self, ready: &Ready, specimen: Option<Specimen>, peak_e: f64, judged: &Judged) {
        let Intervals { lower, upper, suspicion, light } = ready.of(&judged.seen);
        let brightest = judged.seen.object.fold(0.0f32, |m, v| m.max(*v)).max(f32::MIN_POSITIVE);
        let mut rings = [Ring::default(); RINGS];
        let limits = lower.iter().zip(&upper);
        let pixels = judged.seen.object.iter().zip(&judged.errors).zip(limits).zip(&self.ring_of_pixel);
        for (((x, error), (low, high)), ring) in pixels {
            let truth = (f64::from(*x) + f64::from(*error)) / light;
            // Both come from the same single-precision numbers by other ways: equal up to rounding is inside.
            let rounding = 1e-6 * (truth.abs() + f64::from(*x) / light);
            let inside = truth >= f64::from(*low) - rounding && truth <= f64::from(*high) + rounding;
            let ring = &mut rings[usize::from(*ring)];
            ring.pixels += 1;
            ring.inside += usize::from(inside);
            if *x > LIT * brightest {
                ring.lit += 1;
                ring.lit_inside += usize::from(inside);
            }
            ring.width += f64::from(high - low) * light / f64::from(brightest);
        }
        let (inconsistent, unlike) = (suspicion.inconsistent, suspicion.unlike);
        self.scenes.push(Scene { specimen, peak_e, rings, inconsistent, unlike });
    }

    /// Number of scenes so far.
    pub fn scenes(&self) -> usize {
        self.scenes.len()
    }

    /// Edges of the photon levels, electrons.
    fn level(&self, peak_e: f64) -> usize {
        let [low, high] = self.peak_e.map(f64::ln);
        let at = (peak_e.max(1e-9).ln() - low) / (high - low) * LEVELS as f64;
        (at.max(0.0) as usize).min(LEVELS - 1)
    }

    /// Coverage by specimen, photon level and field radius, lowest first.
    pub fn strata(&self) -> Vec<Stratum> {
        let mut members: BTreeMap<(Option<Specimen>, usize, usize), Vec<&Scene>> = BTreeMap::new();
        for scene in &self.scenes {
            for ring in 0..RINGS {
                members.entry((scene.specimen, self.level(scene.peak_e), ring)).or_default().push(scene);
            }
        }
        let [low, high] = self.peak_e.map(f64::ln);
        let edge = |level: usize| (low + (high - low) * level as f64 / LEVELS as f64).exp();
        let mut strata: Vec<Stratum> = members
            .into_iter()
            .map(|((specimen, level, ring), scenes)| {
                let all: Vec<Ring> = scenes.iter().map(|s| s.rings[ring]).collect();
                let n = all.len() as f64;
                let shares: Vec<f64> = all.iter().map(|r| r.inside as f64 / r.pixels.max(1) as f64).collect();
                let coverage = shares.iter().sum::<f64>() / n;
                let variance = shares.iter().map(|s| (s - coverage).powi(2)).sum::<f64>() / (n - 1.0);
                let lit: usize = all.iter().map(|r| r.lit).sum();
                let lit_inside: usize = all.iter().map(|r| r.lit_inside).sum();
                let pixels: usize = all.iter().map(|r| r.pixels).sum();
                Stratum {
                    specimen,
                    peak_e: [edge(level), edge(level + 1)],
                    radius: [ring, ring + 1].map(|r| r as f64 / RINGS as f64),
                    scenes: all.len(),
                    coverage,
                    standard_error: (all.len() > 1).then(|| (variance / n).sqrt()),
                    lit: (lit > 0).then(|| lit_inside as f64 / lit as f64),
                    width: all.iter().map(|r| r.width).sum::<f64>() / pixels.max(1) as f64,
                    warned: scenes.iter().filter(|s| s.inconsistent || s.unlike).count() as f64 / n,
                }
            })
            .collect();
        strata.sort_by(|a, b| a.coverage.total_cmp(&b.coverage));
        strata
    }

    /// Coverage over all scenes.
    pub fn totals(&self) -> CoverageTotals {
        let strata = self.strata();
        let n = self.scenes.len().max(1) as f64;
        let share = |is: &dyn Fn(&Scene) -> bool| self.scenes.iter().filter(|s| is(s)).count() as f64 / n;
        let over = |of: &dyn Fn(&Ring) -> [usize; 2], is: &dyn Fn(&Scene) -> bool| {
            let rings = self.scenes.iter().filter(|s| is(s)).flat_map(|s| &s.rings).map(of);
            let [inside, all] = rings.fold([0, 0], |[a, b], [c, d]| [a + c, b + d]);
            inside as f64 / all.max(1) as f64
        };
        let all = |r: &Ring| [r.inside, r.pixels];
        CoverageTotals {
            scenes: self.scenes.len(),
            coverage: over(&all, &|_| true),
            lit: over(&|r| [r.lit_inside, r.lit], &|_| true),
            coverage_without_warning: over(&all, &|s| !(s.inconsistent || s.unlike)),
            warned: share(&|s| s.inconsistent || s.unlike),
            inconsistent: share(&|s| s.inconsistent),
            unlike: share(&|s| s.unlike),
            worst: strata.first().map_or(0.0, |s| s.coverage),
            highest: strata.last().map_or(0.0, |s| s.coverage),
            strata: strata.len(),
            within: strata.iter().filter(|s| (s.coverage - self.nominal).abs() <= 0.02).count(),
        }
    }
}
