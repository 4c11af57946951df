//! Forward selection: score every trial term, fit the best in full, accept it on held-out data, until none is
//! significant.

use super::candidate::{AMBIGUOUS, Alternative, Candidate, Found, PENALTY, Shadowed};
use super::finalists::{alike, finalists, of_jumps};
use super::scoring::{log, score, tabled};
use super::trials::{NEEDS_CALIBRATION, Tried, evidence, is_laplacian};
use crate::data::{Frame, Shown};
use crate::evidence::{Scores, Test, holm};
use crate::fit::repeats::wings;
use crate::fit::{
    Column, Design, Errors, Fitted, Model, Predicted, Replicas, Scope, State, Term, fitted_columns, refit, refit_from,
};
use ommatidia_model::forward::ForwardError;
use ommatidia_physics::effects::Stage;
use std::collections::BTreeMap;
use std::sync::Arc;

/// Family-wise error rate: probability that an effect is significant although the model is complete (Holm).
pub const ALPHA: f64 = 0.02;
/// The law of an effect describes a real change only in part: about this share of what a strong effect explains
/// remains, in the form of its neighbours in law. An effect that gains less beside it is not named.
pub const SHADOW: f64 = 0.03;
/// Number of effects in the shadow of a stronger one that are listed; after so many full fits of such a search ends.
const SHADOWED: usize = 3;
/// Maximum number of effects that are added, and of terms without a name beside them.
const MOST: usize = 6;
/// A term without a name must explain this share of the excess of chi-squared over the noise on held-out data: what
/// explains less may be error of the calibration, and closes no loop.
const PART: f64 = 0.02;
/// Maximum number of terms without a name.
const MOST_UNNAMED: usize = 3;
/// Errors of the PSFs between calibrated positions may feign an effect that explains this share of them. They are the
/// relative error times the light of scenes of known objects; in frames of single beads, where no other focus averages
/// them, they are taken to be as large as the noise.
const FEIGNED: f64 = 0.1;
/// Of two similar effects the one with fewer parameters is named if it explains all but this share of what the other
/// explains.
const TRACE: f64 = 1e-3;
/// Of a weak effect this share, up to five standard deviations of one parameter: the law of a true effect errs too.
const WEAK_TRACE: f64 = 1e-2;
const FIVE_SIGMA: f64 = 25.0;

/// How much less of a gain a simpler effect may explain.
fn trace(gain: f64) -> f64 {
    (TRACE * gain).max((WEAK_TRACE * gain).min(FIVE_SIGMA))
}

/// Significance of wings of the noise, standard deviations, below which larger noise is no sign of an effect that makes
/// wings.
const WINGS: f64 = 3.0;
/// Specimens are estimated again under fits whose deviance falls by this share of the largest fall.
const CLOSE: f64 = 0.5;
/// Under the best of them so often at most, and until the deviance falls by less than [`SETTLED`].
const ROUNDS: usize = 5;
const SETTLED: f64 = 5.0;

/// The state with a candidate added at its estimated strengths.
fn with(model: &Model<'_>, state: &State, candidate: &Candidate) -> State {
    let mut next = state.clone();
    let mut term = candidate.term.clone();
    if let Some(test) = &candidate.test {
        term = term.moved(model.lenses(), &test.theta);
    }
    next.terms.push(term);
    next
}

/// Share of the gain of a trial calibration that an effect must reach to be accepted instead of it.
const ENOUGH: f64 = 0.5;

/// Effects that are not tried again in a run of the search.
struct Refused {
    ids: Vec<&'static str>,
    /// Number of those that were fitted and stood in the shadow of a stronger effect.
    in_vain: usize,
}

/// A search in progress.
pub struct Search<'m, 'a> {
    model: &'m Model<'a>,
    replicas: &'m Replicas,
    /// The present state, fitted.
    pub now: Fitted,
    /// Effects that were added so far.
    pub found: Vec<Found>,
    /// Candidates of the last step that were not added, with their scores.
    pub rest: Vec<Candidate>,
    /// The largest fall of the training deviance by an effect so far; 0 without one.
    strongest_fall: f64,
    /// Effects that would improve the fit, by less than what the law of a stronger effect may leave.
    pub shadowed: Vec<Shadowed>,
    /// Ids of effects that are not tried.
    pub exclude: Vec<String>,
    /// Deviance of the held-out cells of beads under a trial calibration, if that is better than the old one.
    pub trial_deviance: Option<f64>,
}

impl<'m, 'a> Search<'m, 'a> {
    /// Starts from a fitted state.
    pub fn new(model: &'m Model<'a>, replicas: &'m Replicas, now: Fitted) -> Self {
        Self {
            model,
            replicas,
            now,
            found: Vec::new(),
            rest: Vec::new(),
            strongest_fall: 0.0,
            shadowed: Vec::new(),
            exclude: Vec::new(),
            trial_deviance: None,
        }
    }

    /// Adds one effect after another as long as the score test is significant and the full fit improves both the
    /// training and the held-out data. Calls `progress` with the id of each effect that is fitted.
    ///
    /// # Errors
    /// An object holds negative or non-finite light.
    pub fn run(&mut self, tried: Tried, progress: &mut impl FnMut(&str)) -> Result<(), ForwardError> {
        let mut refused = Refused { ids: self.shadowed.iter().map(|s| s.id).collect(), in_vain: 0 };
        loop {
            let candidates = self.candidates(tried)?;
            let added = self.step(tried, &candidates, &mut refused, progress)?;
            if !added || self.needs_calibration() {
                self.rest = candidates;
                return Ok(());
            }
        }
    }

    /// All candidates with their evidence beside the present state, the best first.
    fn candidates(&self, tried: Tried) -> Result<Vec<Candidate>, ForwardError> {
        let mut terms = tried.terms(self.model, &self.now.state, &evidence(self.model, &self.now));
        let excluded = |id: &str| self.exclude.iter().any(|e| e == id);
        terms.retain(|t| !excluded(t.id()));
        let errors = self.replicas.of(self.model, &self.now)?;
        let mut candidates = score(self.model, &self.now, &errors, &terms)?;
        let winged = |c: &Candidate| c.term.effect.makes_wings();
        if candidates.iter().any(winged) && wings(self.model, &self.now.state, &self.now.predicted) < WINGS {
            let without = candidates.iter_mut().filter(|c| winged(c)).filter_map(|c| c.test.as_mut());
            without.for_each(Test::discard);
        }
        if tried == Tried::Catalogue {
            // Blurred truths make scenes look sharper, never less sharp.
            let blurs = |c: &&mut Candidate| {
                is_laplacian(&c.term) && c.test.as_ref().is_some_and(|t| t.theta.first().is_some_and(|a| *a > 0.0))
            };
            candidates.iter_mut().filter(blurs).filter_map(|c| c.test.as_mut()).for_each(Test::discard);
        }
        candidates.extend(tabled(self.model, &self.now, tried).into_iter().filter(|c| !excluded(c.term.id())));
        candidates.sort_by(|a, b| b.worth().total_cmp(&a.worth()));
        log(&candidates);
        Ok(candidates)
    }

    /// Adds the best of the candidates that stands the full fit. Returns false if there is none.
    fn step(
        &mut self,
        tried: Tried,
        candidates: &[Candidate],
        refused: &mut Refused,
        progress: &mut impl FnMut(&str),
    ) -> Result<bool, ForwardError> {
        let p: Vec<f64> = candidates.iter().map(Candidate::p).collect();
        let significant = holm(&p, ALPHA);
        let pixels = self.now.training.pixels;
        let mut fits = Vec::new();
        loop {
            let feigned = self.feigned();
            let open = |c: &Candidate| {
                let beyond_feigned = c.table.is_some() || c.term.effect.is_of_the_grid() || c.gain() > feigned;
                let new = !refused.ids.contains(&c.term.id()) && c.worth() > 0.0;
                new && c.is_large_enough(pixels) && beyond_feigned
            };
            let able = candidates.iter().zip(&significant).filter(|(c, s)| **s && open(c)).map(|(c, _)| c);
            // The score of an effect in the shadow shows that already; its full fit would only take time.
            let floor = SHADOW * self.strongest_fall;
            let (able, faint): (Vec<&Candidate>, Vec<&Candidate>) =
                able.partition(|c| !c.can_be_shadowed(pixels) || c.gain() >= floor);
            let mut finalists = finalists(&able);
            // The evidence for a map rests on the scatter of few frames; its full fit shows what it is worth.
            for c in able.iter().filter(|c| c.table.as_ref().is_some_and(|t| t.of_scenes)) {
                if !finalists.iter().any(|f| f.term.id() == c.term.id()) {
                    finalists.push(c);
                }
            }
            if finalists.is_empty() || self.is_full(tried) || refused.in_vain >= SHADOWED {
                for c in faint.iter().take(SHADOWED.saturating_sub(self.shadowed.len())) {
                    let share = c.gain() / self.strongest_fall;
                    self.shadowed.push(Shadowed { id: c.term.id(), z: c.z(), share });
                }
                return Ok(false);
            }
            let verdict = self.confirm(&finalists, &mut fits, progress)?;
            match self.or_calibration(verdict, candidates)? {
                Verdict::Added(it)
                    if it.candidate.can_be_shadowed(pixels) && it.gain < SHADOW * self.strongest_gain() =>
                {
                    refused.in_vain += 1;
                    let share = it.gain / self.strongest_gain();
                    self.shadowed.push(Shadowed { id: it.candidate.term.id(), z: it.candidate.z(), share });
                    refused.ids.push(it.candidate.term.id());
                }
                // Beside the effects of the catalogue it stands against a name, however little both explain.
                Verdict::Added(it)
                    if tried != Tried::Catalogue
                        && it.candidate.term.id().starts_with("unknown")
                        && it.gain < PART * self.excess() =>
                {
                    refused.ids.push(it.candidate.term.id());
                }
                Verdict::Added(it) => {
                    let found = self.describe(candidates, &it)?;
                    self.found.push(found);
                    self.strongest_fall =
                        self.strongest_fall.max(self.now.training.deviance - it.fit.training.deviance);
                    self.now = it.fit;
                    return Ok(true);
                }
                Verdict::Refused(id) => refused.ids.push(id),
            }
        }
    }

    /// Fall of chi-squared that errors of the PSFs may feign: more than nothing where beads alone show the optics, and
    /// where the PSFs between the positions of the calibration are known worse than its noise allows.
    fn feigned(&self) -> f64 {
        let seen = self.model.seen;
        let shown = |f: &&Frame| matches!(f.shown, Shown::Object(_));
        if seen.frames.iter().any(|f| shown(&f)) {
            let black = self.model.forward.noise().black_level_dn;
            let squared_light = |(f, here): (&Frame, &Predicted)| {
                let signal = |(y, w): (&f32, &f32)| ((f64::from(*y) - black) * f64::from(*w)).powi(2);
                f.measured.iter().zip(&here.inverse_sigma).map(signal).sum::<f64>()
            };
            let training = seen.frames.iter().zip(&*self.now.predicted).filter(|(f, _)| shown(f) && !f.held_out);
            return FEIGNED * self.model.coarse_error.powi(2) * training.map(squared_light).sum::<f64>();
        }
        let beads = seen.frames.iter().filter(|f| matches!(f.shown, Shown::Bead(_)) && !f.held_out).count();
        FEIGNED * (beads * seen.pixels.len()) as f64
    }

    /// Whether as many terms of a family were added as may be.
    fn is_full(&self, tried: Tried) -> bool {
        let unnamed = self.found.iter().filter(|f| f.id.starts_with("unknown")).count();
        match tried {
            Tried::Catalogue => self.found.len() - unnamed >= MOST,
            Tried::Curves | Tried::Maps => unnamed >= MOST_UNNAMED,
        }
    }

    /// The largest fall of the held-out deviance by an effect so far; 0 without one.
    pub fn strongest_gain(&self) -> f64 {
        self.found.iter().map(|f| f.held_out_gain).fold(0.0, f64::max)
    }

    /// Excess of chi-squared over the noise on held-out data; 0 if there is none.
    fn excess(&self) -> f64 {
        let held_out = self.now.held_out;
        (held_out.chi2 - held_out.pixels).max(0.0)
    }

    /// Whether the next step must be a new calibration, not another effect.
    pub fn needs_calibration(&self) -> bool {
        self.trial_deviance.is_some() && self.found.iter().any(|f| f.id == NEEDS_CALIBRATION)
    }

    /// The verdict, or, if the trial calibration is far better than any effect, the effect that stands for a new
    /// calibration. A calibration adapts to any change of the PSFs, so it is better than the right effect as well, but
    /// not by much.
    fn or_calibration<'c>(
        &self,
        verdict: Verdict<'c>,
        candidates: &'c [Candidate],
    ) -> Result<Verdict<'c>, ForwardError> {
        let Some(trial) = self.trial_deviance.filter(|_| self.found.is_empty()) else { return Ok(verdict) };
        // Judged on the beads: bright frames of the unknown would hide what either of them gains.
        let before = self.now.known_held_out.deviance;
        let gain = match &verdict {
            Verdict::Added(it) => before - it.fit.known_held_out.deviance,
            Verdict::Refused(_) => 0.0,
        };
        let sign = candidates.iter().find(|c| c.term.id() == NEEDS_CALIBRATION);
        let Some(candidate) = sign.filter(|_| gain < ENOUGH * (before - trial)) else { return Ok(verdict) };
        let fit = refit_from(self.model, with(self.model, &self.now.state, candidate), self.now.scenes.clone())?;
        // All other effects were compared with it and are worse.
        let behind = candidates.iter().map(|c| (c.term.id(), f64::INFINITY)).collect();
        Ok(Verdict::Added(Box::new(Added { fit, candidate, gain: before - trial, behind })))
    }

    /// Estimates the specimens again, if there are any, under each of the fits that explain about as much as the best.
    /// Before, the specimens are those of a state without the effect, and what that leaves of them favours effects with
    /// many parameters. Returns how far the deviance fell, for each of them.
    fn estimate_again(&self, fits: &mut [(&'static str, Fitted)]) -> Result<BTreeMap<&'static str, f64>, ForwardError> {
        let now = &self.now;
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

    /// Fits the finalists in full, unless `fits` holds them already, and checks the best on held-out data.
    fn confirm<'c>(
        &self,
        finalists: &[&'c Candidate],
        fits: &mut Vec<(&'static str, Fitted)>,
        progress: &mut impl FnMut(&str),
    ) -> Result<Verdict<'c>, ForwardError> {
        fits.retain(|(id, _)| finalists.iter().any(|c| c.term.id() == *id));
        for c in finalists {
            if fits.iter().any(|(id, _)| *id == c.term.id()) {
                continue;
            }
            progress(c.term.id());
            let next = with(self.model, &self.now.state, c);
            let emission = c.term.effect.descriptor().stage == Stage::Object;
            let fit = if emission {
                refit(self.model, next)?
            } else {
                refit_from(self.model, next, self.now.scenes.clone())?
            };
            tracing::info!("  fitted {:?}: deviance {:.1}", fit.state.terms.last(), fit.training.deviance);
            fits.push((c.term.id(), fit));
        }
        let falls = self.estimate_again(fits)?;
        // The scatter between clusters and the errors of the calibration weight the full fits as they do the scores,
        // with one weight for all: an effect with many parameters must not win by fitting errors of the calibration.
        // What the best of the fits removes was scatter of the effect itself, which is no such error.
        let excess = |fit: &Fitted| (fit.training.chi2 - fit.training.pixels).max(0.0);
        let least_excess = fits.iter().map(|(_, fit)| excess(fit)).fold(f64::INFINITY, f64::min);
        let left = if excess(&self.now) > 0.0 { (least_excess / excess(&self.now)).min(1.0) } else { 1.0 };
        let scatter = |c: &Candidate| c.test.as_ref().map_or(0.0, |t| (t.gain / t.t.max(1e-9) - 1.0).max(0.0));
        let weight = |c: &Candidate| 1.0 + left * scatter(c);
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
            if cost < least {
                least = cost;
                best = Some((if c.table.is_some() { c.worth() } else { worth(c, cost) }, *c));
            }
        }
        // A free place of each lens also fits what the calibration does not know of it: a turn of all lenses together
        // that explains all but a trace is the simpler account.
        if let Some((_, strongest)) = best {
            let trace = trace(-least);
            let simpler = |c: &&&Candidate| c.table.is_none() && c.values() < strongest.values() && alike(strongest, c);
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
        self.settle(id, &mut fits[at].1, falls.get(id).copied())?;
        let gain = self.now.held_out.deviance - fits[at].1.held_out.deviance;
        if worth <= 0.0 || gain <= 0.0 {
            return Ok(Verdict::Refused(id));
        }
        let behind = costs.into_iter().map(|(id, cost)| (id, (cost - least) / heaviest)).collect();
        Ok(Verdict::Added(Box::new(Added { fit: fits.swap_remove(at).1, candidate, gain, behind })))
    }

    /// The added effect with its evidence and its ambiguities: finalists are compared by their full fits, other effects
    /// by their scores.
    fn describe(&self, candidates: &[Candidate], added: &Added<'_>) -> Result<Found, ForwardError> {
        let it = added.candidate;
        let near = |c: &&Candidate| match added.behind.iter().find(|(id, _)| *id == c.term.id()) {
            Some((_, behind)) => *behind < AMBIGUOUS,
            None => c.worth() > it.worth() - AMBIGUOUS && c.worth() > 0.0,
        };
        let near: Vec<&Candidate> = candidates.iter().filter(|c| c.term.id() != it.term.id()).filter(near).collect();
        let mut ambiguity = self.overlaps(it, &near)?;
        ambiguity.sort_by(|a, b| b.overlap.total_cmp(&a.overlap));
        let table_sigma = it.table.as_ref().map(|t| t.sigma);
        let of_even = self.now.even_held_out.deviance - added.fit.even_held_out.deviance;
        let of_even_light = if added.gain > 0.0 { (of_even / added.gain).clamp(0.0, 1.0) } else { 0.0 };
        let (id, z, held_out_gain) = (it.term.id(), it.z(), added.gain);
        Ok(Found { id, z, held_out_gain, of_even_light, ambiguity, table_sigma })
    }

    /// How similar the signature of a candidate is to those of others.
    fn overlaps(&self, it: &Candidate, others: &[&Candidate]) -> Result<Vec<Alternative>, ForwardError> {
        if others.is_empty() {
            return Ok(Vec::new());
        }
        let (model, lenses) = (self.model, self.model.lenses());
        let terms: Vec<Term> = [it].iter().chain(others).map(|c| c.term.clone()).collect();
        let mut columns: Vec<Column> = fitted_columns(model, &self.now.state);
        let taken = (0..columns.len()).collect();
        let mut spans = Vec::new();
        for (t, c) in [it].iter().chain(others).enumerate() {
            let first = columns.len();
            let strengths = if c.table.is_some() { Vec::new() } else { c.term.trial_columns(lenses) };
            columns.extend(strengths.into_iter().map(|param| Column::Trial { term: t, param }));
            spans.push((first..columns.len()).collect::<Vec<usize>>());
        }
        let design = Design::compute(model, self.now.expansion(&terms), columns, &Errors::default(), Scope::Training)?;
        let scores = Scores::new(&design, taken);
        let theta = it.test.as_ref().map_or(&[][..], |t| &t.theta);
        let of = |(c, span): (&&Candidate, &Vec<usize>)| Alternative {
            id: c.term.id(),
            overlap: scores.overlap(&spans[0], theta, span),
        };
        Ok(others.iter().zip(&spans[1..]).map(of).collect())
    }
}

/// Result of the full fits.
enum Verdict<'c> {
    /// The best finalist is added.
    Added(Box<Added<'c>>),
    /// The best finalist, given by its id, does not improve the fit or the held-out data.
    Refused(&'static str),
}

/// An effect that is added.
struct Added<'c> {
    fit: Fitted,
    candidate: &'c Candidate,
    /// Fall of the deviance of held-out data.
    gain: f64,
    /// Id of each effect that was compared, and how much larger its deviance is, over the scatter.
    behind: Vec<(&'static str, f64)>,
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
