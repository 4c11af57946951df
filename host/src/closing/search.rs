//! The search: score every effect of the catalogue, refit the best, accept on held-out data, until nothing is left.

use super::design::{Design, nuisances};
use super::model::{Column, Model, State, Term};
use super::refit::{Fitted, own_columns, refit};
use super::score::{Scores, Test};
use super::stats::holm;
use crate::effects::{Effect, Evidence, EvidenceFrame, Kind, Stage, registry};
use crate::forward::ForwardError;
use crate::instrument::Instrument;
use ndarray::Array2;
use rayon::prelude::*;

/// Family-wise probability that a complete model is called incomplete.
pub const ALPHA: f64 = 0.02;
/// What one more value must earn in chi-squared.
const PRICE: f64 = 6.0;
/// Effects whose chi-squared is no further from the best are told with it.
pub const AMBIGUOUS: f64 = 10.8;
/// Most effects that are added.
const MOST: usize = 6;
/// How many of the best candidates are fitted in full.
const FINALISTS: usize = 3;

/// An effect that was scored.
#[derive(Clone, Debug)]
pub struct Candidate {
    /// The effect at its best start.
    pub term: Term,
    /// Columns of its strengths in the design.
    pub columns: Vec<usize>,
    /// The test of its strengths; None: the session cannot tell it.
    pub test: Option<Test>,
    /// Starts that were tried.
    pub starts: usize,
}

impl Candidate {
    /// Probability, paid for each start.
    pub fn p(&self) -> f64 {
        self.test.as_ref().map_or(1.0, |t| (t.p * self.starts as f64).min(1.0))
    }

    /// What it earns beyond its price.
    fn worth(&self) -> f64 {
        self.test.as_ref().map_or(f64::NEG_INFINITY, |t| t.t - PRICE * (t.dof + 2.0 * (self.starts as f64).ln()))
    }
}

/// An effect that was found.
#[derive(Clone, Debug)]
pub struct Found {
    /// Its id.
    pub id: &'static str,
    /// Strength of the evidence when it was found.
    pub z: f64,
    /// Effects that would explain nearly the same: id, and the overlap.
    pub ambiguity: Vec<(&'static str, f64)>,
}

/// What came of a search.
pub struct Outcome {
    /// Before anything was added.
    pub before: Fitted,
    /// After.
    pub after: Fitted,
    /// What was added, in order.
    pub found: Vec<Found>,
    /// The last scores: what was not added.
    pub rest: Vec<Candidate>,
    /// Columns and cells of the last scores.
    pub design: Design,
}

/// Every effect that a mean frame can show, at each of its starts.
fn trials(model: &Model<'_>, state: &State, evidence: &Evidence<'_>) -> Vec<Term> {
    let lenses = model.lenses();
    let mut terms = Vec::new();
    for effect in registry().iter().copied() {
        let d = effect.descriptor();
        let taken = state.terms.iter().any(|t| t.id() == d.id);
        if taken || d.stage == Stage::Record || effect.table().is_some() {
            continue;
        }
        let mut starts = effect.guess(evidence);
        if starts.is_empty() {
            starts = grid(effect, lenses);
        }
        terms.extend(starts.into_iter().map(|params| Term { effect, params, table: None }));
    }
    terms
}

/// The starts that a descriptor lists: every combination of its shapes.
fn grid(effect: &'static dyn Effect, lenses: usize) -> Vec<Vec<f64>> {
    let mut starts = vec![Vec::new()];
    for (_, p) in effect.descriptor().expanded(lenses) {
        let values: &[f64] = match p.kind {
            Kind::Shape(tried) if !tried.is_empty() => tried,
            _ => &[p.off],
        };
        starts = starts.iter().flat_map(|s| values.iter().map(move |v| [s.as_slice(), &[*v]].concat())).collect();
    }
    starts
}

/// Residuals of the training frames, for effects that guess.
fn evidence<'c>(model: &'c Model<'_>, fitted: &'c Fitted) -> Evidence<'c> {
    let frame = |k: usize| {
        let here = &fitted.predicted[k];
        EvidenceFrame {
            cx: model.context(k, None),
            residual_dn: here.residual_dn.clone(),
            light_e: here.light_e.clone(),
            weight: here.inverse_sigma.mapv(|w| w * w),
        }
    };
    let training = (0..model.seen.frames.len()).filter(|k| !model.seen.frames[*k].held_out);
    Evidence { frames: training.map(frame).collect() }
}

/// What each replicate of the calibration predicts of each scene, minus what the calibration does, DN.
///
/// # Errors
/// A replicate does not fit the instrument.
pub fn replicas(
    model: &Model<'_>,
    instrument: &Instrument,
    fitted: &Fitted,
) -> Result<Vec<Vec<Option<Array2<f32>>>>, ForwardError> {
    let chain = model.chain(&fitted.state.terms);
    replicates(instrument)
        .iter()
        .map(|psf| {
            let other = Instrument { psf: psf.clone(), effects: Vec::new(), ..instrument.clone() };
            let other = Model::new(&other, model.seen)?;
            let scenes = other.scenes(&chain)?;
            let predicted = other.predict(&fitted.state, &scenes);
            let change = |k: usize| scenes[k].as_ref().map(|_| &predicted[k].dn - &fitted.predicted[k].dn);
            Ok((0..predicted.len()).into_par_iter().map(change).collect())
        })
        .collect()
}

fn replicates(_i: &Instrument) -> &[crate::instrument::LowRankPsf] {
    &[]
}

/// Scores everything that could be added to a state.
fn score(
    model: &Model<'_>,
    fitted: &Fitted,
    replicas: &[Vec<Option<Array2<f32>>>],
) -> Result<(Design, Vec<usize>, Vec<Candidate>), ForwardError> {
    let terms = trials(model, &fitted.state, &evidence(model, fitted));
    let given: Vec<Column> = nuisances(model).into_iter().chain(own_columns(model, &fitted.state)).collect();
    let taken: Vec<usize> = (0..given.len()).collect();
    let mut columns = given;
    let mut spans = Vec::new();
    for (t, term) in terms.iter().enumerate() {
        let first = columns.len();
        columns.extend(term.strengths(model.lenses()).into_iter().map(|param| Column::Trial { term: t, param }));
        spans.push(first..columns.len());
    }
    let design = Design::compute(model, &fitted.state, &terms, columns, &fitted.predicted, &fitted.scenes, replicas)?;
    let scores = Scores::new(&design, taken.clone());
    let mut candidates: Vec<Candidate> = Vec::new();
    for (term, span) in terms.iter().zip(spans) {
        let columns: Vec<usize> = span.collect();
        let test = scores.test(&columns).map(|t| one_sided(model, term, t));
        let starts = terms.iter().filter(|t| t.id() == term.id()).count();
        let candidate = Candidate { term: term.clone(), columns, test, starts };
        match candidates.iter_mut().find(|c| c.term.id() == term.id()) {
            Some(best) if candidate.worth() > best.worth() => *best = candidate,
            Some(_) => {}
            None => candidates.push(candidate),
        }
    }
    Ok((design, taken, candidates))
}

/// A single strength that cannot be below `off` is no evidence where it comes out there.
fn one_sided(model: &Model<'_>, term: &Term, test: Test) -> Test {
    let strengths = term.strengths(model.lenses());
    let expanded = term.expanded(model.lenses());
    let impossible = |i: usize| {
        let p = expanded[strengths[i]].1;
        (p.min == p.off && test.theta[i] < 0.0) || (p.max == p.off && test.theta[i] > 0.0)
    };
    if test.theta.len() == 1 && impossible(0) { Test { t: 0.0, p: 1.0, z: 0.0, ..test } } else { test }
}

/// The state with a candidate added at its estimate.
fn with(model: &Model<'_>, state: &State, candidate: &Candidate) -> State {
    let mut next = state.clone();
    let mut term = candidate.term.clone();
    if let Some(test) = &candidate.test {
        let expanded = term.expanded(model.lenses());
        for (i, v) in term.strengths(model.lenses()).into_iter().zip(&test.theta) {
            let p = expanded[i].1;
            term.params[i] = (p.off + v).clamp(p.min, p.max);
        }
    }
    next.terms.push(term);
    next
}

/// Searches from the state that an instrument stands for.
///
/// # Errors
/// An object is no light, or the parts of the instrument disagree.
pub fn search(
    model: &Model<'_>,
    instrument: &Instrument,
    start: State,
    mut tell: impl FnMut(&str),
) -> Result<Outcome, ForwardError> {
    let mut now = refit(model, start)?;
    let before = now.clone();
    let replicas = replicas(model, instrument, &now)?;
    let mut found: Vec<Found> = Vec::new();
    let mut refused: Vec<&'static str> = Vec::new();
    loop {
        let (design, taken, mut candidates) = score(model, &now, &replicas)?;
        candidates.sort_by(|a, b| b.worth().total_cmp(&a.worth()));
        for c in candidates.iter().take(6) {
            if let Some(t) = &c.test {
                tracing::info!(
                    "{} {:?}: z {:.2} t {:.1} gain {:.1} phi {:.2} nu {:.0} dof {} theta {:?}",
                    c.term.id(),
                    c.term.params,
                    t.z,
                    t.t,
                    t.gain,
                    t.phi,
                    t.nu,
                    t.dof,
                    t.theta
                );
            }
        }
        let p: Vec<f64> = candidates.iter().map(Candidate::p).collect();
        let significant = holm(&p, ALPHA);
        let open = |c: &Candidate| !refused.contains(&c.term.id());
        let finalists: Vec<&Candidate> = candidates
            .iter()
            .zip(&significant)
            .filter(|(c, s)| **s && open(c))
            .map(|(c, _)| c)
            .take(FINALISTS)
            .collect();
        if finalists.is_empty() || found.len() >= MOST {
            return Ok(Outcome { before, after: now, found, rest: candidates, design });
        }
        // The linear ranking is confirmed by full fits; each pays for its values.
        let mut fitted = Vec::new();
        for c in &finalists {
            tell(c.term.id());
            let fit = refit(model, with(model, &now.state, c))?;
            let phi = c.test.as_ref().map_or(1.0, |t| (t.gain / t.t.max(1e-9)).max(1.0));
            let worth = (now.chi2 - fit.chi2) / phi - PRICE * c.columns.len() as f64;
            tracing::info!(
                "  refit {} {:?}: gain {:.1} worth {:.1} held out {:.1}",
                c.term.id(),
                fit.state.terms.last(),
                now.chi2 - fit.chi2,
                worth,
                now.held_out.0 - fit.held_out.0
            );
            fitted.push((worth, fit, *c));
        }
        fitted.sort_by(|a, b| b.0.total_cmp(&a.0));
        let Some((worth, best, candidate)) = fitted.into_iter().next() else { continue };
        let taken_scores = Scores::new(&design, taken);
        // chi-squared rewards wider errors: what acts on the noise alone is judged by held-out repeats, at fixed errors.
        let gain = match candidate.term.effect.noise_only() {
            true => taken_scores.held_out_gain(&candidate.columns, |c| c.frame >= model.seen.frames.len()).0,
            false => now.held_out.0 - best.held_out.0,
        };
        if gain <= 0.0 || worth <= 0.0 {
            refused.push(candidate.term.id());
            continue;
        }
        let scores = taken_scores;
        let test = candidate.test.as_ref();
        let theta = test.map_or(&[][..], |t| &t.theta);
        let top = test.map_or(0.0, |t| t.t);
        let ambiguity = candidates
            .iter()
            .filter(|c| c.term.id() != candidate.term.id())
            .filter(|c| c.test.as_ref().is_some_and(|t| t.t > top - AMBIGUOUS && t.t > 0.0))
            .map(|c| (c.term.id(), scores.overlap(&candidate.columns, theta, &c.columns)))
            .collect();
        found.push(Found { id: candidate.term.id(), z: test.map_or(0.0, |t| t.z), ambiguity });
        now = best;
    }
}
