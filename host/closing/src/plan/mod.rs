//! Which measurement next: what would separate the candidates that this session leaves ambiguous, or make testable what
//! it cannot test.
//!
//! Nothing is measured for it: the calibrated model, with the effects that were found, predicts the frames of each
//! measurement of a small catalogue (`measurement`), and their Fisher information is added to that of the session
//! (`information`; Fahrmeir & Kaufmann, Ann. Stat. 13, 342, 1985; optimal design: Fedorov, Theory of Optimal
//! Experiments, 1972). With theta the strengths of an effect A, C their covariance with the nuisances, all other
//! effects and the alternative B free, A and B are separated by
//! ```text
//! z = sqrt(theta' C^-1 theta)
//! ```
//! standard deviations. C holds noise and the uncertainty of the calibration (its replicates). Measurements are chosen
//! one after another: each time the one that brings most towards [`ENOUGH`] for its cost.

pub(crate) mod goals;
pub(crate) mod information;
pub(crate) mod measurement;
mod result;
#[cfg(test)]
mod tests;

pub use result::{Advice, Goal, Plan};

use crate::fit::{Column, Design, Scope};
use crate::fit::{Fitted, Model, Replicas, Term, fitted_columns};
use information::Information;
use measurement::Measurement;
use ommatidia_model::forward::ForwardError;
use ommatidia_model::instrument::Instrument;

/// Candidates count as separated from so many standard deviations on.
pub const ENOUGH: f64 = 5.0;
/// Maximum number of measurements that are advised.
const MOST: usize = 4;
/// A measurement is advised if it brings the goals at least so many standard deviations nearer, all together.
const WORTH: f64 = 1.0;

/// What a plan starts from.
pub(crate) struct Found<'a> {
    /// The instrument as given.
    pub(crate) instrument: &'a Instrument,
    /// The last fit.
    pub(crate) now: &'a Fitted,
    /// Replicates of the calibration.
    pub(crate) replicas: &'a Replicas,
    /// Effects with their alternatives, which are to be separated.
    pub(crate) ambiguous: Vec<(String, Vec<String>)>,
    /// Effects that are not testable.
    pub(crate) untestable: Vec<String>,
}

/// The shortest list of measurements that the greedy choice finds.
///
/// # Errors
/// An object holds negative or non-finite light.
pub(crate) fn plan(model: &Model<'_>, found: &Found<'_>) -> Result<Plan, ForwardError> {
    let (questions, trials) = goals::questions(model, found);
    let mut plan = Plan { enough_sigma: ENOUGH, assumptions: assumptions(found.instrument), ..Plan::default() };
    if questions.is_empty() {
        return Ok(plan);
    }
    let session = of_session(model, found, &trials)?;
    let mut last: Vec<f64> = questions.iter().map(|q| q.sigmas(std::slice::from_ref(&session))).collect();
    plan.goals = questions.iter().zip(&last).map(|(q, now)| q.goal(*now)).collect();
    let mut open: Vec<(Measurement, Information)> = Vec::new();
    for measurement in Measurement::ALL {
        if let Some(information) = measurement.information(model, found, &trials)? {
            open.push((measurement, information));
        }
    }
    let mut taken = vec![session];
    while plan.measurements.len() < MOST && last.iter().any(|z| *z < ENOUGH) {
        let mut best: Option<(f64, usize, Vec<f64>)> = None;
        for (i, (measurement, information)) in open.iter().enumerate() {
            let with: Vec<Information> = taken.iter().chain([information]).cloned().collect();
            let next: Vec<f64> = questions.iter().map(|q| q.sigmas(&with)).collect();
            let gain: f64 = next.iter().zip(&last).map(|(n, l)| (n.min(ENOUGH) - l.min(ENOUGH)).max(0.0)).sum();
            let worth = gain / measurement.cost();
            if gain > WORTH && best.as_ref().is_none_or(|(w, ..)| worth > *w) {
                best = Some((worth, i, next));
            }
        }
        let Some((_, i, next)) = best else { break };
        // It stays open: the same once more may be what helps most.
        let (measurement, information) = open[i].clone();
        plan.measurements.push(Advice {
            id: measurement.id().into(),
            words: measurement.words().into(),
            sigmas: next.clone(),
        });
        taken.push(information);
        last = next;
    }
    Ok(plan)
}

/// The information of the session's training data.
fn of_session(model: &Model<'_>, found: &Found<'_>, trials: &[Term]) -> Result<Information, ForwardError> {
    let errors = found.replicas.of(model, found.now)?;
    let columns = columns(model, found.now, trials);
    let design = Design::compute(model, found.now.expansion(trials), columns, &errors, Scope::Training)?;
    Ok(Information::of(&design, 1.0))
}

/// All columns of a model: nuisances, the effects of its state, and the strengths of trial terms.
fn columns(model: &Model<'_>, now: &Fitted, trials: &[Term]) -> Vec<Column> {
    let strengths = trials
        .iter()
        .enumerate()
        .flat_map(|(term, t)| t.strengths(model.lenses()).into_iter().map(move |param| Column::Trial { term, param }));
    fitted_columns(model, &now.state).into_iter().chain(strengths).collect()
}

fn assumptions(instrument: &Instrument) -> Vec<String> {
    let mut all = vec![
        "the calibrated model with the effects that were found predicts the frames of each measurement; the law of \
         every candidate is linear in its strength"
            .to_string(),
        "errors are noise and the uncertainty of the calibration; a quarter of the new frames is held out, and light \
         and black level of each new stack are free"
            .into(),
        "a candidate that is not testable now is assumed with ten steps of its strength (docs/effects.md)".into(),
    ];
    if instrument.psf.node_depths_um.len() < 2 && instrument.pupil_model().is_none() {
        all.push(
            "the instrument knows its PSFs at one depth only: what acts by depth becomes testable after a calibration \
             with beads at two depths or more, and no measurement of this list can replace it"
                .into(),
        );
    }
    all
}
