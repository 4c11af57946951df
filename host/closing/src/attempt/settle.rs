//! Searches for what a model lacks, and keeps what is earned.

use super::basis::{Basis, Given};
use super::views::Views;
use crate::data::{Fault, Observations};
use crate::evidence::{Constancy, Dependence, Test, figures, structured_mean};
use crate::fit::{Fitted, Model, Term, refit};
use crate::options::{CloseError, CloseOptions};
use crate::search::{
    Candidate, Earned, Found, Imitation, Kept, NEEDS_CALIBRATION, Pruned, Search, Shadowed, Tried, earned, lost, prune,
    replaced, score, shared,
};
use ommatidia_model::forward::ForwardError;
use ommatidia_model::instrument::Instrument;

/// What a search ends with.
pub(super) struct Settled {
    /// The fit with all that was found.
    pub now: Fitted,
    /// The fit of the closed instrument, which may have less.
    pub closed: Fitted,
    /// What was found, in order: the terms of `now` beyond those of the instrument.
    pub found: Vec<Found>,
    /// Whether what each of them explains was found beside the others, so that it does not hang on their order.
    pub by_share: bool,
    /// The test of each term of `now`.
    pub tests: Vec<Option<Test>>,
    /// Whether each term of `now` has one strength everywhere.
    pub constancy: Vec<Constancy>,
    /// What was found, and the closed instrument does not have.
    pub unseen: Vec<&'static str>,
    /// The structure that is left.
    pub dependences: Vec<Dependence>,
    /// Effects that were tried and not added.
    pub rest: Vec<Candidate>,
    /// Effects that cannot be tested beside truths of uncertain place.
    pub lost: Vec<&'static str>,
    /// Whether the PSFs are calibrated again, and an entry stands for that.
    pub recalibrated: bool,
    /// chi-squared per pixel of the views with specimens that are estimated from the frames, where they agree with one
    /// another and not with the truths.
    pub views_chi2: Option<f64>,
    /// What was added once, and is out.
    pub out: Out,
}

/// Effects that were added once, or nearly, and why they are out.
pub(super) struct Out {
    /// A term without a name makes them unnecessary.
    pub imitations: Vec<Imitation>,
    /// Effects that were added later make them unnecessary.
    pub removed: Vec<Term>,
    /// With them held-out data are predicted worse.
    pub taken_back: Vec<(Found, Term)>,
    /// They explain less than what the law of a stronger effect may leave.
    pub shadowed: Vec<Shadowed>,
}

/// How a search ends.
pub(super) enum End {
    Settled(Box<Settled>),
    /// The truths are misplaced: what was found beside them says nothing.
    Misplaced(Fault),
}

/// Searches, takes out what only imitates a cause, removes what is not needed, and takes back what does harm.
pub(super) fn settle(
    basis: &Basis<'_>,
    options: &CloseOptions<'_>,
    given: Given<'_>,
    progress: &mut dyn FnMut(&str),
) -> Result<End, CloseError> {
    let (model, replicas, own) = (basis.model, &basis.replicas, basis.own);
    progress("catalogue");
    let mut search = Search::new(model, replicas, basis.before.clone());
    search.exclude = given.exclude.to_vec();
    let lost = lost(model, &basis.before)?;
    search.exclude.extend(lost.iter().map(|id| id.to_string()));
    search.trial_deviance = options.trial_calibration.map(|trial| held_out_deviance(trial, model.seen)).transpose()?;
    search.run(Tried::Catalogue, progress)?;
    let mut dependences = revised(basis, &mut search, progress)?;
    let mut rest = std::mem::take(&mut search.rest);
    let ended = has_ended(&search);
    let mut views = None;
    // Truths that are placed one by one are placed already.
    let one_by_one = model.seen.registrations.iter().any(|r| r.frame.is_some() && r.sigma_px > 0.0);
    let open = !one_by_one && !search.needs_calibration();
    if open && structured_mean(&dependences) && basis.excess(&search.now).is_much() {
        progress("views without truths");
        let known = figures(model, &basis.before).chi2_ndf;
        views = Views::of(basis.instrument, model.seen)?;
        let fitted = search.now.state.registration.first().copied().unwrap_or_default();
        if let Some(fault) = views.as_ref().and_then(|v| v.misplaced(v.agree(known), fitted)) {
            return Ok(End::Misplaced(fault));
        }
        views = views.filter(|v| v.agree(known));
    }
    if structured_mean(&dependences) && !ended {
        progress("terms without a name");
        search.run(Tried::Maps, progress)?;
        search.run(Tried::Curves, progress)?;
        dependences = basis.dependences_of(&search.now)?;
    }
    let recalibrated = search.needs_calibration();
    let mut imitations = Vec::new();
    if !ended && structured_mean(&dependences) {
        imitations = without_imitations(basis, &mut search, given.exclude, progress)?;
    }
    // What stands for a new calibration is judged by what that gains, and not by its own form.
    let keep: &[&str] = if recalibrated { &[NEEDS_CALIBRATION] } else { &[] };
    progress("which names are earned");
    let Earned { now, found, imitations: more } =
        earned(model, search.now, search.found, (own, &basis.before), |fit| basis.constancies(fit))?;
    imitations.extend(more);
    progress("pruning");
    let pruned = prune(model, replicas, now, found, (own, keep))?;
    let kept = match recalibrated {
        true => Kept::all(pruned),
        false => Kept::of(model, replicas, &basis.before, pruned, (own, basis.seed))?,
    };
    let Kept { mut named, closed, unseen, taken_back } = kept;
    let by_share = shared(model, &basis.before, &mut named, own)?;
    let Pruned { mut now, mut found, tests, constancy, removed } = named;
    if found.is_empty() && !recalibrated {
        // Another fit of the nuisance parameters alone is no closed loop.
        now = basis.before.clone();
    }
    let closed = closed.unwrap_or_else(|| now.clone());
    found.iter_mut().for_each(|f| f.or_untested(&rest));
    let in_shadow = search.shadowed.into_iter().filter(|s| !found.iter().any(|f| f.id == s.id));
    let out = Out { imitations, removed, taken_back, shadowed: in_shadow.collect() };
    let terms = out.terms();
    if !terms.is_empty() {
        dependences = basis.dependences_of(&now)?;
        // Their limits are those of effects that are absent.
        rest.retain(|c| !terms.iter().any(|t| t.id() == c.term.id()));
        let named = terms.iter().filter(|t| !t.id().starts_with("unknown"));
        let absent: Vec<Term> = named.map(|t| t.switched_off(model.lenses())).collect();
        rest.extend(score(model, &now, &replicas.of(model, &now)?, &absent)?);
    }
    drop(terms);
    let views_chi2 = views.map(|v| v.chi2());
    let settled = Settled {
        now,
        closed,
        found,
        by_share,
        tests,
        constancy,
        unseen,
        dependences,
        rest,
        lost,
        recalibrated,
        views_chi2,
        out,
    };
    Ok(End::Settled(Box::new(settled)))
}

/// Whether nothing else can be found beside what was found.
fn has_ended(search: &Search<'_, '_>) -> bool {
    search.needs_calibration() || search.truths_are_too_blurred()
}

/// Revises what was found in the catalogue one by one: exchanges effects for better ones, and where structure is left,
/// adds two that hide each other, or those that are no error of a stronger one. Gives the structure that is left.
fn revised(
    basis: &Basis<'_>,
    search: &mut Search<'_, '_>,
    progress: &mut dyn FnMut(&str),
) -> Result<Vec<Dependence>, ForwardError> {
    if !has_ended(search) {
        search.exchange(progress)?;
    }
    let mut dependences = match search.found.is_empty() {
        true => basis.dependences.clone(),
        false => basis.dependences_of(&search.now)?,
    };
    let is_noise = |fit: &Fitted| Ok(!structured_mean(&basis.dependences_of(fit)?));
    for step in [Revision::Pair, Revision::Shadow] {
        if has_ended(search) || !structured_mean(&dependences) {
            break;
        }
        let added = match step {
            Revision::Pair => search.add_pair(progress)?,
            Revision::Shadow => search.out_of_the_shadow(is_noise, progress)?,
        };
        if added {
            search.exchange(progress)?;
            dependences = basis.dependences_of(&search.now)?;
        }
    }
    Ok(dependences)
}

/// What may be added where the search one by one has left structure.
enum Revision {
    Pair,
    Shadow,
}

impl Out {
    fn terms(&self) -> Vec<&Term> {
        let imitations = self.imitations.iter().map(|it| &it.term);
        self.removed.iter().chain(imitations).chain(self.taken_back.iter().map(|(_, term)| term)).collect()
    }
}

/// Where effects of the catalogue leave much with structure: searches again for terms without a name alone, beside the
/// effects that leave little. Gives the effects that these make unnecessary.
fn without_imitations<'b, 'm>(
    basis: &'b Basis<'m>,
    search: &mut Search<'b, 'm>,
    exclude: &[String],
    progress: &mut dyn FnMut(&str),
) -> Result<Vec<Imitation>, ForwardError> {
    let named = |f: &Found| !f.id.starts_with("unknown");
    if !search.found.iter().any(named) {
        return Ok(Vec::new());
    }
    let left = basis.left(&search.now);
    let earns_alone = |f: &Found| left.earns(f, Constancy::default());
    let constancy = match search.found.iter().filter(|f| named(f)).all(earns_alone) {
        true => vec![Constancy::default(); search.found.len()],
        false => basis.constancies(&search.now)?,
    };
    let terms = search.now.state.terms[basis.own..].iter();
    let all: Vec<_> = search.found.iter().zip(terms).zip(constancy).collect();
    if !all.iter().any(|((f, _), constancy)| named(f) && !left.earns(f, *constancy)) {
        return Ok(Vec::new());
    }
    let earned = all.into_iter().filter(|((f, _), constancy)| named(f) && left.earns(f, *constancy));
    let (found, terms): (Vec<_>, Vec<_>) = earned.map(|((f, t), _)| (f.clone(), t.clone())).unzip();
    let mut start = basis.before.clone();
    if !terms.is_empty() {
        start.state.terms.extend(terms);
        start = refit(basis.model, start.state)?;
    }
    let mut again = Search::new(basis.model, &basis.replicas, start);
    (again.exclude, again.found) = (exclude.to_vec(), found);
    replaced(search, again, (basis.own, &basis.before), progress)
}

/// Deviance of the held-out cells of known objects and beads under another instrument.
fn held_out_deviance(instrument: &Instrument, seen: &Observations) -> Result<f64, CloseError> {
    let model = Model::new(instrument, seen)?;
    Ok(refit(&model, model.state(instrument)?)?.known_held_out.deviance)
}
