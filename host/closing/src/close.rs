//! Closes the loop on observations in memory: screening of the records, then one attempt, or more.

use super::account::{
    Account, Closed, Closing, Verdict, calibration_note, fault, pictured, quiet, registration_notes, registrations,
    within_calibration,
};
use super::again::{Again, again};
use super::attempt::{Given, OWN_BEADS_NOTE, Outcome, attempt, held_out_blocks, held_out_frames, own_beads};
use super::data::{Fault, Observations, unit_note};
use super::evidence::{JudgedOn, figures, omnibus, standing_alone, structured};
use super::fit::{Model, UNKNOWN_NOTE, chosen_notes, estimate_specimens, estimated_frames, exposures, refit, replicas};
use super::options::{CloseError, CloseOptions};
use super::records::{few_scenes_note, refined, screened, wrong_records};
use ommatidia_model::instrument::Instrument;

/// Searches for the effects that an instrument lacks and adds them. Faults of the session's records are corrected in
/// `seen`: those of objects before anything is fitted, those of exposures and of a lamp that flickers beside an effect
/// only where what the search has found does not explain them. Calls `progress` with the name of each step that begins.
///
/// # Errors
/// The parts of the instrument disagree, an object holds negative light, or there is no frame.
pub fn close(
    instrument: &Instrument,
    seen: &mut Observations,
    options: &CloseOptions<'_>,
    mut progress: impl FnMut(&str),
) -> Result<Closed, CloseError> {
    close_with(instrument, seen, options, &mut progress)
}

/// As [`close()`]. It is compiled once, and not again for each crate that calls it.
fn close_with(
    instrument: &Instrument,
    seen: &mut Observations,
    options: &CloseOptions<'_>,
    progress: &mut dyn FnMut(&str),
) -> Result<Closed, CloseError> {
    if seen.frames.is_empty() {
        return Err(CloseError::Empty);
    }
    let of_darks = screened(instrument, seen)?;
    let mut closed = attempts(instrument, seen, options, progress)?;
    let closing = &mut closed.account.closing;
    closing.notes.splice(0..0, of_darks.into_iter().chain(unit_note(&closing.faults)));
    let (verdict, note) = quiet(closing.verdict, closing.after, &closing.effects);
    (closing.verdict, closing.catalogue_incomplete) = (verdict, verdict != Verdict::Adequate);
    closing.notes.extend(note);
    if closing.verdict != Verdict::Adequate {
        closing.notes.extend(few_scenes_note(instrument, seen)?);
    }
    Ok(closed)
}

/// One attempt with the records as they are, and further ones with what is wrong with the records beside what it found.
fn attempts(
    instrument: &Instrument,
    seen: &mut Observations,
    options: &CloseOptions<'_>,
    progress: &mut dyn FnMut(&str),
) -> Result<Closed, CloseError> {
    estimate_specimens(instrument, seen);
    progress("records");
    let (faults, doubted) = wrong_records(instrument, seen)?;
    let mut exclude = options.exclude.to_vec();
    if !doubted.is_empty() {
        // A curve over time would take a wrong exposure for its own.
        exclude.push("unknown_profile".into());
    }
    let (faults, misplaced) =
        match attempt(instrument, seen, options, Given { exclude: &exclude, faults: &faults }, progress)? {
            Outcome::Misplaced(misplaced) => (faults, misplaced),
            Outcome::Ended(first) => match again(instrument, seen, options, (faults, *first), progress)? {
                Again::Closed(closed) => return Ok(*closed),
                Again::Misplaced { faults, misplaced } => (faults, misplaced),
            },
        };
    without_truths(instrument, seen, options, (faults, misplaced))
}

/// Leaves misplaced truths out, where the views agree without them, and judges the session as it is: a search would
/// find what the truths show better once they are corrected.
fn without_truths(
    instrument: &Instrument,
    seen: &mut Observations,
    options: &CloseOptions<'_>,
    (mut faults, misplaced): (Vec<Fault>, Fault),
) -> Result<Closed, CloseError> {
    seen.forget_truths();
    estimate_specimens(instrument, seen);
    faults.push(misplaced);
    Ok(Closed { instrument: instrument.clone(), account: judged(instrument, seen, faults, options)? })
}

/// Measures the residual of a session and tests it, without a search for effects: the account has the same figures
/// before and after, and no effects but faults of the records. Of the options, the session's name and the seed count.
///
/// # Errors
/// As [`close()`].
pub fn residual(
    instrument: &Instrument,
    seen: &mut Observations,
    options: &CloseOptions<'_>,
) -> Result<Account, CloseError> {
    if seen.frames.is_empty() {
        return Err(CloseError::Empty);
    }
    let of_darks = screened(instrument, seen)?;
    estimate_specimens(instrument, seen);
    let (mut faults, doubted) = wrong_records(instrument, seen)?;
    let wrong = refined(instrument, seen, None, doubted)?;
    exposures::correct_exposures(seen, &wrong);
    faults.extend(wrong.into_iter().map(|w| w.fault));
    let mut account = judged(instrument, seen, faults, options)?;
    let closing = &mut account.closing;
    closing.notes.splice(0..0, of_darks.into_iter().chain(unit_note(&closing.faults)));
    Ok(account)
}

/// The account of a session without a search, with the faults of its records that were corrected.
fn judged(
    instrument: &Instrument,
    seen: &Observations,
    faults: Vec<Fault>,
    options: &CloseOptions<'_>,
) -> Result<Account, CloseError> {
    let model = Model::new(instrument, seen)?;
    let fit = refit(&model, model.state(instrument)?)?;
    let replicas = replicas(&model, instrument, &fit.state)?;
    let dependences = omnibus::test(&model, &fit, &replicas.of(&model, &fit)?, options.seed);
    let figures = figures(&model, &fit);
    let own_beads = own_beads(seen, options.calibrated_on);
    let structured = structured(&dependences);
    let within = within_calibration(figures, &instrument.quality, standing_alone(&model, &fit, &instrument.psf));
    let verdict = if structured && !within { Verdict::Incomplete } else { Verdict::Adequate };
    let registrations = registrations(&model, &fit, None, &replicas)?;
    let mut notes = registration_notes(&registrations);
    notes.extend(own_beads.then(|| OWN_BEADS_NOTE.into()));
    notes.extend((JudgedOn::of(seen) == JudgedOn::SelfConsistency).then(|| UNKNOWN_NOTE.into()));
    notes.extend(chosen_notes(seen));
    notes.extend(calibration_note((structured, within), verdict, &[], (&instrument.quality, model.shows_beads())));
    let closing = Closing {
        session: options.session_name.into(),
        calibrated_on: options.calibrated_on.iter().map(|c| c.file.clone()).collect(),
        own_beads,
        judged_on: JudgedOn::of(seen),
        verdict,
        registrations,
        notes,
        before: figures,
        after: figures,
        held_out_frames: held_out_frames(seen),
        held_out_blocks: held_out_blocks(seen),
        estimated_frames: estimated_frames(seen),
        recorded_frames: seen.recorded,
        catalogue_incomplete: structured && !within,
        effects: faults.iter().map(fault).collect(),
        faults,
        dependences_before: dependences.clone(),
        dependences_after: dependences,
        ..Closing::default()
    };
    Ok(pictured(&model, &fit, &fit, closing))
}
