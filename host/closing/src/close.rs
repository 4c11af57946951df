//! Closes the loop on observations in memory: screening of the records, first fit, search, pruning, account.

use super::account::{Account, Closed, Closing, Findings, effects, fault, pictured, rejected};
use super::data::{Fault, Observations, Shown};
use super::evidence::{figures, judged, omnibus, structured};
use super::fit::{Model, State, Term, record, refit, replicas};
use super::search::{Pruned, Search, Tried, prune, score};
use ommatidia_model::forward::ForwardError;
use ommatidia_model::instrument::Instrument;
use ommatidia_physics::effects::EffectError;
use ommatidia_session::{Manifest, Role};
use thiserror::Error;

/// Why the loop could not be closed.
#[derive(Debug, Error)]
pub enum CloseError {
    /// The forward model failed.
    #[error(transparent)]
    Forward(#[from] ForwardError),
    /// The instrument holds an effect that is not valid.
    #[error(transparent)]
    Effect(#[from] EffectError),
    /// Instrument and session have different layouts.
    #[error(
        "the instrument was calibrated for {expected}, the session has {found}; calibrate on a session of this \
         instrument"
    )]
    Layout {
        /// Layout of the instrument.
        expected: String,
        /// Layout of the session.
        found: String,
    },
    /// There is no frame.
    #[error("the session holds no frame to compare with the model: expected scenes, beads, flats or darks")]
    Empty,
}

/// Settings of [`close()`].
#[derive(Clone, Copy, Debug, Default)]
pub struct CloseOptions<'a> {
    /// Name of the session, for the account.
    pub session_name: &'a str,
    /// Seed of all random draws.
    pub seed: u64,
    /// Ids of effects that are not tried, for tests of the loop with the true effect missing from the catalogue.
    pub exclude: &'a [String],
    /// An instrument that was calibrated on the training beads of the session, if it predicts the held-out beads better
    /// than the old one ([`super::search::trial_calibration`]). The search compares effects with what it gains.
    pub trial_calibration: Option<&'a Instrument>,
}

/// Checks that a session has the layout that an instrument was calibrated for: array, sensor and object grid.
///
/// # Errors
/// [`CloseError::Layout`] if they differ.
pub fn check_layout(instrument: &Manifest, session: &Manifest) -> Result<(), CloseError> {
    let words = |m: &Manifest| {
        format!(
            "{} x {} lenses, a sensor of {} x {} and objects of {} x {} pixels",
            m.array.rows, m.array.cols, m.sensor.rows, m.sensor.cols, m.object.rows, m.object.cols
        )
    };
    let (expected, found) = (words(instrument), words(session));
    if expected == found { Ok(()) } else { Err(CloseError::Layout { expected, found }) }
}

/// Searches for the effects that an instrument lacks and adds them. Faults of the session's records are corrected in
/// `seen` before anything is fitted. Calls `progress` with the name of each step that begins.
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
    let seed = options.seed;
    progress("records");
    let faults = screen(instrument, seen)?;
    let seen = &*seen;
    let model = Model::new(instrument, seen)?;
    let start = model.state(instrument)?;
    let own = start.terms.len();
    progress("first fit");
    let first = refit(&model, start)?;
    let replicas = replicas(&model, instrument, &first.state)?;
    let before = first.clone();
    let dependences_before = omnibus::test(&model, &first, &replicas.of(&model, &first), seed);
    progress("catalogue");
    let mut search = Search::new(&model, &replicas, first);
    search.exclude = options.exclude.to_vec();
    search.trial_deviance = options.trial_calibration.map(|trial| held_out_deviance(trial, seen)).transpose()?;
    search.run(Tried::Catalogue, &mut progress)?;
    let mut dependences = omnibus::test(&model, &search.now, &replicas.of(&model, &search.now), seed);
    let mut rest = std::mem::take(&mut search.rest);
    // A named effect is accepted only if no term without a name improves the fit beside it.
    if (structured(&dependences) || !search.found.is_empty()) && !search.needs_calibration() {
        progress("terms without a name");
        search.run(Tried::Curves, &mut progress)?;
        search.run(Tried::Maps, &mut progress)?;
        dependences = omnibus::test(&model, &search.now, &replicas.of(&model, &search.now), seed);
    }
    progress("pruning");
    let Pruned { now, found, tests, removed } = prune(&model, &replicas, search.now, search.found, own)?;
    let mut notes = Vec::new();
    if !removed.is_empty() {
        dependences = omnibus::test(&model, &now, &replicas.of(&model, &now), seed);
        // Their limits are those of effects that are absent.
        rest.retain(|c| !removed.iter().any(|t| t.id() == c.term.id()));
        let absent = removed.iter().map(|t| t.switched_off(model.lenses())).collect::<Vec<_>>();
        rest.extend(score(&model, &now, &replicas.of(&model, &now), &absent)?.candidates);
        let ids: Vec<&str> = removed.iter().map(Term::id).collect();
        notes.push(format!(
            "added and later removed, because the effects that were added after them made them unnecessary: {}",
            ids.join(", ")
        ));
    }
    let unknown = found.iter().any(|f| f.id.starts_with("unknown"));
    let catalogue_incomplete = unknown || structured(&dependences);
    let findings = Findings { before: &before, now: &now, own, found: &found, tests: &tests };
    let effects = effects(&model, findings, &faults);
    if instrument.replicates.is_empty() && seen.of(Role::Scene).next().is_some() {
        notes.push(
            "the instrument has no calibration replicates, so the uncertainty of the calibration is unknown and small \
             effects may be errors of the calibration; calibrate again"
                .into(),
        );
    }
    let closing = Closing {
        session: options.session_name.into(),
        before: figures(&model, &before),
        after: figures(&model, &now),
        held_out_frames: held_out_frames(seen),
        held_out_blocks: held_out_blocks(seen),
        effects,
        rejected: rejected(&model, &rest, &now.state, &found),
        catalogue_incomplete,
        faults,
        dependences_before,
        dependences_after: dependences,
        retrained: None,
        notes,
    };
    let mut account = pictured(&model, &before, &now, closing);
    account.closing.notes.extend(background_notes(&model, &now.state));
    Ok(Closed { instrument: with_effects(instrument, &model, &now.state), account })
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
    let faults = screen(instrument, seen)?;
    let seen = &*seen;
    let model = Model::new(instrument, seen)?;
    let fit = refit(&model, model.state(instrument)?)?;
    let replicas = replicas(&model, instrument, &fit.state)?;
    let dependences = omnibus::test(&model, &fit, &replicas.of(&model, &fit), options.seed);
    let figures = figures(&model, &fit);
    let closing = Closing {
        session: options.session_name.into(),
        before: figures,
        after: figures,
        held_out_frames: held_out_frames(seen),
        held_out_blocks: held_out_blocks(seen),
        catalogue_incomplete: structured(&dependences),
        effects: faults.iter().map(fault).collect(),
        faults,
        dependences_before: dependences.clone(),
        dependences_after: dependences,
        ..Closing::default()
    };
    Ok(pictured(&model, &fit, &fit, closing))
}

/// Checks the records of the scenes and corrects them in the observations.
fn screen(instrument: &Instrument, seen: &mut Observations) -> Result<Vec<Fault>, CloseError> {
    let look = |seen: &Observations| {
        let model = Model::new(instrument, seen)?;
        record::look(&model, &model.state(instrument)?)
    };
    if seen.frames.iter().filter(|f| matches!(f.shown, Shown::Object(_))).count() < 2 {
        return Ok(Vec::new());
    }
    Ok(record::screen(seen, look)?)
}

/// Deviance of the held-out cells under another instrument.
fn held_out_deviance(instrument: &Instrument, seen: &Observations) -> Result<f64, CloseError> {
    let model = Model::new(instrument, seen)?;
    Ok(refit(&model, model.state(instrument)?)?.held_out.deviance)
}

/// The background of each stack that has one of its own: it belongs to the session, and no effect names it.
fn background_notes(model: &Model<'_>, state: &State) -> Vec<String> {
    let role = |stack: usize| model.seen.frames.iter().find(|f| f.stack == stack).map(|f| f.role);
    let note = |(stack, [level, row, col]): (usize, &[f64; 3])| {
        let role = role(stack).filter(|_| [*level, *row, *col] != [0.0; 3])?;
        Some(format!(
            "background of the {} frames, as this session shows it: {level:.2} e- a pixel ({row:+.2} e- from the first \
             to the last row, {col:+.2} e- from the first to the last column); it was fitted beside the effects, \
             because the calibration found a background in the bead frames",
            role.name()
        ))
    };
    state.background_e.iter().enumerate().filter_map(note).collect()
}

fn held_out_frames(seen: &Observations) -> Vec<usize> {
    judged(seen).filter(|k| seen.frames[*k].held_out).map(|k| seen.frames[k].info.frame).collect()
}

fn held_out_blocks(seen: &Observations) -> [usize; 2] {
    [seen.held_out_blocks.iter().filter(|h| **h).count(), seen.held_out_blocks.len()]
}

/// The instrument with the effects of a state in place of its own.
fn with_effects(instrument: &Instrument, model: &Model<'_>, state: &State) -> Instrument {
    let effects = state.terms.iter().map(|t| t.setting(model.lenses())).collect();
    Instrument { effects, ..instrument.clone() }
}
