//! One attempt to close the loop, with the records as they stand.
//!
//! `basis` is the first fit and what later ones are judged by, `settle` searches and keeps what is earned, `report`
//! says what was found, with the sentences of `notes`.

mod basis;
mod notes;
mod report;
mod settle;

pub(crate) use basis::Given;
pub(crate) use notes::{OWN_BEADS_NOTE, held_out_blocks, held_out_frames, own_beads};
pub(crate) use report::Attempt;

use super::data::Observations;
use super::fit::Model;
use super::options::{CloseError, CloseOptions};
use basis::Basis;
use ommatidia_model::instrument::Instrument;
use report::report;
use settle::settle;

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
    progress: &mut impl FnMut(&str),
) -> Result<Attempt, CloseError> {
    // Fitted once and for all by all cores: frames that are predicted side by side would each fit them.
    instrument.fit_pupils();
    let model = Model::new(instrument, seen)?;
    progress("first fit");
    let basis = Basis::of(instrument, &model, options.seed)?;
    let settled = settle(&basis, options, given, progress)?;
    report(&basis, settled, options, given, progress)
}
