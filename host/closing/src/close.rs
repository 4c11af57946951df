//! Closes the loop on observations in memory: screening of the records, then one attempt, or two.

use super::account::{
    Account, Closed, Closing, Verdict, calibration_note, fault, pictured, quiet, registration_notes, registrations,
    within_calibration,
};
use super::attempt::{Attempt, Given, OWN_BEADS_NOTE, Outcome, attempt, held_out_blocks, held_out_frames, own_beads};
use super::data::{
    Fault, FaultKind, Observations, Shown, leave_lit_darks_out, scaled_frames, unit_note, unit_of_flats, unit_of_scenes,
};
use super::evidence::{JudgedOn, figures, omnibus, standing_alone, structured};
use super::fit::{
    Model, State, UNKNOWN_NOTE, chosen_note, estimate_specimens, estimated_frames, exposures, flicker, orientation,
    pedestal, record, refit, replicas, scene_light, units,
};
use super::options::{CloseError, CloseOptions};
use ommatidia_model::instrument::Instrument;
use ommatidia_physics::effects::Stage;

/// Scenes flicker beside other effects where their own light leaves less than this share of the excess.
const FLICKERS: f64 = 0.5;

/// Searches for the effects that an instrument lacks and adds them. Faults of the session's records are corrected in
/// `seen`: those of objects before anything is fitted, those of exposures and of a lamp that flickers beside an effect
/// only where no effect explains them. Calls `progress` with the name of each step that begins.
///
/// # Errors
/// The parts of the instrument disagree, an object holds negative light, or there is no frame.
pub fn close(
    instrument: &Instrument,
    seen: &mut Observations,
    options: &CloseOptions<'_>,
    mut progress: impl FnMut(&str),
) -> Result<Closed, CloseError> {
    if seen.frames.is_empty() {
        return Err(CloseError::Empty);
    }
    let of_darks = screened(instrument, seen)?;
    let mut closed = attempts(instrument, seen, options, &mut progress)?;
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

/// What to say where few scenes seem to flicker.
fn few_scenes_note(instrument: &Instrument, seen: &Observations) -> Result<Option<String>, CloseError> {
    if !flicker::are_few(seen) {
        return Ok(None);
    }
    Ok(flicker::few_note(&own_light_of(instrument, seen, None)?))
}

/// Refuses a session whose frames a program has changed, or whose flats show that its frames are in another unit than
/// those of the calibration. Leaves out darks that light has reached, and says so.
fn screened(instrument: &Instrument, seen: &mut Observations) -> Result<Vec<String>, CloseError> {
    let noise = &instrument.noise;
    if let Some(scaled) = scaled_frames(seen, noise) {
        return Err(CloseError::Scaled(scaled));
    }
    if let Some(other) = unit_of_flats(seen, noise) {
        return Err(CloseError::OtherUnit(other));
    }
    Ok(leave_lit_darks_out(seen, noise))
}

/// One attempt with the records as they are, and another one where exposures are still in doubt beside what the first
/// has found.
fn attempts(
    instrument: &Instrument,
    seen: &mut Observations,
    options: &CloseOptions<'_>,
    mut progress: impl FnMut(&str),
) -> Result<Closed, CloseError> {
    estimate_specimens(instrument, seen);
    progress("records");
    let [mut faults, doubted] = wrong_records(instrument, seen)?;
    let mut exclude = options.exclude.to_vec();
    if !doubted.is_empty() {
        // A curve over time would take a wrong exposure for its own.
        exclude.push("unknown_profile".into());
    }
    let first = match attempt(instrument, seen, options, Given { exclude: &exclude, faults: &faults }, &mut progress)? {
        Outcome::Ended(first) => first,
        Outcome::Misplaced(fault) => return without_truths(instrument, seen, options, (faults, fault)),
    };
    if doubted.is_empty() {
        if first.explains_all() {
            return Ok(first.closed);
        }
        // A strong effect hides a wrong exposure until it is found.
        let late = doubted_under(instrument, seen, &first.state)?;
        if late.is_empty() {
            return beside_flicker(instrument, seen, options, (faults, *first), progress);
        }
        return beside_exposures(instrument, seen, options, (faults, late, *first), progress);
    }
    // What is left may be as small as errors of the calibration: they do not change the light of one frame.
    let left = doubted_under(instrument, seen, &first.state)?;
    let wrong: Vec<Fault> = doubted.into_iter().filter(|d| left.iter().any(|l| l.frame == d.frame)).collect();
    if wrong.is_empty() {
        return Ok(first.closed);
    }
    exposures::correct_exposures(seen, &wrong);
    faults.extend(wrong);
    match attempt(instrument, seen, options, Given { exclude: options.exclude, faults: &faults }, &mut progress)? {
        Outcome::Ended(second) => Ok(second.closed),
        Outcome::Misplaced(fault) => without_truths(instrument, seen, options, (faults, fault)),
    }
}

/// Another attempt where exposures are wrong beside what the first one has named. It counts where it leaves no more of
/// the excess than the first; the records stay as they are otherwise.
fn beside_exposures(
    instrument: &Instrument,
    seen: &mut Observations,
    options: &CloseOptions<'_>,
    (mut faults, wrong, first): (Vec<Fault>, Vec<Fault>, Attempt),
    mut progress: impl FnMut(&str),
) -> Result<Closed, CloseError> {
    let recorded: Vec<f64> = seen.frames.iter().map(|f| f.info.exposure_ms).collect();
    exposures::correct_exposures(seen, &wrong);
    faults.extend(wrong);
    let given = Given { exclude: options.exclude, faults: &faults };
    let left = |it: &Attempt| it.closed.account.closing.after.chi2_ndf;
    match attempt(instrument, seen, options, given, &mut progress)? {
        Outcome::Ended(second) if left(&second) <= left(&first) => return Ok(second.closed),
        _ => {}
    }
    seen.frames.iter_mut().zip(recorded).for_each(|(f, exposure_ms)| f.info.exposure_ms = exposure_ms);
    Ok(first.closed)
}

/// Another attempt where scenes flicker beside what the first one has named. It counts where it leaves less than
/// [`FLICKERS`] of the excess of the first; the records stay as they are otherwise.
fn beside_flicker(
    instrument: &Instrument,
    seen: &mut Observations,
    options: &CloseOptions<'_>,
    (mut faults, first): (Vec<Fault>, Attempt),
    mut progress: impl FnMut(&str),
) -> Result<Closed, CloseError> {
    let has_own_light = |f: &Fault| matches!(f.kind, FaultKind::Unit { .. });
    let mut named = State { specimens: None, ..first.state };
    named.terms.retain(|t| !t.id().starts_with("unknown"));
    if faults.iter().any(has_own_light) || named.terms.iter().all(|t| t.effect.descriptor().stage == Stage::Record) {
        return Ok(first.closed);
    }
    let Some(frames) = looked(instrument, seen, Some(&named))? else { return Ok(first.closed) };
    let (shown, truths) = (seen.frames.iter().map(|f| f.shown.clone()).collect::<Vec<_>>(), seen.truths.len());
    let flicker = flickering(instrument, seen, &frames, Some(named))?;
    if flicker.is_empty() {
        return Ok(first.closed);
    }
    faults.extend(flicker);
    let given = Given { exclude: options.exclude, faults: &faults };
    if let Outcome::Ended(second) = attempt(instrument, seen, options, given, &mut progress)? {
        let excess = |closed: &Closed| (closed.account.closing.after.chi2_ndf - 1.0).max(0.0);
        if excess(&second.closed) < FLICKERS * excess(&first.closed) {
            return Ok(second.closed);
        }
    }
    seen.frames.iter_mut().zip(shown).for_each(|(f, shown)| f.shown = shown);
    seen.truths.truncate(truths);
    Ok(first.closed)
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
    let [mut faults, doubted] = wrong_records(instrument, seen)?;
    exposures::correct_exposures(seen, &doubted);
    faults.extend(doubted);
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
    notes.extend(chosen_note(seen));
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

/// Looks at the scenes with known objects; None: too few.
fn looked(
    instrument: &Instrument,
    seen: &Observations,
    state: Option<&State>,
) -> Result<Option<Vec<record::Seen>>, CloseError> {
    if seen.frames.iter().filter(|f| matches!(f.shown, Shown::Object(_))).count() < 2 {
        return Ok(None);
    }
    let model = Model::new(instrument, seen)?;
    let own = model.state(instrument)?;
    Ok(Some(record::look(&model, state.unwrap_or(&own))?))
}

/// Faults of the records: those of objects, which are corrected, and exposures, which are only doubted.
fn wrong_records(instrument: &Instrument, seen: &mut Observations) -> Result<[Vec<Fault>; 2], CloseError> {
    let Some(mut frames) = looked(instrument, seen, None)? else { return Ok(Default::default()) };
    let noise = &instrument.noise;
    if let Some(other) = record::usual(&frames, noise.black_level_dn).and_then(|s| unit_of_scenes(seen, noise, s)) {
        return Err(CloseError::OtherUnit(other));
    }
    if let Some(found) = orientation(&frames) {
        let (own, turned) = (found.own, found.turned);
        return Err(CloseError::Turned { how: found.turn.turn_words(), scenes: frames.len(), own, turned });
    }
    let mut faults = record::objects(seen, &frames);
    match record::others(&frames) {
        // Objects that only lie in another order or turned are found for nearly all of them.
        Some((others, scenes, own)) if 2 * faults.len() < others => {
            return Err(CloseError::OtherObjects { scenes, others, own });
        }
        _ => {}
    }
    if !faults.is_empty() {
        frames = looked(instrument, seen, None)?.unwrap_or_default();
    }
    let lit_everywhere = pedestals(instrument, seen, &frames)?;
    if !lit_everywhere.is_empty() {
        frames = looked(instrument, seen, None)?.unwrap_or_default();
    }
    faults.extend(lit_everywhere);
    let own_units = units::units(seen, &frames);
    let own_light = if own_units.is_empty() { flickering(instrument, seen, &frames, None)? } else { own_units };
    // All of them have their own light then.
    let doubted = if own_light.is_empty() { doubted(instrument, seen, &frames, None)? } else { Vec::new() };
    faults.extend(own_light);
    Ok([faults, doubted])
}

/// Finds objects with a pedestal, and takes it from them.
fn pedestals(
    instrument: &Instrument,
    seen: &mut Observations,
    frames: &[record::Seen],
) -> Result<Vec<Fault>, CloseError> {
    let even = {
        let model = Model::new(instrument, seen)?;
        pedestal::even_light(&model, &model.state(instrument)?, frames)?
    };
    Ok(pedestal::pedestals(seen, frames, &even))
}

/// Finds scenes that differ in brightness from one to the next under a state, or that of the instrument, and gives
/// their objects the light of each.
fn flickering(
    instrument: &Instrument,
    seen: &mut Observations,
    frames: &[record::Seen],
    state: Option<State>,
) -> Result<Vec<Fault>, CloseError> {
    if !flicker::may_flicker(seen, frames) {
        return Ok(Vec::new());
    }
    let light = own_light_of(instrument, seen, state)?;
    Ok(flicker::flicker(seen, frames, &light))
}

/// Exposures that contradict their frames under a state, or that of the instrument.
fn doubted(
    instrument: &Instrument,
    seen: &Observations,
    frames: &[record::Seen],
    state: Option<&State>,
) -> Result<Vec<Fault>, CloseError> {
    let mut found = exposures::exposures(seen, frames);
    if exposures::may_be_wrong(frames) {
        let light = own_light_of(instrument, seen, state.cloned())?;
        let mut more = exposures::exposures_by_light(seen, frames, &light);
        more.retain(|m| !found.iter().any(|f| f.frame == m.frame));
        if !more.is_empty() {
            let mut corrected = seen.clone();
            exposures::correct_exposures(&mut corrected, &more);
            let light = own_light_of(instrument, &corrected, state.cloned())?;
            exposures::refine(seen, frames, &light, &mut more);
        }
        found.extend(more);
    }
    Ok(found)
}

/// The light of each scene under a state, or that of the instrument, which is fitted.
fn own_light_of(
    instrument: &Instrument,
    seen: &Observations,
    state: Option<State>,
) -> Result<Vec<scene_light::Light>, CloseError> {
    let model = Model::new(instrument, seen)?;
    let state = state.map_or_else(|| model.state(instrument), Ok)?;
    Ok(scene_light::light(&model, &refit(&model, state)?))
}

/// As [`doubted`], of the frames as a state predicts them.
fn doubted_under(instrument: &Instrument, seen: &Observations, state: &State) -> Result<Vec<Fault>, CloseError> {
    match looked(instrument, seen, Some(state))? {
        Some(frames) => doubted(instrument, seen, &frames, Some(state)),
        None => Ok(Vec::new()),
    }
}
