//! Two effects that hide each other.
//!
//! Forward selection asks of each effect whether it explains the data alone. Where two causes act at once, neither may:
//! what the other one leaves scatters so much between frames and blocks that the evidence for the first drowns in it,
//! or a third effect that resembles their sum comes first. So pairs are tested together ([`Scores::test`] of the
//! columns of both, whose scatter is that beside both), the best are fitted in full, and a pair is added where each of
//! the two is significant beside the other.

use super::candidate::{Candidate, Found, PENALTY};
use super::confirm::{Added, excess_left, fitted_beside, weight};
use super::scoring::{is_possible, score};
use super::select::{ALPHA, SHADOW, Search};
use super::trials::{NEEDS_CALIBRATION, Tried};
use crate::evidence::{Scores, Test, holm};
use crate::fit::{Column, Design, Fitted, Scope, Term, fitted_columns};
use ommatidia_model::forward::ForwardError;
use rayon::prelude::*;

/// Number of effects that are paired with one another: those that explain most alone, by the noise.
const PAIRED: usize = 24;
/// Number of pairs that are fitted in full.
const FITTED: usize = 3;

/// Two candidates, by their places in a list, with their common test.
struct Pair {
    places: [usize; 2],
    test: Test,
    /// Number of strengths of the first.
    first: usize,
}

impl Search<'_, '_> {
    /// Adds the best pair of effects of the catalogue that stands the full fit, and searches on. Returns false if there
    /// is none. Does nothing beside estimated specimens, as [`Search::exchange`].
    ///
    /// # Errors
    /// An object holds negative or non-finite light.
    pub fn add_pair(&mut self, progress: &mut dyn FnMut(&str)) -> Result<bool, ForwardError> {
        if self.now.state.specimens.is_some() || self.is_full(Tried::Catalogue) {
            return Ok(false);
        }
        let one_of_two = |c: &&Candidate| {
            let effect = c.term.effect;
            let is_name = !c.term.id().starts_with("unknown") && c.term.id() != NEEDS_CALIBRATION;
            c.test.is_some() && is_name && !effect.noise_only() && !effect.is_of_truths()
        };
        let mut able: Vec<Candidate> = self.rest.iter().filter(one_of_two).cloned().collect();
        able.sort_by(|a, b| b.gain().total_cmp(&a.gain()));
        able.truncate(PAIRED);
        let Some((pair, fit)) = self.best_pair(&able, progress)? else { return Ok(false) };
        let Some(found) = self.each_beside_the_other(&able, &pair, &fit)? else { return Ok(false) };
        self.strongest_fall = self.strongest_fall.max(self.now.training.deviance - fit.training.deviance);
        self.found.extend(found);
        self.now = fit;
        self.run(Tried::Catalogue, progress)?;
        Ok(true)
    }

    /// The pair whose full fit saves most, with that fit. Its terms are the last two of the state.
    fn best_pair(
        &self,
        able: &[Candidate],
        progress: &mut dyn FnMut(&str),
    ) -> Result<Option<(Pair, Fitted)>, ForwardError> {
        let lenses = self.model.lenses();
        let mut best: Option<(f64, Pair, Fitted)> = None;
        for pair in self.pairs(able)? {
            let [a, b] = pair.places.map(|at| &able[at]);
            let names = format!("{} and {}", a.term.id(), b.term.id());
            progress(&names);
            let (of_a, of_b) = pair.test.theta.split_at(pair.first);
            let both = [(a, of_a), (b, of_b)].map(|(c, theta)| c.term.clone().moved(lenses, theta));
            let fit = self.beside(&both)?;
            let strengths = both.iter().map(|t| t.strengths(lenses).len()).sum::<usize>() as f64;
            let price = PENALTY * strengths * weight(Some(&pair.test), excess_left(&self.now, [&fit]));
            let saved = self.now.training.deviance - fit.training.deviance - price;
            tracing::info!("{names} together: {saved:.1} saved");
            if saved > best.as_ref().map_or(0.0, |b| b.0) && fit.held_out.deviance < self.now.held_out.deviance {
                best = Some((saved, pair, fit));
            }
        }
        Ok(best.map(|(_, pair, fit)| (pair, fit)))
    }

    /// What is found of each of a pair, beside the other one alone. None: one of the two is not significant there.
    fn each_beside_the_other(
        &mut self,
        able: &[Candidate],
        pair: &Pair,
        fit: &Fitted,
    ) -> Result<Option<Vec<Found>>, ForwardError> {
        let mut found = Vec::new();
        for (me, other) in [(0, 1), (1, 0)].map(|places| (pair.places[places.0], pair.places[places.1])) {
            let [id, beside] = [me, other].map(|at| able[at].term.id());
            let Some(term) = fit.state.terms.iter().rev().take(2).find(|t| t.id() == beside) else { return Ok(None) };
            let alone = self.beside(std::slice::from_ref(term))?;
            let trials: Vec<Term> = able.iter().map(|c| c.term.clone()).filter(|t| t.id() != beside).collect();
            let candidates = score(self.model, &alone, &self.replicas.of(self.model, &alone)?, &trials)?;
            let significant = holm(&candidates.iter().map(Candidate::p).collect::<Vec<_>>(), ALPHA);
            let gain = alone.held_out.deviance - fit.held_out.deviance;
            let mine = candidates.iter().zip(significant).find(|(c, _)| c.term.id() == id);
            let Some((candidate, _)) = mine.filter(|(c, significant)| *significant && self.stands_out(c, gain)) else {
                tracing::info!("{id} does not stand beside {beside}");
                return Ok(None);
            };
            let before = std::mem::replace(&mut self.now, alone);
            let added = Added { fit: fit.clone(), candidate, gain, behind: Vec::new() };
            let it = self.describe(&candidates, &added);
            self.now = before;
            found.push(it?);
        }
        Ok(Some(found))
    }

    /// The present state with other terms beside its own, fitted.
    fn beside(&self, terms: &[Term]) -> Result<Fitted, ForwardError> {
        let mut state = self.now.state.clone();
        state.terms.extend_from_slice(terms);
        fitted_beside(self.model, state, &self.now, terms)
    }

    /// The pairs that are significant together, the best first.
    fn pairs(&self, able: &[Candidate]) -> Result<Vec<Pair>, ForwardError> {
        let (model, lenses) = (self.model, self.model.lenses());
        let mut columns: Vec<Column> = fitted_columns(model, &self.now.state);
        let given: Vec<usize> = (0..columns.len()).collect();
        let mut spans: Vec<Vec<usize>> = Vec::new();
        for (t, c) in able.iter().enumerate() {
            let first = columns.len();
            columns.extend(c.term.trial_columns(lenses).into_iter().map(|param| Column::Trial { term: t, param }));
            spans.push((first..columns.len()).collect());
        }
        let terms: Vec<Term> = able.iter().map(|c| c.term.clone()).collect();
        let errors = self.replicas.of(model, &self.now)?;
        let design = Design::compute(model, self.now.expansion(&terms), columns, &errors, Scope::Training)?;
        let scores = Scores::new(&design, given);
        let all: Vec<[usize; 2]> = (0..able.len()).flat_map(|b| (0..b).map(move |a| [a, b])).collect();
        let tested = |places: &[usize; 2]| {
            let test = scores.test(&places.map(|at| spans[at].as_slice()).concat())?;
            let first = spans[places[0]].len();
            let (of_a, of_b) = test.theta.split_at(first);
            let possible =
                is_possible(model, &able[places[0]].term, of_a) && is_possible(model, &able[places[1]].term, of_b);
            let chances = places.iter().map(|at| able[*at].chances).product::<f64>() * all.len() as f64;
            let alone = places.iter().map(|at| able[*at].gain()).fold(0.0, f64::max);
            let more = test.gain > 1.1 * alone;
            (possible && more && test.p * chances < ALPHA).then_some(Pair { places: *places, test, first })
        };
        // The score of a pair in the shadow of a stronger effect shows that already, as for single effects.
        let floor = SHADOW * self.cast_by(self.strongest_fall, self.now.training);
        let shadowed = |at: &usize| able[*at].can_be_shadowed(self.now.training.pixels);
        let in_shadow = |pair: &Pair| pair.test.gain < floor && pair.places.iter().any(shadowed);
        let mut pairs: Vec<Pair> = all.par_iter().filter_map(tested).filter(|p| !in_shadow(p)).collect();
        // Where both are there, little scatter is left beside them.
        let least = pairs.iter().map(|p| p.test.phi).fold(f64::INFINITY, f64::min);
        let worth = |p: &Pair| p.test.gain - PENALTY * p.test.dof * least;
        pairs.sort_by(|a, b| worth(b).total_cmp(&worth(a)));
        pairs.truncate(FITTED);
        Ok(pairs)
    }
}
