//! Further attempts: after a search, the records are doubted once more.
//!
//! A strong effect hides a wrong exposure and a lamp that flickers until it is found, and an effect that the model
//! lacks may look like them. So each correction of the records has an attempt of its own after the first one.

use super::account::Closed;
use super::attempt::{Attempt, Given, Outcome, attempt};
use super::data::{Fault, FaultKind, Observations, Shown};
use super::evidence::rises;
use super::fit::{State, exposures};
use super::options::{CloseError, CloseOptions};
use super::records::{doubted_under, flickering_under};
use ommatidia_model::instrument::Instrument;
use ommatidia_physics::effects::Stage;

/// Scenes flicker beside other effects where their own light leaves less than this share of the excess.
const FLICKERS: f64 = 0.5;

/// What further attempts end in.
pub(crate) enum Again {
    /// The first attempt, or the first further one that counts.
    Closed(Box<Closed>),
    /// With corrected exposures the truths are misplaced: they must be left out.
    Misplaced { faults: Vec<Fault>, misplaced: Fault },
}

/// Takes the first attempt, or the first further one that counts ([`Correction::counts`]). Corrections of the records
/// stay in `seen` only where they count. `faults` are those that were corrected before.
pub(crate) fn again(
    instrument: &Instrument,
    seen: &mut Observations,
    options: &CloseOptions<'_>,
    (faults, first): (Vec<Fault>, Attempt),
    progress: &mut dyn FnMut(&str),
) -> Result<Again, CloseError> {
    for correction in [Correction::Exposures, Correction::Flicker] {
        let recorded = Recorded::of(seen);
        let found = correction.make(instrument, seen, (&faults, &first))?;
        if found.is_empty() {
            continue;
        }
        let faults: Vec<Fault> = faults.iter().cloned().chain(found).collect();
        let given = Given { exclude: options.exclude, faults: &faults };
        match attempt(instrument, seen, options, given, progress)? {
            Outcome::Ended(second) if correction.counts(&first, &second) => {
                return Ok(Again::Closed(Box::new(second.closed)));
            }
            Outcome::Misplaced(misplaced) if correction == Correction::Exposures => {
                return Ok(Again::Misplaced { faults, misplaced });
            }
            _ => recorded.restore(seen),
        }
    }
    Ok(Again::Closed(Box::new(first.closed)))
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
        if faults.iter().any(|f| matches!(f.kind, FaultKind::Unit { .. })) {
            // All scenes have their own light already.
            return Ok(Vec::new());
        }
        match self {
            // What is left may be as small as errors of the calibration: they do not change the light of one frame. A
            // curve over time may hold the light of a wrong exposure.
            Self::Exposures => {
                let named = without_unnamed(first, |id| id == "unknown_profile");
                let wrong = doubted_under(instrument, seen, &named)?;
                exposures::correct_exposures(seen, &wrong);
                Ok(wrong.into_iter().map(|w| w.fault).collect())
            }
            Self::Flicker => {
                let named = without_unnamed(first, |id| id.starts_with("unknown"));
                let nothing_else = named.terms.iter().all(|t| t.effect.descriptor().stage == Stage::Record);
                if first.explains_all() || nothing_else {
                    return Ok(Vec::new());
                }
                flickering_under(instrument, seen, State { specimens: None, ..named })
            }
        }
    }

    /// Whether an attempt with the correction counts in the place of the first one: exposures where the figure on
    /// held-out data, most of which have a right exposure, is no worse.
    fn counts(self, first: &Attempt, second: &Attempt) -> bool {
        let [first, second] = [first, second].map(|it| it.closed.account.closing.after.chi2_ndf);
        match self {
            Self::Exposures => !rises(first, second),
            Self::Flicker => (second - 1.0).max(0.0) < FLICKERS * (first - 1.0).max(0.0),
        }
    }
}

/// The state of an attempt without terms that have no name.
fn without_unnamed(attempt: &Attempt, left_out: impl Fn(&str) -> bool) -> State {
    let mut state = attempt.state.clone();
    state.terms.retain(|t| !left_out(t.id()));
    state
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
    use super::*;
    use crate::data::Frame;
    use crate::fit::exposures::{Wrong, tests::scenes};
    use ndarray::Array2;

    #[test]
    fn corrections_that_do_not_count_leave_no_trace() {
        let (before, _) = scenes(0.0, |_| 1.0);
        let mut seen = before.clone();
        let recorded = Recorded::of(&seen);
        let kind = FaultKind::Exposure { factor: 1.25 };
        let wrong = Fault { frame: 2, kind, z: 20.0, correlation_before: 1.0, correlation_after: 1.0 };
        exposures::correct_exposures(&mut seen, &[Wrong { index: 2, fault: wrong }]);
        assert_eq!(seen.frames[2].info.exposure_ms, 12.5);
        seen.truths.push(Array2::zeros((8, 8)));
        seen.frames[1].shown = Shown::Object(before.truths.len());
        recorded.restore(&mut seen);
        let is_as_before =
            |f: &Frame| f.info.exposure_ms == 10.0 && matches!(f.shown, Shown::Object(k) if k == f.info.frame);
        assert!(seen.frames.iter().all(is_as_before));
        assert_eq!(seen.truths, before.truths);
    }
}
