//! What each of several effects explains, whatever the order in which they were added.
//!
//! The first effect that is added explains all that it can imitate of the others: beside a strong defocus a halo that
//! came first seems to explain nearly everything, and the defocus the rest. So the one without which least is lost is
//! taken out, then the next (backward elimination): each explains what is lost with it beside those that explain more.

use super::candidate::Found;
use super::confirm::fitted_beside;
use super::prune::Pruned;
use crate::fit::{Fitted, Model};
use ommatidia_model::forward::ForwardError;
use ommatidia_physics::effects::{Stage, find};

/// Gives each found effect of the optics and the response its own share of what they explain together, and returns
/// whether it did: only where one of several has no one strength, so that it may be no cause, and specimens are not
/// estimated. `before` is the fit before the search; the first `own` terms of the state belong to the instrument.
///
/// # Errors
/// An object holds negative or non-finite light.
pub(crate) fn shared(model: &Model<'_>, before: &Fitted, it: &mut Pruned, own: usize) -> Result<bool, ForwardError> {
    let mut left: Vec<usize> = (0..it.found.len()).filter(|i| is_shared(&it.found[*i])).collect();
    let is_even = |i: &usize| it.constancy.get(own + i).is_none_or(|c| c.is_even());
    if left.len() < 2 || left.iter().all(is_even) || it.now.state.specimens.is_some() {
        return Ok(false);
    }
    // Places of the found effects among the terms of a state from which some are out.
    let mut place: Vec<usize> = (own..own + it.found.len()).collect();
    let others = it.found.len() > left.len();
    let mut now = it.now.clone();
    while !left.is_empty() {
        let mut least: Option<(f64, usize, Fitted)> = None;
        for i in left.iter().copied() {
            let fit = match left.len() == 1 && !others {
                true => before.clone(),
                false => without(model, &now, place[i])?,
            };
            let lost = fit.held_out.deviance - now.held_out.deviance;
            if least.as_ref().is_none_or(|l| lost < l.0) {
                least = Some((lost, i, fit));
            }
        }
        let Some((lost, i, fit)) = least else { break };
        tracing::info!("{}: {lost:.1} of held-out data is lost without it", it.found[i].id);
        it.found[i].held_out_gain = lost.max(0.0);
        left.retain(|j| *j != i);
        let out = place[i];
        place.iter_mut().filter(|p| **p > out).for_each(|p| *p -= 1);
        now = fit;
    }
    Ok(true)
}

/// Whether an effect may take what another one explains: a law of the optics or the response.
fn is_shared(found: &Found) -> bool {
    find(found.id).is_some_and(|effect| {
        let is_law = effect.table().is_none() && effect.descriptor().stage != Stage::Record;
        is_law && !effect.noise_only() && !found.id.starts_with("unknown")
    })
}

/// A fit without one of its terms.
fn without(model: &Model<'_>, fit: &Fitted, term: usize) -> Result<Fitted, ForwardError> {
    let mut state = fit.state.clone();
    let out = state.terms.remove(term);
    fitted_beside(model, state, fit, &[out])
}
