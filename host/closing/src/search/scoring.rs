//! Candidates with their evidence beside a fitted state.

use super::candidate::Candidate;
use super::trials::Tried;
use crate::data::Shown;
use crate::evidence::maps::Beside;
use crate::evidence::{Scores, TableFit, Test, maps, tables};
use crate::fit::{Column, Design, Errors, Fitted, Model, Scope, Term, fitted_columns};
use ommatidia_model::forward::ForwardError;
use ommatidia_physics::effects::Stage;
use ommatidia_session::Role;

/// Evidence in flats and darks alone from which they prove an effect, standard deviations, and the least share of what
/// it explains that they hold.
const PROVED: f64 = 5.0;
const MOST: f64 = 0.5;

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
    let scores = Scores::new(&design, taken.clone());
    // Light that is even, and the dark, do not show the optics.
    let even = |k: usize| model.seen.frames.get(k).is_some_and(|f| matches!(f.shown, Shown::Even | Shown::Dark));
    let in_even_light = Scores::on(&design, taken, |c| even(c.frame));
    let proved = |term: &Term, columns: &[usize], test: &Option<Test>| {
        let of_sensor = matches!(term.effect.descriptor().stage, Stage::Charge | Stage::Electronics);
        let Some(all) = test.as_ref().filter(|_| of_sensor && !term.effect.noise_only()) else { return false };
        let holds_most = |t: &Test| t.z > PROVED && t.gain > MOST * all.gain;
        in_even_light.test(columns).is_some_and(|t| holds_most(&t))
    };
    let scenes = model.seen.of(Role::Scene).count();
    let mut candidates: Vec<Candidate> = Vec::new();
    for (term, span) in terms.iter().zip(spans) {
        let columns: Vec<usize> = span.collect();
        let unnamed = term.id().starts_with("unknown");
        let test = scores.test(&columns).filter(|t| !unnamed || t.left > DISTINCT).map(|t| one_sided(model, term, t));
        let starts = terms.iter().filter(|t| t.id() == term.id()).count() as f64;
        let chances = starts.max(term.effect.chances(model.seen.sensor, scenes));
        let proved_by_even_light = proved(term, &columns, &test);
        let candidate = Candidate { term: term.clone(), columns, test, chances, table: None, proved_by_even_light };
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
    if !is_possible(model, term, &test.theta) {
        test.discard();
    }
    test
}

/// Whether the sign of a single strength is one that its effect can have. A far start has its own.
pub(super) fn is_possible(model: &Model<'_>, term: &Term, theta: &[f64]) -> bool {
    let &[theta] = theta else { return true };
    let (strengths, expanded) = (term.strengths(model.lenses()), term.expanded(model.lenses()));
    term.is_far(model.lenses()) || expanded[strengths[0]].1.forbidden_side() * theta <= 0.0
}

/// Candidates with an estimated table.
pub(super) fn tabled(model: &Model<'_>, now: &Fitted, tried: Tried) -> Vec<Candidate> {
    let fits = match tried {
        Tried::Curves => Vec::new(),
        Tried::Catalogue => tables::fit(model, &now.state, &now.predicted, true),
        Tried::Maps => {
            let mut fits = tables::fit(model, &now.state, &now.predicted, false);
            fits.extend(maps::fit(model, Beside::of(now)));
            fits
        }
    };
    let candidate = |t: TableFit| Candidate {
        term: t.term.clone(),
        columns: Vec::new(),
        test: None,
        chances: 1.0,
        table: Some(t),
        proved_by_even_light: false,
    };
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
