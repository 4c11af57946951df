//! Candidates with their evidence beside a fitted state.

use super::candidate::Candidate;
use super::trials::Tried;
use crate::evidence::{Scores, TableFit, Test, maps, tables};
use crate::fit::{Column, Design, Errors, Fitted, Model, Scope, Term, fitted_columns};
use ommatidia_model::forward::ForwardError;
use ommatidia_session::Role;

/// A term without a name is tried only if at least this share of its squared norm is independent of the model's
/// columns.
const DISTINCT: f64 = 0.1;

/// Scores trial terms beside a fitted state: each effect at the best of its starting values.
///
/// # Errors
/// An object holds negative or non-finite light.
pub(crate) fn score(
    model: &Model<'_>,
    fitted: &Fitted,
    errors: &Errors,
    terms: &[Term],
) -> Result<Vec<Candidate>, ForwardError> {
    let given: Vec<Column> = fitted_columns(model, &fitted.state);
    let taken: Vec<usize> = (0..given.len()).collect();
    let mut columns = given;
    let mut spans = Vec::new();
    for (t, term) in terms.iter().enumerate() {
        let first = columns.len();
        columns.extend(term.trial_columns(model.lenses()).into_iter().map(|param| Column::Trial { term: t, param }));
        spans.push(first..columns.len());
    }
    let scope = Scope::Scores { given: taken.len(), groups: &spans };
    let design = Design::compute(model, fitted.expansion(terms), columns, errors, scope)?;
    let scores = Scores::new(&design, taken);
    let scenes = model.seen.of(Role::Scene).count();
    let mut candidates: Vec<Candidate> = Vec::new();
    for (term, span) in terms.iter().zip(spans) {
        let columns: Vec<usize> = span.collect();
        let unnamed = term.id().starts_with("unknown");
        let test = scores.test(&columns).filter(|t| !unnamed || t.left > DISTINCT).map(|t| one_sided(model, term, t));
        let starts = terms.iter().filter(|t| t.id() == term.id()).count() as f64;
        let chances = starts.max(term.effect.chances(model.seen.sensor, scenes));
        let candidate = Candidate { term: term.clone(), columns, test, chances, table: None };
        let near = candidate.is_near_its_start(model.lenses());
        match candidates.iter_mut().find(|c| c.term.id() == term.id()) {
            Some(best) if near && candidate.is_better_start(best) => *best = candidate,
            Some(_) => {}
            None => candidates.push(candidate),
        }
    }
    Ok(candidates)
}

/// Sets the evidence of a single strength to zero if its estimate has the forbidden sign.
fn one_sided(model: &Model<'_>, term: &Term, mut test: Test) -> Test {
    if term.is_far(model.lenses()) {
        return test;
    }
    let strengths = term.strengths(model.lenses());
    let expanded = term.expanded(model.lenses());
    let impossible = |i: usize| expanded[strengths[i]].1.forbidden_side() * test.theta[i] > 0.0;
    if test.theta.len() == 1 && impossible(0) {
        test.discard();
    }
    test
}

/// Candidates with an estimated table.
pub(super) fn tabled(model: &Model<'_>, now: &Fitted, tried: Tried) -> Vec<Candidate> {
    let fits = match tried {
        Tried::Curves => Vec::new(),
        Tried::Catalogue => tables::fit(model, &now.state, &now.predicted, true),
        Tried::Maps => {
            let mut fits = tables::fit(model, &now.state, &now.predicted, false);
            fits.extend(maps::fit(model, &now.state, &now.predicted));
            fits
        }
    };
    let candidate =
        |t: TableFit| Candidate { term: t.term.clone(), columns: Vec::new(), test: None, chances: 1.0, table: Some(t) };
    fits.into_iter().map(candidate).collect()
}

/// Writes the best candidates to the log.
pub(super) fn log(candidates: &[Candidate]) {
    for c in candidates.iter().take(6) {
        if let Some(t) = &c.test {
            tracing::info!(
                "{} {:?}: z {:.2}, t {:.1}, gain {:.1}, phi {:.2}, nu {:.0}, dof {}, theta {:?}",
                c.term.id(),
                c.term.params,
                t.z,
                t.t,
                t.gain,
                t.phi,
                t.nu,
                t.dof,
                &t.theta[..t.theta.len().min(3)]
            );
        } else if let Some(t) = &c.table {
            tracing::info!("{} table: z {:.2}, size {:?} +- {:.2e}", c.term.id(), t.z, t.term.params.first(), t.sigma);
        }
    }
}
