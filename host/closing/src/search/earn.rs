//! Names that a term without a name makes unnecessary.
//!
//! A cause outside the catalogue is first shared out among effects that resemble it in part; a term without a name then
//! takes what they left. If that term, fitted again, takes their part as well, they only imitated the cause.

use super::candidate::Found;
use super::select::{SHADOW, Search};
use super::trials::Tried;
use crate::evidence::{Constancy, maps, tables};
use crate::fit::{Fitted, Model, State, Term, refit, refit_from};
use ommatidia_model::forward::ForwardError;

/// Names whose strengths are the same everywhere stand instead of terms without a name that hold them, if they explain
/// all but this share of the improvement: a curve of many values holds every law over its covariate, so that it proves
/// nothing against one of them.
const ALL_BUT: f64 = 0.2;
/// Number of times that maps and the other parameters are fitted in turn.
const ROUNDS: usize = 2;

/// A state without the effects whose names are not earned.
pub(crate) struct Earned {
    pub(crate) now: Fitted,
    pub(crate) found: Vec<Found>,
    /// The effects that were taken out because they only imitate.
    pub(crate) imitations: Vec<Imitation>,
}

/// An effect that a term without a name makes unnecessary.
pub(crate) struct Imitation {
    pub(crate) found: Found,
    pub(crate) term: Term,
    /// Share of the improvement on held-out data that is lost without it.
    pub(crate) lost: f64,
}

/// Takes out the effects of the catalogue without which the terms without a name explain the data as well. The first
/// `own` terms of the state belong to the instrument; the others are those of `found`, in order. `first` is the fit
/// before the search, and `constancies` says of a fit whether its added terms have one strength everywhere.
///
/// # Errors
/// An object holds negative or non-finite light.
pub(crate) fn earned(
    model: &Model<'_>,
    now: Fitted,
    found: Vec<Found>,
    (own, first): (usize, &Fitted),
    constancies: impl Fn(&Fitted) -> Result<Vec<Constancy>, ForwardError>,
) -> Result<Earned, ForwardError> {
    let mut it = Earned { now, found, imitations: Vec::new() };
    if !it.found.iter().any(|f| is_unnamed(f.id)) {
        return Ok(it);
    }
    it.now = polished(model, &it.now.state, own)?;
    let lost = |with: &Fitted, without: &Fitted| {
        let [before, with, without] = [first, with, without].map(|f| f.held_out.deviance);
        (without - with) / (before - with).max(1e-9)
    };
    // Names that explain nearly everything by themselves imitate nothing.
    let mut by_name = it.now.state.clone();
    by_name.terms.retain(|t| !is_unnamed(t.id()));
    let mut stands_alone = None;
    if by_name.terms.len() > own {
        let by_name = polished(model, &by_name, own)?;
        let rise = lost(&it.now, &by_name);
        tracing::info!("without any term that has no name {rise:.4} of the fall is lost");
        if rise < SHADOW {
            return Ok(it);
        }
        if rise < ALL_BUT && constancies(&by_name)?.iter().all(|c| c.is_even()) {
            stands_alone = Some(by_name);
        }
    }
    // All names at once, then one by one, the weakest first; then terms without a name that others make unnecessary.
    let mut order: Vec<usize> = (0..it.found.len()).filter(|i| is_doubtful(&it, own, *i)).collect();
    order.sort_by(|a, b| it.found[*a].held_out_gain.total_cmp(&it.found[*b].held_out_gain));
    let (unnamed, named): (Vec<_>, Vec<_>) = order.into_iter().map(|i| it.found[i].id).partition(|id| is_unnamed(id));
    let all = (named.len() > 1).then(|| named.clone());
    for set in all.into_iter().chain(named.iter().chain(&unnamed).map(|id| vec![*id])) {
        let out: Vec<usize> = (0..it.found.len()).filter(|i| set.contains(&it.found[*i].id)).collect();
        if out.is_empty() {
            continue;
        }
        let mut state = it.now.state.clone();
        out.iter().rev().for_each(|i| drop(state.terms.remove(own + i)));
        let without = polished(model, &state, own)?;
        let rise = lost(&it.now, &without);
        tracing::info!("without {set:?}: {rise:.4} of the fall is lost");
        // A term without a name claims no cause: it goes only if hardly anything is lost.
        let least = if set.iter().all(|id| is_unnamed(id)) { 0.1 * SHADOW } else { SHADOW };
        if rise < least {
            if let Some(now) = stands_alone.take().filter(|_| !set.iter().all(|id| is_unnamed(id))) {
                it.found.retain(|f| !is_unnamed(f.id));
                return Ok(Earned { now, ..it });
            }
            for i in out.into_iter().rev() {
                let (found, term) = (it.found.remove(i), it.now.state.terms.remove(own + i));
                it.imitations.push(Imitation { found, term, lost: rise.max(0.0) });
            }
            it.now = without;
        }
    }
    Ok(it)
}

/// Searches with `again`, which has the names alone that are earned so far, for terms without a name. Where they
/// predict held-out data better than the other names that `search` has found, which leave much, they take their place.
/// They have many values where a law has one, so they must explain more by what a small error in the law would leave.
/// `first` is the fit before the search. Returns the effects that are replaced.
pub(crate) fn replaced<'m, 'a>(
    search: &mut Search<'m, 'a>,
    mut again: Search<'m, 'a>,
    (own, first): (usize, &Fitted),
    progress: &mut dyn FnMut(&str),
) -> Result<Vec<Imitation>, ForwardError> {
    again.run(Tried::Maps, progress)?;
    again.run(Tried::Curves, progress)?;
    let [by_name, without] = [&search.now, &again.now].map(|fit| first.held_out.deviance - fit.held_out.deviance);
    tracing::info!("names explain {by_name:.0}, terms without a name {without:.0}");
    if without <= (1.0 + SHADOW) * by_name {
        return Ok(Vec::new());
    }
    again.shadowed = std::mem::take(&mut search.shadowed);
    let old = std::mem::replace(search, again);
    let terms = old.now.state.terms.into_iter().skip(own);
    let kept = |id: &str| search.found.iter().any(|f| f.id == id);
    let pairs = old.found.into_iter().zip(terms).filter(|(f, _)| !is_unnamed(f.id) && !kept(f.id));
    Ok(pairs.map(|(found, term)| Imitation { found, term, lost: 0.0 }).collect())
}

/// Whether a found effect is taken out for a trial: every name is, and every term without a name but the maps.
fn is_doubtful(it: &Earned, own: usize, i: usize) -> bool {
    !is_unnamed(it.found[i].id) || it.now.state.terms[own + i].table.is_none()
}

fn is_unnamed(id: &str) -> bool {
    id.starts_with("unknown")
}

/// The fitted state, with the tables that have no name estimated again beside all other terms.
fn polished(model: &Model<'_>, state: &State, own: usize) -> Result<Fitted, ForwardError> {
    let unnamed = |t: &Term| t.effect.table().is_some() && is_unnamed(t.id());
    let tables: Vec<usize> = (own..state.terms.len()).filter(|i| unnamed(&state.terms[*i])).collect();
    let mut fit = None;
    let mut state = state.clone();
    for _ in 0..if tables.is_empty() { 1 } else { ROUNDS } {
        let scenes = model.scenes(&state)?;
        for i in &tables {
            let mut without = state.clone();
            let old = without.terms.remove(*i);
            let predicted = model.predict(&without, &scenes);
            let of_scenes = old.effect.table().is_some_and(|kind| kind.acts.of_scenes());
            let beside = maps::Beside { state: &without, scenes: &scenes, predicted: &predicted };
            let found = match of_scenes {
                true => maps::one(model, old.effect, beside),
                false => tables::one(model, old.effect, &predicted),
            };
            state.terms[*i] = found.map_or(old, |f| f.term);
        }
        let next = refit_from(model, state, scenes)?;
        state = next.state.clone();
        fit = Some(next);
    }
    fit.map_or_else(|| refit(model, state), Ok)
}
