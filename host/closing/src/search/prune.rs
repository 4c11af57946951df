//! Backward elimination: effects that are not needed beside the others are removed again.

use super::candidate::Found;
use super::select::ALPHA;
use crate::evidence::{Constancy, Scores, Test, f_tail};
use crate::fit::{Column, Design, Fitted, Model, Replicas, Scope, Term, fitted_columns, pseudo_inverse, refit};
use ndarray::Array1;
use ommatidia_model::forward::ForwardError;

/// A term is kept if its removal raises the deviance by more than this, over the scatter between clusters.
const NEEDED: f64 = 16.0;

/// Result of the pruning.
#[derive(Clone)]
pub(crate) struct Pruned {
    pub(crate) now: Fitted,
    pub(crate) found: Vec<Found>,
    /// The test of each term of the state.
    pub(crate) tests: Vec<Option<Test>>,
    /// Whether each term of the state has one strength everywhere.
    pub(crate) constancy: Vec<Constancy>,
    /// Terms that were removed.
    pub(crate) removed: Vec<Term>,
}

/// Removes terms that are not needed beside the others, the least significant first, and tests those that are kept. The
/// first `own` terms of the state belong to the instrument and are kept; so are terms with an id in `keep`.
pub(crate) fn prune(
    model: &Model<'_>,
    replicas: &Replicas,
    mut now: Fitted,
    mut found: Vec<Found>,
    (own, keep): (usize, &[&'static str]),
) -> Result<Pruned, ForwardError> {
    let mut needed = keep.to_vec();
    let mut removed = Vec::new();
    loop {
        let columns: Vec<Column> = fitted_columns(model, &now.state);
        let errors = replicas.of(model, &now)?;
        let design = Design::compute(model, now.expansion(&[]), columns.clone(), &errors, Scope::Training)?;
        let test = |t: usize| -> Option<Test> {
            let of_term = |c: &Column| matches!(c, Column::Own { term, .. } if *term == t);
            let mine: Vec<usize> = (0..columns.len()).filter(|i| of_term(&columns[*i])).collect();
            let others = (0..columns.len()).filter(|i| !of_term(&columns[*i])).collect();
            Scores::new(&design, others).test(&mine)
        };
        let tests: Vec<Option<Test>> = (0..now.state.terms.len()).map(test).collect();
        // Wald tests of the strengths.
        let weakest = (own..tests.len())
            .filter(|t| !needed.contains(&now.state.terms[*t].id()))
            .filter_map(|t| match &tests[t] {
                Some(test) => Some((t, wald(model, &now.state.terms[t], test))),
                // The others hold all that its values can do.
                None => columns.iter().any(|c| matches!(c, Column::Own { term, .. } if *term == t)).then_some((t, 1.0)),
            })
            .max_by(|a, b| a.1.total_cmp(&b.1));
        match weakest {
            Some((t, p)) if p > ALPHA => {
                let mut state = now.state.clone();
                let term = state.terms.remove(t);
                let without = refit(model, state)?;
                // Correlated parameters are uncertain one by one although the term as a whole is not.
                let weight = tests[t].as_ref().map_or(1.0, |test| test.phi);
                let rise = (without.training.deviance - now.training.deviance)
                    .max(without.held_out.deviance - now.held_out.deviance);
                if rise / weight > NEEDED {
                    needed.push(term.id());
                } else {
                    found.remove(t - own);
                    removed.push(term);
                    now = without;
                }
            }
            _ => {
                let constancy = (0..now.state.terms.len()).map(|t| Constancy::of(model, &now, &design, t)).collect();
                now.state = model.gauged(now.state);
                return Ok(Pruned { now, found, tests, constancy, removed });
            }
        }
    }
}

/// Wald test: probability that the strengths of a term are this far from the values at which it is absent.
fn wald(model: &Model<'_>, term: &Term, test: &Test) -> f64 {
    let (expanded, free) = (term.expanded(model.lenses()), term.free(model.lenses()));
    // Positions of the strengths among the columns of the term.
    let strengths: Vec<usize> = (0..free.len()).filter(|i| expanded[free[*i]].1.is_strength()).collect();
    let d = Array1::from_iter(strengths.iter().map(|i| {
        let p = expanded[free[*i]].1;
        p.inner(term.params[free[*i]]) - p.inner(p.off)
    }));
    let covariance = test.covariance.select(ndarray::Axis(0), &strengths).select(ndarray::Axis(1), &strengths);
    let t = d.dot(&pseudo_inverse(&covariance).dot(&d));
    f_tail(t / d.len() as f64, d.len() as f64, test.nu)
}
