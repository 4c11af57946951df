//! Closes the loop on observations in memory: screening of the records, first fit, search, pruning, account.

use super::account::{
    Accepted, Account, Closed, Closing, Effect, Excess, Findings, Verdict, claims_a_cause, effects, fault, pictured,
    rejected, shadowed, unearned, worse,
};
use super::data::{Fault, Observations, Shown};
use super::evidence::{JudgedOn, figures, judged, omnibus, structured};
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

/// A stack of the session that the calibration of the instrument has read.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct CalibratedOn {
    /// Index of the stack in the session.
    pub stack: usize,
    /// Its file.
    pub file: String,
}

/// Settings of [`close()`].
#[derive(Clone, Copy, Debug, Default)]
pub struct CloseOptions<'a> {
    /// Name of the session, for the account.
    pub session_name: &'a str,
    /// Seed of all random draws.
    pub seed: u64,
    /// Files of the session that the calibration of the instrument has read (by hashes).
    pub calibrated_on: &'a [CalibratedOn],
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
    let recalibrated = search.needs_calibration();
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
    let left = structured(&dependences);
    let (mut now, mut found) = (now, found);
    let mut nearest = shadowed(&search.shadowed);
    let claims = |e: &Effect| claims_a_cause(e, recalibrated);
    let excess = Excess::of(&before, &now);
    let mut effects =
        effects(&model, Findings { before: &before, now: &now, own, found: &found, tests: &tests }, &faults);
    if !found.is_empty() && worse(figures(&model, &before), figures(&model, &now)) {
        let why = "with it, held-out data were predicted worse than without";
        effects.retain(claims);
        nearest.extend(unearned(&effects, why));
        notes.push("all effects that were tried made the prediction of held-out data worse; none was added".into());
        (now, found) = (before.clone(), Vec::new());
        effects = faults.iter().map(fault).collect();
        dependences = dependences_before.clone();
    } else if !excess.names_are_earned(left) && effects.iter().any(claims) {
        let share = 100.0 * excess.left;
        let why =
            format!("{share:.0} % of the excess is left beside it, with structure: it imitates the cause in part");
        let (named, others): (Vec<_>, Vec<_>) = effects.into_iter().partition(claims);
        nearest.extend(unearned(&named, &why));
        notes.push(format!(
            "the instrument keeps terms in the form of {}, which predict held-out data better; they are no causes",
            named.iter().map(|e| e.id.as_str()).collect::<Vec<_>>().join(", ")
        ));
        effects = others;
    }
    let catalogue_incomplete = unknown || structured(&dependences);
    let verdict = Excess::of(&before, &now).verdict(catalogue_incomplete);
    if instrument.replicates.is_empty() && seen.of(Role::Scene).next().is_some() {
        notes.push(
            "the instrument has no calibration replicates, so the uncertainty of the calibration is unknown and small \
             effects may be errors of the calibration; calibrate again"
                .into(),
        );
    }
    let own_beads = own_beads(seen, options.calibrated_on);
    if own_beads {
        notes.push(OWN_BEADS_NOTE.into());
    }
    let accepted = Accepted { state: &now.state, found: &found };
    let closing = Closing {
        session: options.session_name.into(),
        calibrated_on: options.calibrated_on.iter().map(|c| c.file.clone()).collect(),
        own_beads,
        judged_on: JudgedOn::of(seen),
        verdict,
        nearest,
        before: figures(&model, &before),
        after: figures(&model, &now),
        held_out_frames: held_out_frames(seen),
        held_out_blocks: held_out_blocks(seen),
        effects,
        rejected: rejected(&model, &rest, &accepted, own_beads),
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
    let own_beads = own_beads(seen, options.calibrated_on);
    let closing = Closing {
        session: options.session_name.into(),
        calibrated_on: options.calibrated_on.iter().map(|c| c.file.clone()).collect(),
        own_beads,
        judged_on: JudgedOn::of(seen),
        verdict: if structured(&dependences) { Verdict::Incomplete } else { Verdict::Adequate },
        notes: own_beads.then(|| OWN_BEADS_NOTE.into()).into_iter().collect(),
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

/// What the figures mean where the only known frames are those of the calibration.
const OWN_BEADS_NOTE: &str = "the figures are of bead frames that this instrument was calibrated on: they show how well \
                              the model describes that scan, and nothing of what has changed since; measure scenes of \
                              known objects or a new bead scan to test the optics";

/// Whether all frames of the figures are bead frames that the calibration has read.
fn own_beads(seen: &Observations, calibrated_on: &[CalibratedOn]) -> bool {
    let own = |k: usize| {
        let frame = &seen.frames[k];
        matches!(frame.shown, Shown::Bead(_)) && calibrated_on.iter().any(|c| c.stack == frame.stack)
    };
    let mut known = judged(seen).filter(|k| seen.frames[*k].shown != Shown::Unknown).peekable();
    known.peek().is_some() && known.all(own)
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
