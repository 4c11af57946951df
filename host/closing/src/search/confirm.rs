//! Full fits of finalists, and which of them is added.

use super::candidate::{Candidate, PENALTY};
use super::finalists::{alike, of_jumps};
use super::moment::with_best_moment;
use crate::evidence::Test;
use crate::fit::repeats::wings;
use crate::fit::{Fitted, Model, State, Term, refit, refit_from_within, refit_within};
use ommatidia_model::forward::ForwardError;
use ommatidia_physics::effects::Stage;
use std::collections::BTreeMap;
use std::sync::Arc;

/// Of two similar effects the one with fewer parameters is named if it explains all but this share of what the other
/// explains.
const TRACE: f64 = 1e-3;
/// Of a weak effect this share, up to five standard deviations of one parameter: the law of a true effect errs too.
const WEAK_TRACE: f64 = 1e-2;
const FIVE_SIGMA: f64 = 25.0;

/// How much less of a gain a simpler effect may explain.
pub(super) fn trace(gain: f64) -> f64 {
    (TRACE * gain).max((WEAK_TRACE * gain).min(FIVE_SIGMA))
}

/// Specimens are estimated again under fits whose deviance falls by this share of the largest fall.
const CLOSE: f64 = 0.5;
/// The fit of a finalist is given up where it cannot explain all but this share of what the best of those before it
/// explains: less than that ([`CLOSE`]) beside specimens, which take a part of each effect.
const BEHIND: f64 = 0.02;
/// Specimens are estimated again under the best of the fits so often at most, and until the deviance falls by less than
/// [`SETTLED`].
const ROUNDS: usize = 5;
const SETTLED: f64 = 5.0;

/// The state with a candidate added at its estimated strengths.
pub(super) fn with(model: &Model<'_>, state: &State, candidate: &Candidate) -> State {
    let mut next = state.clone();
    let mut term = candidate.term.clone();
    if let Some(test) = &candidate.test {
        term = term.moved(model.lenses(), &test.theta);
    }
    next.terms.push(term);
    next
}

/// A state, fitted from a fit that differs from it by some terms. The light of the objects is that of the fit, unless
/// one of the terms changes it.
pub(super) fn fitted_beside(
    model: &Model<'_>,
    state: State,
    fit: &Fitted,
    terms: &[Term],
) -> Result<Fitted, ForwardError> {
    fitted_within(model, state, fit, terms, f64::INFINITY)
}

/// [`fitted_beside`], which gives up where the training deviance cannot come below `most`.
fn fitted_within(
    model: &Model<'_>,
    state: State,
    fit: &Fitted,
    terms: &[Term],
    most: f64,
) -> Result<Fitted, ForwardError> {
    let next = match terms.iter().any(|t| t.effect.descriptor().stage == Stage::Object) {
        true => refit_within(model, state, most)?,
        false => refit_from_within(model, state, fit.scenes.clone(), most)?,
    };
    if next.given_up {
        return Ok(next);
    }
    terms.iter().try_fold(next, |next, term| with_best_moment(model, next, term.id()))
}

/// The smallest share that one of some fits leaves of the excess of chi-squared of another.
pub(super) fn excess_left<'f>(before: &Fitted, fits: impl IntoIterator<Item = &'f Fitted>) -> f64 {
    let excess = |fit: &Fitted| (fit.training.chi2 - fit.training.pixels).max(0.0);
    let least = fits.into_iter().map(excess).fold(f64::INFINITY, f64::min);
    if excess(before) > 0.0 { (least / excess(before)).min(1.0) } else { 1.0 }
}

/// By how much more than noise the evidence of a test scatters between clusters, where `left` of the excess is left by
/// the best fit: what that removes was scatter of the effect itself.
pub(super) fn weight(test: Option<&Test>, left: f64) -> f64 {
    1.0 + left * test.map_or(0.0, |t| (t.gain / t.t.max(1e-9) - 1.0).max(0.0))
}

/// Result of the full fits.
pub(super) enum Verdict<'c> {
    /// The best finalist is added.
    Added(Box<Added<'c>>),
    /// The best finalist, given by its id, does not improve the fit or the held-out data.
    Refused(&'static str),
}

/// An effect that is added.
pub(super) struct Added<'c> {
    pub(super) fit: Fitted,
    pub(super) candidate: &'c Candidate,
    /// Fall of the deviance of held-out data.
    pub(super) gain: f64,
    /// Id of each effect that was compared, and how much larger its deviance is, over the scatter.
    pub(super) behind: Vec<(&'static str, f64)>,
}

/// Fits effects in full beside a fit.
pub(super) struct FullFits<'m, 'a> {
    pub(super) model: &'m Model<'a>,
    pub(super) now: &'m Fitted,
}

impl FullFits<'_, '_> {
    /// Estimates the specimens again, if there are any, under each of the fits that explain about as much as the best.
    /// Before, the specimens are those of a state without the effect, and what that leaves of them favours effects with
    /// many parameters. Returns how far the deviance fell, for each of them.
    fn estimate_again(&self, fits: &mut [(&'static str, Fitted)]) -> Result<BTreeMap<&'static str, f64>, ForwardError> {
        let now = self.now;
        let has_old = |fit: &Fitted| match (&fit.state.specimens, &now.state.specimens) {
            (Some(own), Some(old)) => Arc::ptr_eq(own, old),
            _ => false,
        };
        let fall = |fit: &Fitted| now.training.deviance - fit.training.deviance;
        let most = fits.iter().map(|(_, fit)| fall(fit)).fold(0.0, f64::max);
        let mut falls = BTreeMap::new();
        for (id, fit) in fits.iter_mut().filter(|(_, fit)| has_old(fit) && fall(fit) > CLOSE * most) {
            let before = fit.training.deviance;
            *fit = self.with_new_specimens(id, fit)?;
            falls.insert(*id, before - fit.training.deviance);
        }
        Ok(falls)
    }

    /// Estimates the specimens of a fit again, if there are any, until it settles. Each time the deviance falls by
    /// about the same share of its fall the time before (`last`): it has settled where all that is still to come is
    /// little.
    fn settle(&self, id: &str, fit: &mut Fitted, mut last: Option<f64>) -> Result<(), ForwardError> {
        for _ in 1..ROUNDS {
            if fit.state.specimens.is_none() {
                break;
            }
            let before = fit.training.deviance;
            *fit = self.with_new_specimens(id, fit)?;
            let fall = before - fit.training.deviance;
            if fall.min(to_come(fall, last)) < SETTLED {
                break;
            }
            last = Some(fall);
        }
        Ok(())
    }

    fn with_new_specimens(&self, id: &str, fit: &Fitted) -> Result<Fitted, ForwardError> {
        let next = refit(self.model, fit.without_specimens(self.model))?;
        tracing::info!("  {id} with new specimens: deviance {:.1}", next.training.deviance);
        Ok(next)
    }

    /// The training deviance above which the fit of a finalist is far behind the best of some others, whatever the
    /// prices of their parameters.
    fn worst_that_counts(&self, c: &Candidate, finalists: &[&Candidate], fits: &[(&'static str, Fitted)]) -> f64 {
        let before = self.now.training.deviance;
        let share = if self.now.state.specimens.is_some() { 1.0 - CLOSE } else { BEHIND };
        let heaviest = finalists.iter().map(|c| weight(c.test.as_ref(), 1.0)).fold(1.0, f64::max);
        let worst = |(id, fit): &(&str, Fitted)| {
            let columns = finalists.iter().find(|f| f.term.id() == *id)?.columns.len();
            let fall = before - fit.training.deviance;
            let saved = PENALTY * columns.saturating_sub(c.columns.len()) as f64 * heaviest;
            (fall > 0.0 && !fit.given_up).then_some(fit.training.deviance + share * fall + saved)
        };
        fits.iter().filter_map(worst).fold(f64::INFINITY, f64::min)
    }

    /// Fits the finalists in full, unless `fits` holds them already, and checks the best on held-out data.
    pub(super) fn confirm<'c>(
        &self,
        finalists: &[&'c Candidate],
        fits: &mut Vec<(&'static str, Fitted)>,
        progress: &mut dyn FnMut(&str),
    ) -> Result<Verdict<'c>, ForwardError> {
        // What was given up was compared with a finalist that may be gone.
        fits.retain(|(id, fit)| !fit.given_up && finalists.iter().any(|c| c.term.id() == *id));
        for c in finalists {
            if fits.iter().any(|(id, _)| *id == c.term.id()) {
                continue;
            }
            progress(c.term.id());
            let next = with(self.model, &self.now.state, c);
            let most = self.worst_that_counts(c, finalists, fits);
            let fit = fitted_within(self.model, next, self.now, std::slice::from_ref(&c.term), most)?;
            let how = if fit.given_up { "given up" } else { "fitted" };
            tracing::info!("  {how} {:?}: deviance {:.1}", fit.state.terms.last(), fit.training.deviance);
            fits.push((c.term.id(), fit));
        }
        let falls = self.estimate_again(fits)?;
        // The scatter between clusters and the errors of the calibration weight the full fits as they do the scores,
        // with one weight for all: an effect with many parameters must not win by fitting errors of the calibration.
        // What the best of the fits removes was scatter of the effect itself, which is no such error.
        let left = excess_left(self.now, fits.iter().map(|(_, fit)| fit));
        let weight = |c: &Candidate| weight(c.test.as_ref(), left);
        let heaviest = finalists.iter().map(|c| weight(c)).fold(1.0, f64::max);
        let price = |c: &Candidate| PENALTY * c.columns.len() as f64;
        let worth = |c: &Candidate, cost: f64| (price(c) * heaviest - cost) / weight(c) - price(c);
        let mut best: Option<(f64, &Candidate)> = None;
        let mut costs: Vec<(&'static str, f64)> = Vec::new();
        let mut least = f64::INFINITY;
        for c in finalists {
            let Some((_, fit)) = fits.iter().find(|(id, _)| *id == c.term.id()) else { continue };
            let mut fall = self.now.training.deviance - fit.training.deviance;
            if let Some(table) = c.table.as_ref().filter(|t| t.of_scenes) {
                // A map of the frames that it is judged on: what each half of them predicts for the other counts.
                fall = fall.min(table.gain);
            }
            let cost = price(c) * heaviest - fall;
            costs.push((c.term.id(), cost));
            if cost < least && !fit.given_up {
                least = cost;
                best = Some((if c.table.is_some() { c.worth() } else { worth(c, cost) }, *c));
            }
        }
        // A free place of each lens also fits what the calibration does not know of it: a turn of all lenses together
        // that explains all but a trace is the simpler account.
        if let Some((_, strongest)) = best {
            let trace = trace(-least);
            let simpler = |c: &&&Candidate| {
                c.table.is_none() && c.values() < strongest.values() && alike(&strongest.term, &c.term)
            };
            let cost = |c: &Candidate| costs.iter().find(|(id, _)| *id == c.term.id()).map(|(_, cost)| *cost);
            let near = finalists.iter().filter(simpler).filter_map(|c| Some((cost(c)?, *c)));
            let simplest = near.filter(|(cost, _)| cost - least < trace).min_by(|a, b| a.0.total_cmp(&b.0));
            if let Some((cost, c)) = simplest {
                least = cost;
                best = Some((worth(c, cost), c));
            }
        }
        let jumps = || wings(self.model, &self.now.state, &self.now.predicted).is_infinite();
        if let Some((c, cost)) = best.and_then(|(_, c)| of_jumps(c, finalists, &costs, jumps)) {
            least = cost;
            best = Some((worth(c, cost), c));
        }
        let place = |c: &Candidate| fits.iter().position(|(id, _)| *id == c.term.id());
        let Some((worth, candidate, at)) = best.and_then(|(worth, c)| Some((worth, c, place(c)?))) else {
            return Ok(Verdict::Refused(finalists.first().map_or("", |c| c.term.id())));
        };
        let id = candidate.term.id();
        if worth <= 0.0 {
            return Ok(Verdict::Refused(id));
        }
        self.settle(id, &mut fits[at].1, falls.get(id).copied())?;
        let gain = self.now.held_out.deviance - fits[at].1.held_out.deviance;
        if gain <= 0.0 {
            return Ok(Verdict::Refused(id));
        }
        let behind = costs.into_iter().map(|(id, cost)| (id, (cost - least) / heaviest)).collect();
        Ok(Verdict::Added(Box::new(Added { fit: fits.swap_remove(at).1, candidate, gain, behind })))
    }
}

/// What is still to come of a deviance that fell, and whose falls shrink by about the same factor each time: the rest
/// of the geometric series. The fall itself where the `last` one is not known, or was no larger.
fn to_come(fall: f64, last: Option<f64>) -> f64 {
    last.filter(|last| *last > fall).map_or(fall, |last| fall * fall / (last - fall))
}

#[cfg(test)]
mod tests {
    use super::to_come;

    #[test]
    fn what_is_to_come_is_the_rest_of_the_series() {
        // 100, 20, then 4, 0.8, 0.16, ...: five in all.
        assert!((to_come(20.0, Some(100.0)) - 5.0).abs() < 1e-12);
        assert_eq!([to_come(20.0, None), to_come(20.0, Some(10.0))], [20.0, 20.0]);
    }
}
