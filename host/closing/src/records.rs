//! Faults of a session's records: what refuses the session, what is corrected before anything is fitted, and what is
//! only doubted until a search has ended.

use super::data::{Fault, Observations, Shown, leave_lit_darks_out, scaled_frames, unit_of_flats, unit_of_scenes};
use super::fit::exposures::Wrong;
use super::fit::{Model, State, exposures, flicker, orientation, pedestal, record, refit, scene_light, units};
use super::options::CloseError;
use ommatidia_model::instrument::Instrument;

/// Refuses a session whose frames a program has changed, or whose flats show that its frames are in another unit than
/// those of the calibration. Leaves out darks that light has reached, and says so.
pub(crate) fn screened(instrument: &Instrument, seen: &mut Observations) -> Result<Vec<String>, CloseError> {
    let noise = &instrument.noise;
    if let Some(scaled) = scaled_frames(seen, noise) {
        return Err(CloseError::Scaled(scaled));
    }
    if let Some(other) = unit_of_flats(seen, noise) {
        return Err(CloseError::OtherUnit(other));
    }
    Ok(leave_lit_darks_out(seen, noise))
}

/// What to say where few scenes seem to flicker.
pub(crate) fn few_scenes_note(instrument: &Instrument, seen: &Observations) -> Result<Option<String>, CloseError> {
    if !flicker::are_few(seen) {
        return Ok(None);
    }
    Ok(flicker::few_note(&own_light_of(instrument, seen, None)?))
}

/// Looks at the scenes with known objects; None: too few.
fn looked(
    instrument: &Instrument,
    seen: &Observations,
    state: Option<&State>,
) -> Result<Option<Vec<record::Seen>>, CloseError> {
    if known(seen).len() < 2 {
        return Ok(None);
    }
    let model = Model::new(instrument, seen)?;
    let own = model.state(instrument)?;
    Ok(Some(record::look(&model, state.unwrap_or(&own))?))
}

/// Faults of the records: those of objects, which are corrected, and exposures, which are only doubted.
pub(crate) fn wrong_records(
    instrument: &Instrument,
    seen: &mut Observations,
) -> Result<(Vec<Fault>, Vec<Wrong>), CloseError> {
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
    Ok((faults, doubted))
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
) -> Result<Vec<Wrong>, CloseError> {
    let relative = exposures::by_regression(seen, frames);
    if !exposures::may_be_wrong(&relative) {
        return Ok(Vec::new());
    }
    let model = Model::new(instrument, seen)?;
    let fit = refit(&model, state.cloned().map_or_else(|| model.state(instrument), Ok)?)?;
    let scenes: Vec<usize> = frames.iter().map(|s| s.frame).collect();
    let light = scene_light::light(&model, &fit, &scenes);
    let beside_borders = |i: usize| scene_light::beside_borders(&model, &fit, scenes[i]);
    Ok(exposures::exposures(seen, frames, &relative, &light, beside_borders)?)
}

/// Wrong exposures with the factors that their frames show once they are corrected, under a state or that of the
/// instrument.
pub(crate) fn refined(
    instrument: &Instrument,
    seen: &Observations,
    state: Option<&State>,
    mut wrong: Vec<Wrong>,
) -> Result<Vec<Wrong>, CloseError> {
    if !wrong.is_empty() {
        let mut corrected = seen.clone();
        exposures::correct_exposures(&mut corrected, &wrong);
        let light = own_light_of(instrument, &corrected, state.cloned())?;
        exposures::refine(&mut wrong, &known(seen), &light);
    }
    Ok(wrong)
}

/// Indices of the scenes with known objects.
fn known(seen: &Observations) -> Vec<usize> {
    (0..seen.frames.len()).filter(|k| matches!(seen.frames[*k].shown, Shown::Object(_))).collect()
}

/// The light of each scene with a known object under a state, or that of the instrument, which is fitted.
fn own_light_of(
    instrument: &Instrument,
    seen: &Observations,
    state: Option<State>,
) -> Result<Vec<scene_light::Light>, CloseError> {
    let model = Model::new(instrument, seen)?;
    let state = state.map_or_else(|| model.state(instrument), Ok)?;
    Ok(scene_light::light(&model, &refit(&model, state)?, &known(seen)))
}

/// As [`doubted`], of the frames as a state predicts them, with refined factors.
pub(crate) fn doubted_under(
    instrument: &Instrument,
    seen: &Observations,
    state: &State,
) -> Result<Vec<Wrong>, CloseError> {
    let Some(frames) = looked(instrument, seen, Some(state))? else { return Ok(Vec::new()) };
    let found = doubted(instrument, seen, &frames, Some(state))?;
    refined(instrument, seen, Some(state), found)
}

/// As [`flickering`], of the frames as a state predicts them.
pub(crate) fn flickering_under(
    instrument: &Instrument,
    seen: &mut Observations,
    state: State,
) -> Result<Vec<Fault>, CloseError> {
    match looked(instrument, seen, Some(&state))? {
        Some(frames) => flickering(instrument, seen, &frames, Some(state)),
        None => Ok(Vec::new()),
    }
}
