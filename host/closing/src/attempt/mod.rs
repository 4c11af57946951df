//! One attempt to close the loop, with the records as they stand.
//!
//! `basis` is the first fit and what later ones are judged by, `settle` searches and keeps what is earned, with `views`
//! that show whether the truths are wrong, `report` says what was found, with the sentences of `notes`.

mod basis;
mod changed;
mod notes;
mod report;
mod settle;
mod views;

pub(crate) use basis::Given;
pub(crate) use notes::{OWN_BEADS_NOTE, held_out_blocks, held_out_frames, own_beads};
pub(crate) use report::Attempt;

use super::data::{Fault, Observations};
use super::fit::Model;
use super::options::{CloseError, CloseOptions};
use basis::Basis;
use ommatidia_model::instrument::Instrument;
use report::report;
use settle::{End, settle};

/// How an attempt ends.
pub(crate) enum Outcome {
    /// The account says what was found.
    Ended(Box<Attempt>),
    /// The truths are misplaced: they must be left out before another attempt.
    Misplaced(Fault),
}

/// Searches for the effects that an instrument lacks and adds them. Calls `progress` with the name of each step that
/// begins.
///
/// # Errors
/// The parts of the instrument disagree, or an object holds negative light.
pub(crate) fn attempt(
    instrument: &Instrument,
    seen: &Observations,
    options: &CloseOptions<'_>,
    given: Given<'_>,
    progress: &mut dyn FnMut(&str),
) -> Result<Outcome, CloseError> {
    // Fitted once and for all by all cores: frames that are predicted side by side would each fit them.
    instrument.fit_pupils();
    let model = Model::new(instrument, seen)?;
    progress("first fit");
    let basis = Basis::of(instrument, &model, options.seed)?;
    match settle(&basis, options, given, progress)? {
        End::Settled(settled) => Ok(Outcome::Ended(Box::new(report(&basis, *settled, options, given, progress)?))),
        End::Misplaced(fault) => Ok(Outcome::Misplaced(fault)),
    }
}
