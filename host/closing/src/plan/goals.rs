//! What a plan is to reach, in columns of the design.

use super::Found;
use super::information::Information;
use super::result::Goal;
use crate::fit::{Column, Model, Term};
use crate::search::{Tried, evidence};
use ommatidia_physics::effects::Stage;

/// Strength of an effect that is not testable now, in steps of its parameter.
const STEPS: f64 = 10.0;

/// A goal with its columns.
pub(crate) struct Question {
    goal: Goal,
    mine: Vec<Column>,
    theta: Vec<f64>,
    beside: Vec<Column>,
}

impl Question {
    /// The goal, with what the session gives.
    pub(crate) fn goal(&self, sigmas_now: f64) -> Goal {
        Goal { sigmas_now, ..self.goal.clone() }
    }

    /// Standard deviations by several measurements: those that make one session, or one that is a session of its own.
    pub(crate) fn sigmas(&self, parts: &[Information]) -> f64 {
        let (alone, together): (Vec<&Information>, Vec<_>) = parts.iter().partition(|p| p.alone);
        let of = |parts: &[&Information]| Information::sigmas(parts, &self.mine, &self.theta, &self.beside);
        alone.into_iter().map(|p| of(&[p])).fold(of(&together), f64::max)
    }
}

/// The questions of a session, and the trial terms that their columns vary.
pub(crate) fn questions(model: &Model<'_>, found: &Found<'_>) -> (Vec<Question>, Vec<Term>) {
    let lenses = model.lenses();
    let state = &found.now.state;
    let catalogue = Tried::Catalogue.terms(model, state, &evidence(model, found.now));
    let mut trials: Vec<Term> = Vec::new();
    // Columns of the strengths of an effect: its own, or those of a trial term.
    let mut columns = |id: &str| -> Option<(Term, Vec<Column>)> {
        if let Some(term) = state.terms.iter().position(|t| t.id() == id) {
            let of = |param| Column::Own { term, param };
            return Some((
                state.terms[term].clone(),
                state.terms[term].strengths(lenses).into_iter().map(of).collect(),
            ));
        }
        let it = catalogue.iter().find(|t| t.id() == id)?;
        let term = trials.iter().position(|t| t.id() == id).unwrap_or_else(|| {
            trials.push(it.clone());
            trials.len() - 1
        });
        Some((it.clone(), it.strengths(lenses).into_iter().map(|param| Column::Trial { term, param }).collect()))
    };
    let mut out = Vec::new();
    for (id, others) in &found.ambiguous {
        for other in others {
            let (Some((term, mine)), Some((_, beside))) = (columns(id), columns(other)) else { continue };
            if term.table.is_some() || mine.is_empty() {
                continue;
            }
            let expanded = term.expanded(lenses);
            let strengths = term.strengths(lenses);
            let theta = |i: &usize| expanded[*i].1.inner(term.params[*i]) - expanded[*i].1.inner(expanded[*i].1.off);
            let (name, p) = &expanded[strengths[0]];
            let goal = Goal {
                id: id.clone(),
                other: Some(other.clone()),
                param: name.clone(),
                strength: term.params[strengths[0]],
                unit: p.unit.into(),
                sigmas_now: 0.0,
            };
            out.push(Question { goal, mine, theta: strengths.iter().map(theta).collect(), beside });
        }
    }
    for id in &found.untestable {
        let Some((term, mine)) = columns(id).filter(|(t, _)| t.effect.descriptor().stage != Stage::Record) else {
            continue;
        };
        let expanded = term.expanded(lenses);
        let Some(first) = term.strengths(lenses).first().copied() else { continue };
        let (name, p) = &expanded[first];
        let strength = p.outer(p.off + STEPS * p.step);
        let goal =
            Goal { id: id.clone(), other: None, param: name.clone(), strength, unit: p.unit.into(), sigmas_now: 0.0 };
        let theta = vec![p.inner(strength) - p.inner(p.off)];
        // Of several strengths the first counts, with the others free.
        let (own, beside) = (mine[..1].to_vec(), mine[1..].to_vec());
        out.push(Question { goal, mine: own, theta, beside });
    }
    (out, trials)
}
