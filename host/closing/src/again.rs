//! Further attempts: where something is left beside what a search has named, the records are doubted once more.
//!
//! A strong effect hides a wrong exposure and a lamp that flickers until it is found, and an effect that the model lacks
//! may look like them. So each correction of the records has an attempt of its own after the first one, which counts
//! only where it leaves less.

use super::account::Closed;
use super::attempt::{Attempt, Given, Outcome, attempt};
use super::data::{Fault, FaultKind, Observations, Shown};
use super::fit::{State, exposures};
use super::options::{CloseError, CloseOptions};
use super::records::{doubted_under, flickering_under};
use ommatidia_model::instrument::Instrument;
use ommatidia_physics::effects::Stage;

/// Scenes flicker beside other effects where their own light leaves less than this share of the excess.
const FLICKERS: f64 = 0.5;

/// The first attempt, or the first further one that leaves less. Corrections of the records stay in `seen` only where
/// they count. `faults` are those that were corrected before.
pub(crate) fn again(
    instrument: &Instrument,
    seen: &mut Observations,
    options: &CloseOptions<'_>,
    (faults, first): (Vec<Fault>, Attempt),
    progress: &mut dyn FnMut(&str),
) -> Result<Closed, CloseError> {
    for correction in [Correction::Exposures, Correction::Flicker] {
        let recorded = Recorded::of(seen);
        let found = correction.make(instrument, seen, (&faults, &first))?;
        if found.is_empty() {
            continue;
        }
        let faults: Vec<Fault> = faults.iter().cloned().chain(found).collect();
        let given = Given { exclude: options.exclude, faults: &faults };
        match attempt(instrument, seen, options, given, progress)? {
            Outcome::Ended(second) if correction.counts(&first, &second) => return Ok(second.closed),
            _ => recorded.restore(seen),
        }
    }
    Ok(first.closed)
}

/// What may be wrong with the records beside what an attempt has found.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Correction {
    /// Exposures of single scenes.
    Exposures,
    /// The brightness of each scene.
    Flicker,
}

impl Correction {
    /// Finds and corrects it; empty: there is nothing to correct.
    fn make(
        self,
        instrument: &Instrument,
        seen: &mut Observations,
        (faults, first): (&[Fault], &Attempt),
    ) -> Result<Vec<Fault>, CloseError> {
        match self {
            // What is left may be as small as errors of the calibration: they do not change the light of one frame.
            Self::Exposures => {
                let wrong = doubted_under(instrument, seen, &first.state)?;
                exposures::correct_exposures(seen, &wrong);
                Ok(wrong)
            }
            Self::Flicker => {
                let has_own_light = |f: &Fault| matches!(f.kind, FaultKind::Unit { .. });
                let mut named = State { specimens: None, ..first.state.clone() };
                named.terms.retain(|t| !t.id().starts_with("unknown"));
                let nothing_else = named.terms.iter().all(|t| t.effect.descriptor().stage == Stage::Record);
                if first.explains_all() || nothing_else || faults.iter().any(has_own_light) {
                    return Ok(Vec::new());
                }
                flickering_under(instrument, seen, named)
            }
        }
    }

    /// Whether an attempt with the correction is better than the first one.
    fn counts(self, first: &Attempt, second: &Attempt) -> bool {
        let excess = |it: &Attempt| it.closed.account.closing.after.chi2_ndf - 1.0;
        match self {
            Self::Exposures => excess(second) <= excess(first),
            Self::Flicker => excess(second).max(0.0) < FLICKERS * excess(first).max(0.0),
        }
    }
}

/// What corrections change in the observations.
struct Recorded {
    exposures_ms: Vec<f64>,
    shown: Vec<Shown>,
    truths: usize,
}

impl Recorded {
    fn of(seen: &Observations) -> Self {
        Self {
            exposures_ms: seen.frames.iter().map(|f| f.info.exposure_ms).collect(),
            shown: seen.frames.iter().map(|f| f.shown.clone()).collect(),
            truths: seen.truths.len(),
        }
    }

    fn restore(self, seen: &mut Observations) {
        for ((frame, exposure_ms), shown) in seen.frames.iter_mut().zip(self.exposures_ms).zip(self.shown) {
            (frame.info.exposure_ms, frame.shown) = (exposure_ms, shown);
        }
        seen.truths.truncate(self.truths);
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use crate::data::Frame;
    use ndarray::Array2;
    use ommatidia_session::{FrameInfo, Role};

    #[test]
    fn corrections_that_do_not_count_leave_no_trace() {
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
        let before = Observations {
            frames: (0..4).map(frame).collect(),
            truths: vec![Array2::ones((8, 8)); 4],
            registrations: Vec::new(),
            pixels: Vec::new(),
            blocks: Vec::new(),
            held_out_blocks: Vec::new(),
            sensor: [1, 1],
            recorded: 0,
            not_estimated: None,
        };
        let mut seen = before.clone();
        let recorded = Recorded::of(&seen);
        let kind = FaultKind::Exposure { factor: 1.25 };
        let wrong = Fault { frame: 2, kind, z: 20.0, correlation_before: 1.0, correlation_after: 1.0 };
        exposures::correct_exposures(&mut seen, &[wrong]);
        assert_eq!(seen.frames[2].info.exposure_ms, 12.5);
        seen.truths.push(Array2::zeros((8, 8)));
        seen.frames[1].shown = Shown::Object(4);
        recorded.restore(&mut seen);
        let is_as_before =
            |f: &Frame| f.info.exposure_ms == 10.0 && matches!(f.shown, Shown::Object(k) if k == f.info.frame);
        assert!(seen.frames.iter().all(is_as_before));
        assert_eq!(seen.truths, before.truths);
    }
}
