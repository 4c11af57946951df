//! The whole of it: faults of the record, the catalogue, tables, terms without a name, pruning, figures on held-out data.

use super::account::{effects, fault, rejected};
use super::design::{Design, nuisances};
use super::figures::{figures, judged, pictured};
use super::file::Account;
use super::model::Model;
use super::observe::{Observations, Shown};
use super::omnibus::{self, Dependence};
use super::record;
use super::refit::{Fitted, own_columns, refit};
use super::result::Closing;
use super::score::{Scores, Test};
use super::search::{self, Found, Replicas, Search, replicas};
use super::state::{Column, State, Term};
use super::stats::f_tail;
use super::trials::Tried;
use crate::effects::EffectError;
use crate::forward::ForwardError;
use crate::instrument::Instrument;
use crate::session::{Manifest, Role};
use ndarray::Array1;
use thiserror::Error;

/// Probability below which an omnibus test counts, all covariates together.
const OMNIBUS: f64 = 0.01;

/// What makes less than this of the variance of the noise is no structure to speak of, however sure: a calibration leaves some per cent, in no
/// order that its replicates know of (light beyond the windows is 5e-5 of all).
const SIZE: f64 = 1e-3;

/// A term stays if chi-squared rises by more than this without it, over the scatter between clusters.
const NEEDED: f64 = 16.0;

/// Why the loop could not be closed.
#[derive(Debug, Error)]
pub enum CloseError {
    /// The model.
    #[error(transparent)]
    Forward(#[from] ForwardError),
    /// The effects of the instrument.
    #[error(transparent)]
    Effect(#[from] EffectError),
    /// Instrument and session are not of one kind.
    #[error(
        "the instrument was calibrated for {expected}, the session has {found}; calibrate on a session of this instrument"
    )]
    Layout {
        /// Layout of the instrument.
        expected: String,
        /// Layout of the session.
        found: String,
    },
    /// Nothing to look at.
    #[error("the session holds no frame that a model can be held against: expected scenes, beads, flats or darks")]
    Empty,
}

/// An instrument that was closed, with the account of it.
pub struct Closed {
    /// The instrument with what was found.
    pub instrument: Instrument,
    /// The account.
    pub account: Account,
}

/// Checks that a session is of an instrument's kind.
///
/// # Errors
/// Sensor, array or object grid differ.
pub fn same_layout(instrument: &Manifest, session: &Manifest) -> Result<(), CloseError> {
    let words = |m: &Manifest| {
        format!(
            "{} x {} lenses, a sensor of {} x {} and objects of {} x {} pixels",
            m.array.rows, m.array.cols, m.sensor.rows, m.sensor.cols, m.object.rows, m.object.cols
        )
    };
    let (expected, found) = (words(instrument), words(session));
    if expected == found { Ok(()) } else { Err(CloseError::Layout { expected, found }) }
}

/// Screens the records of the scenes and puts the observations right.
///
/// # Errors
/// An object is no light.
pub fn screen(instrument: &Instrument, seen: &mut Observations) -> Result<Vec<record::Fault>, CloseError> {
    let look = |seen: &Observations| {
        let model = Model::new(instrument, seen)?;
        record::look(&model, &model.state(instrument)?)
    };
    if seen.frames.iter().filter(|f| matches!(f.shown, Shown::Object(_))).count() < 2 {
        return Ok(Vec::new());
    }
    Ok(record::screen(seen, look)?)
}

/// Closes the loop. `tell` is called with what is being done.
///
/// # Errors
/// The instrument's parts disagree, or the session has nothing to look at.
pub fn close(
    instrument: &Instrument,
    seen: &mut Observations,
    session: &str,
    seed: u64,
    tell: impl FnMut(&str),
) -> Result<Closed, CloseError> {
    close_with(instrument, seen, session, seed, Given::default(), tell)
}

/// What else the loop is given.
#[derive(Clone, Copy, Debug, Default)]
pub struct Given<'a> {
    /// Ids of effects that are not tried. What the loop says where the true effect is not among its candidates tells how far it can be trusted.
    pub exclude: &'a [String],
    /// A new calibration by the beads that may be fitted, where there is one ([`super::recalibrate`]).
    pub anew: Option<&'a Instrument>,
}

/// [`close`], given more.
///
/// # Errors
/// As [`close`].
pub fn close_with(
    instrument: &Instrument,
    seen: &mut Observations,
    session: &str,
    seed: u64,
    given: Given<'_>,
    mut tell: impl FnMut(&str),
) -> Result<Closed, CloseError> {
    if seen.frames.is_empty() {
        return Err(CloseError::Empty);
    }
    tell("records");
    let faults = screen(instrument, seen)?;
    let seen = &*seen;
    let model = Model::new(instrument, seen)?;
    let start = model.state(instrument)?;
    let own = start.terms.len();
    tell("first fit");
    let first = refit(&model, start)?;
    let replicas = replicas(&model, instrument, &first.state)?;
    let before = first.clone();
    let dependences_before = omnibus::test(&model, &first, &replicas.of(&model, &first), seed);
    tell("catalogue");
    let mut search = Search::new(&model, &replicas, first);
    search.exclude = given.exclude.to_vec();
    search.anew = given.anew.map(|anew| held_out_deviance(anew, seen)).transpose()?;
    search.run(Tried::Catalogue, &mut tell)?;
    let mut dependences = omnibus::test(&model, &search.now, &replicas.of(&model, &search.now), seed);
    let mut rest = std::mem::take(&mut search.rest);
    // A name is believed only if nothing without one does better beside it.
    if (structured(&dependences) || !search.found.is_empty()) && !search.asks_for_calibration() {
        tell("terms without a name");
        search.run(Tried::Curves, &mut tell)?;
        search.run(Tried::Maps, &mut tell)?;
        dependences = omnibus::test(&model, &search.now, &replicas.of(&model, &search.now), seed);
    }
    tell("pruning");
    let Pruned { now, found, tests, taken_back } = prune(&model, &replicas, search.now, search.found, own)?;
    let mut notes = Vec::new();
    if !taken_back.is_empty() {
        dependences = omnibus::test(&model, &now, &replicas.of(&model, &now), seed);
        // Their limits are those of what is not there.
        rest.retain(|c| !taken_back.iter().any(|t| t.id() == c.term.id()));
        let absent = taken_back.iter().map(|t| t.switched_off(model.lenses())).collect::<Vec<_>>();
        rest.extend(search::score(&model, &now, &replicas.of(&model, &now), &absent)?.candidates);
        let ids: Vec<&str> = taken_back.iter().map(Term::id).collect();
        notes.push(format!(
            "added on the way and taken back, since not needed beside what was found later: {}",
            ids.join(", ")
        ));
    }
    let unknown = found.iter().any(|f| f.id.starts_with("unknown"));
    let catalogue_incomplete = unknown || structured(&dependences);
    let effects = effects(&model, &before, &now, &found, &tests, own, &faults);
    if instrument.replicates.is_empty() && seen.of(Role::Scene).next().is_some() {
        notes.push(
            "the instrument has no replicates of its calibration: its own uncertainty is not known, and small effects may be errors \
             of the calibration; calibrate again"
                .into(),
        );
    }
    let closing = Closing {
        session: session.into(),
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
    let account = pictured(&model, &before, &now, closing);
    Ok(Closed { instrument: closed(instrument, &model, &now.state), account })
}

/// Looks at the residual of a session and adds nothing.
///
/// # Errors
/// As [`close`].
pub fn residual(
    instrument: &Instrument,
    seen: &mut Observations,
    session: &str,
    seed: u64,
) -> Result<Account, CloseError> {
    if seen.frames.is_empty() {
        return Err(CloseError::Empty);
    }
    let faults = screen(instrument, seen)?;
    let seen = &*seen;
    let model = Model::new(instrument, seen)?;
    let fit = refit(&model, model.state(instrument)?)?;
    let replicas = replicas(&model, instrument, &fit.state)?;
    let dependences = omnibus::test(&model, &fit, &replicas.of(&model, &fit), seed);
    let figures = figures(&model, &fit);
    let closing = Closing {
        session: session.into(),
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

/// Deviance of what no fit has seen, by another instrument.
fn held_out_deviance(instrument: &Instrument, seen: &Observations) -> Result<f64, CloseError> {
    let model = Model::new(instrument, seen)?;
    Ok(refit(&model, model.state(instrument)?)?.held_out.deviance)
}

fn held_out_frames(seen: &Observations) -> Vec<usize> {
    judged(seen).filter(|k| seen.frames[*k].held_out).map(|k| seen.frames[k].info.frame).collect()
}

fn held_out_blocks(seen: &Observations) -> [usize; 2] {
    [seen.held_out_blocks.iter().filter(|h| **h).count(), seen.held_out_blocks.len()]
}

/// Whether any omnibus test passes, and matters.
pub fn structured(dependences: &[Dependence]) -> bool {
    let matters = |d: &&Dependence| d.size.is_none_or(|size| size > SIZE);
    let mut passes =
        dependences.iter().filter(|d| d.p * (dependences.len() as f64) < OMNIBUS).filter(matters).peekable();
    let any = passes.peek().is_some();
    passes.for_each(|d| {
        tracing::info!(
            "residual against {}: z {:.1}, {:.1} for {:.1}, {:?} +- {:?}",
            d.covariate.words(),
            d.z,
            d.chi2,
            d.expected,
            d.mean,
            d.band
        )
    });
    any
}

/// The instrument with the effects of a state.
fn closed(instrument: &Instrument, model: &Model<'_>, state: &State) -> Instrument {
    let effects = state.terms.iter().map(|t| t.setting(model.lenses())).collect();
    Instrument { effects, ..instrument.clone() }
}

/// What is left after pruning.
struct Pruned {
    now: Fitted,
    found: Vec<Found>,
    /// The test of each term.
    tests: Vec<Option<Test>>,
    /// Terms that are no longer needed.
    taken_back: Vec<Term>,
}

/// Takes back what is no longer needed beside the rest; gives the test of each term that stays.
fn prune(
    model: &Model<'_>,
    replicas: &Replicas,
    mut now: Fitted,
    mut found: Vec<Found>,
    own: usize,
) -> Result<Pruned, ForwardError> {
    let mut needed: Vec<&str> = Vec::new();
    let mut taken_back = Vec::new();
    loop {
        let columns: Vec<Column> = nuisances(model).into_iter().chain(own_columns(model, &now.state)).collect();
        let of_frames = replicas.of(model, &now);
        let design = Design::compute(model, &now.state, &[], columns.clone(), &now.predicted, &now.scenes, &of_frames)?;
        let test = |t: usize| -> Option<Test> {
            let of_term = |c: &Column| matches!(c, Column::Own { term, .. } if *term == t);
            let mine: Vec<usize> = (0..columns.len()).filter(|i| of_term(&columns[*i])).collect();
            let others = (0..columns.len()).filter(|i| !of_term(&columns[*i])).collect();
            Scores::new(&design, others).test(&mine)
        };
        let tests: Vec<Option<Test>> = (0..now.state.terms.len()).map(test).collect();
        // Wald: how far the strengths are from where the effect is absent.
        let weakest = (own..tests.len())
            .filter(|t| !needed.contains(&now.state.terms[*t].id()))
            .filter_map(|t| Some((t, wald(model, &now.state.terms[t], tests[t].as_ref()?))))
            .max_by(|a, b| a.1.total_cmp(&b.1));
        match weakest {
            Some((t, p)) if p > search::ALPHA => {
                let mut state = now.state.clone();
                let term = state.terms.remove(t);
                let without = refit(model, state)?;
                // Values that trade against one another are each uncertain while the term as a whole is not.
                let weight = tests[t].as_ref().map_or(1.0, |test| test.phi);
                let rise = (without.training.deviance - now.training.deviance)
                    .max(without.held_out.deviance - now.held_out.deviance);
                if rise / weight > NEEDED {
                    needed.push(term.id());
                } else {
                    found.remove(t - own);
                    taken_back.push(term);
                    now = without;
                }
            }
            _ => {
                now.state = model.gauged(now.state);
                return Ok(Pruned { now, found, tests, taken_back });
            }
        }
    }
}

/// Probability of strengths this far from absence.
fn wald(model: &Model<'_>, term: &Term, test: &Test) -> f64 {
    let (expanded, free) = (term.expanded(model.lenses()), term.free(model.lenses()));
    // Where each strength stands among the columns of the term.
    let strengths: Vec<usize> = (0..free.len()).filter(|i| expanded[free[*i]].1.is_strength()).collect();
    let d = Array1::from_iter(strengths.iter().map(|i| {
        let p = expanded[free[*i]].1;
        p.inner(term.params[free[*i]]) - p.inner(p.off)
    }));
    let covariance = test.covariance.select(ndarray::Axis(0), &strengths).select(ndarray::Axis(1), &strengths);
    let t = d.dot(&super::score::pseudo_inverse(&covariance).dot(&d));
    f_tail(t / d.len() as f64, d.len() as f64, test.nu)
}
