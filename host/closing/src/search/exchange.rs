//! Exchanges a found effect for one that explains the data better beside the others.
//!
//! Forward selection names first what explains most alone. Where two causes act at once, that may be an effect which
//! resembles their sum, and the next one then mends what it left. Once all are found, each is taken out in turn and
//! those that resemble it are tried in its place beside the others (sequential replacement: Miller, Subset Selection in
//! Regression, 2nd ed., 2002, section 3.4). What is no longer needed then is pruned later.

use super::candidate::{AMBIGUOUS, Candidate, Found, PENALTY};
use super::confirm::{Added, excess_left, fitted_beside, trace, weight, with};
use super::finalists::alike;
use super::scoring::score;
use super::select::{SHADOW, Search};
use super::trials::{Tried, evidence};
use crate::fit::{Fitted, Term};
use ommatidia_model::forward::ForwardError;
use ommatidia_physics::effects::Kind;
use std::cmp::Ordering;

/// Number of effects that are tried in the place of one.
const TRIED: usize = 2;

impl Search<'_, '_> {
    /// Exchanges found effects of the catalogue, where there are two or more, until none is better replaced. Searches
    /// on after each exchange. Does nothing beside estimated specimens: each trial would have to estimate them again,
    /// and what they take of an effect differs from one to the next.
    ///
    /// # Errors
    /// An object holds negative or non-finite light.
    pub fn exchange(&mut self, progress: &mut dyn FnMut(&str)) -> Result<(), ForwardError> {
        if self.now.state.specimens.is_some() {
            return Ok(());
        }
        // An effect that was replaced does not come back in the place of the one that replaced it.
        let mut replaced: Vec<&'static str> = Vec::new();
        while let Some(old) = self.exchanged(&replaced, progress)? {
            replaced.push(old);
            self.run(Tried::Catalogue, progress)?;
        }
        Ok(())
    }

    /// Exchanges the first effect for which another one is better. Gives the id of the one that is out.
    fn exchanged(
        &mut self,
        replaced: &[&'static str],
        progress: &mut dyn FnMut(&str),
    ) -> Result<Option<&'static str>, ForwardError> {
        let open = |f: &Found| !f.id.starts_with("unknown") && f.table_sigma.is_none();
        if self.found.iter().filter(|f| open(f)).count() < 2 {
            return Ok(None);
        }
        let own = self.now.state.terms.len() - self.found.len();
        for i in (0..self.found.len()).filter(|i| open(&self.found[*i])) {
            let mut state = self.now.state.clone();
            let old = state.terms.remove(own + i);
            let terms = self.in_place_of(&self.found[i], &old, replaced);
            if terms.is_empty() {
                continue;
            }
            progress(old.id());
            let without = fitted_beside(self.model, state, &self.now, std::slice::from_ref(&old))?;
            let errors = self.replicas.of(self.model, &without)?;
            let mut candidates = score(self.model, &without, &errors, &terms)?;
            candidates.retain(|c| c.worth() > 0.0);
            candidates.sort_by(|a, b| b.gain().total_cmp(&a.gain()));
            candidates.truncate(TRIED);
            let mut best: Option<(f64, usize, Fitted)> = None;
            for (at, c) in candidates.iter().enumerate() {
                progress(c.term.id());
                let next = with(self.model, &without.state, c);
                let fit = fitted_beside(self.model, next, &without, std::slice::from_ref(&c.term))?;
                let saved = self.saved(&old, &without, (c, &fit));
                tracing::info!("{} in place of {}: {saved:.1} saved", c.term.id(), old.id());
                if saved > best.as_ref().map_or(0.0, |b| b.0) {
                    best = Some((saved, at, fit));
                }
            }
            if let Some((_, at, fit)) = best {
                let gain = without.held_out.deviance - fit.held_out.deviance;
                self.found.remove(i);
                self.now = without;
                let added = Added { fit, candidate: &candidates[at], gain, behind: Vec::new() };
                let found = self.describe(&candidates, &added)?;
                self.found.push(found);
                self.now = added.fit;
                return Ok(Some(old.id()));
            }
        }
        Ok(None)
    }

    /// The trial terms that may stand in the place of a found effect: those that the catalogue lists as similar, and
    /// those that explained nearly as much when it was added.
    fn in_place_of(&self, found: &Found, old: &Term, replaced: &[&'static str]) -> Vec<Term> {
        let mut terms = Tried::Catalogue.terms(self.model, &self.now.state, &evidence(self.model, &self.now));
        terms.retain(|t| {
            let near = alike(t, old) || found.ambiguity.iter().any(|a| a.id == t.id());
            near && !replaced.contains(&t.id()) && !self.exclude.iter().any(|e| e == t.id())
        });
        terms
    }

    /// By how much the deviance is lower with another effect in the place of `old`, each with the penalty of its
    /// values, beyond what makes two effects ambiguous. What the law of an effect errs by counts for the simpler one:
    /// it may be worse by so much, and one of more values must be better by so much, since its freedom mends what is
    /// left of any law. 0 where held-out data are predicted worse by more than that.
    fn saved(&self, old: &Term, without: &Fitted, (c, fit): (&Candidate, &Fitted)) -> f64 {
        let values = |t: &Term| Values::of(t, self.model.lenses());
        let (of_new, of_old) = (values(&c.term), values(old));
        let weight = weight(c.test.as_ref(), excess_left(without, [&self.now, fit]));
        let price = PENALTY * weight * (of_new.strengths as f64 - of_old.strengths as f64);
        let explained = without.training.deviance - self.now.training.deviance;
        let of_law = trace(explained);
        // Values for each lens follow any simpler effect, and what the law of that one leaves.
        let is_of_lenses = of_new.strengths >= self.model.lenses() && self.model.lenses() > 1;
        let left = if is_of_lenses { SHADOW * explained } else { of_law };
        let margin = match of_new.all.cmp(&of_old.all) {
            Ordering::Less => -of_law,
            Ordering::Equal => AMBIGUOUS * weight,
            Ordering::Greater => left.max(AMBIGUOUS * weight),
        };
        let fall = |of: fn(&Fitted) -> f64| of(&self.now) - of(fit);
        let is_worse = fall(|f| f.held_out.deviance) < margin.min(0.0);
        if is_worse { 0.0 } else { (fall(|f| f.training.deviance) - price - margin).max(0.0) }
    }
}

/// Numbers of values that the fit of an effect determines.
struct Values {
    strengths: usize,
    /// With the shapes that the strengths have in common.
    all: usize,
}

impl Values {
    fn of(term: &Term, lenses: usize) -> Self {
        let strengths = term.strengths(lenses).len();
        let shapes = term.effect.descriptor().params.iter().filter(|p| matches!(p.kind, Kind::Shape(_)));
        Self { strengths, all: strengths + shapes.count() }
    }
}
