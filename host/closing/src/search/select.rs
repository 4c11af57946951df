//! Forward selection: score every trial term, fit the best in full, accept it on held-out data, until none is
//! significant.

use super::candidate::{AMBIGUOUS, Alternative, Candidate, Found, Shadowed};
use super::confirm::{Added, FullFits, Verdict, with};
use super::finalists::{alike, by_sharpness, explains_most, finalists};
use super::scoring::{log, score, tabled};
use super::trials::{GRADIENT, NEEDS_CALIBRATION, Tried, evidence, is_laplacian};
use crate::data::{Frame, Shown};
use crate::evidence::{Scores, Test, holm};
use crate::fit::repeats::wings;
use crate::fit::{
    Column, Design, Errors, Fitted, Misfit, Model, Predicted, Replicas, Scope, Term, fitted_columns, refit_from,
};
use ommatidia_model::forward::ForwardError;
use ommatidia_physics::effects::find;

/// Family-wise error rate: probability that an effect is significant although the model is complete (Holm).
pub const ALPHA: f64 = 0.02;
/// The law of an effect describes a real change only in part: about this share of what a strong effect explains
/// remains, in the form of its neighbours in law. The same share of what is left unexplained may have the form of any
/// one effect. An effect that gains less beside a strong one is not named.
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
/// Errors of the PSFs between calibrated positions may feign an effect that explains this share of them: of the
/// relative error times the light of scenes of known objects.
const FEIGNED: f64 = 0.1;
/// The same in frames of single beads, where no other focus averages the errors and all beads have much the same: share
/// of the excess of chi-squared.
const FEIGNED_IN_BEADS: f64 = 0.25;
/// Significance of wings of the noise, standard deviations, below which larger noise is no sign of an effect that makes
/// wings.
const WINGS: f64 = 3.0;
/// Excess of chi-squared over the noise on held-out data; 0 if there is none.
fn excess(fit: &Fitted) -> f64 {
    (fit.held_out.chi2 - fit.held_out.pixels).max(0.0)
}

/// Blurred truths that leave more than this share of the excess end a search.
const TOO_BLURRED: f64 = 0.05;

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
    pub(super) model: &'m Model<'a>,
    pub(super) replicas: &'m Replicas,
    /// The present state, fitted.
    pub now: Fitted,
    /// Effects that were added so far.
    pub found: Vec<Found>,
    /// Candidates of the last step that were not added, with their scores.
    pub rest: Vec<Candidate>,
    /// Excess of chi-squared over the noise on held-out data before the search.
    first_excess: f64,
    /// The largest fall of the training deviance by an effect so far; 0 without one.
    pub(super) strongest_fall: f64,
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
            first_excess: excess(&now),
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
    pub fn run(&mut self, tried: Tried, progress: &mut dyn FnMut(&str)) -> Result<(), ForwardError> {
        let mut refused = Refused { ids: self.shadowed.iter().map(|s| s.id).collect(), in_vain: 0 };
        loop {
            let candidates = self.candidates(tried)?;
            let added = self.step(tried, &candidates, &mut refused, progress)?;
            if !added || self.needs_calibration() || self.truths_are_too_blurred() {
                self.rest = candidates;
                return Ok(());
            }
        }
    }

    /// All candidates with their evidence beside the present state, the best first.
    pub(super) fn candidates(&self, tried: Tried) -> Result<Vec<Candidate>, ForwardError> {
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
            by_sharpness(&mut candidates);
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
        progress: &mut dyn FnMut(&str),
    ) -> Result<bool, ForwardError> {
        let p: Vec<f64> = candidates.iter().map(Candidate::p).collect();
        let significant = holm(&p, ALPHA);
        let pixels = self.now.training.pixels;
        let mut fits = Vec::new();
        loop {
            let feigned = self.feigned();
            let may_be = |c: &Candidate| {
                let beyond_feigned = c.table.is_some() || c.term.effect.is_of_the_grid() || c.gain() > feigned;
                let new = !refused.ids.contains(&c.term.id()) && c.worth() > 0.0;
                new && c.is_large_enough(pixels) && beyond_feigned
            };
            // It competes with names that resemble it, and is nothing by itself.
            let competes = |c: &Candidate| {
                let mut others = candidates.iter().zip(&significant).filter(|(o, s)| **s && may_be(o));
                tried != Tried::Catalogue || c.term.id() != GRADIENT || others.any(|(o, _)| alike(&c.term, &o.term))
            };
            let open = |c: &Candidate| may_be(c) && competes(c);
            let able = candidates.iter().zip(&significant).filter(|(c, s)| **s && open(c)).map(|(c, _)| c);
            // The score of an effect in the shadow shows that already; its full fit would only take time.
            let floor = SHADOW * self.cast_by(self.strongest_fall, self.now.training);
            let (able, faint): (Vec<&Candidate>, Vec<&Candidate>) =
                able.partition(|c| !c.can_be_shadowed(pixels) || c.gain() >= floor);
            let mut finalists = finalists(&able);
            if tried == Tried::Catalogue {
                finalists.extend(explains_most(&able, candidates, open));
            }
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
            let verdict = FullFits { model: self.model, now: &self.now }.confirm(&finalists, &mut fits, progress)?;
            match self.or_calibration(verdict, candidates)? {
                Verdict::Added(it)
                    if it.candidate.can_be_shadowed(pixels)
                        && it.gain < SHADOW * self.cast_by(self.strongest_gain(), self.now.held_out) =>
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
                        && it.gain < PART * excess(&self.now) =>
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

    /// Fall of chi-squared that errors of the PSFs may feign: where beads alone show the optics, a quarter of the
    /// excess, and no more than a tenth of the noise; in scenes more than nothing where the PSFs between the positions
    /// of the calibration are known worse than its noise allows.
    fn feigned(&self) -> f64 {
        let seen = self.model.seen;
        let of = |shows: fn(&Shown) -> bool| {
            let training = seen.frames.iter().zip(&*self.now.predicted);
            training.filter(move |(f, _)| shows(&f.shown) && !f.held_out)
        };
        let is_bead: fn(&Shown) -> bool = |shown| matches!(shown, Shown::Bead(_));
        if of(is_bead).next().is_some() {
            let excess = |here: &Predicted| {
                let of_pixel = |(r, w): (&f32, &f32)| f64::from(r * w).powi(2) - f64::from(u8::from(*w > 0.0));
                here.residual_dn.iter().zip(&here.inverse_sigma).map(of_pixel).sum::<f64>()
            };
            let all = of(is_bead).map(|(_, here)| excess(here)).sum::<f64>().max(0.0);
            return (FEIGNED_IN_BEADS * all).min(FEIGNED * (of(is_bead).count() * seen.pixels.len()) as f64);
        }
        let black = self.model.forward.noise().black_level_dn;
        let squared_light = |(f, here): (&Frame, &Predicted)| {
            let signal = |(y, w): (&f32, &f32)| ((f64::from(*y) - black) * f64::from(*w)).powi(2);
            f.measured.iter().zip(&here.inverse_sigma).map(signal).sum::<f64>()
        };
        let objects = of(|shown| matches!(shown, Shown::Object(_)));
        FEIGNED * self.model.coarse_error.powi(2) * objects.map(squared_light).sum::<f64>()
    }

    /// Whether a candidate that improves held-out data by `gain` beside the other effects explains more than errors of
    /// the PSFs may feign, and more than a stronger effect leaves in its shadow.
    pub(super) fn stands_out(&self, c: &Candidate, gain: f64) -> bool {
        let in_shadow = c.can_be_shadowed(self.now.training.pixels)
            && gain < SHADOW * self.cast_by(self.strongest_gain(), self.now.held_out);
        let beyond_feigned = c.term.effect.is_of_the_grid() || c.gain() > self.feigned();
        gain > 0.0 && beyond_feigned && !in_shadow
    }

    /// What casts a shadow on weaker effects: what the strongest effect explains, or, beside one, the excess that is
    /// left where that is more. The law of an effect and the PSFs of a calibration err by a small part each, and what
    /// they leave has the form of small changes. 0 without an effect: the first one stands beside nothing.
    pub(super) fn cast_by(&self, strongest: f64, now: Misfit) -> f64 {
        if strongest > 0.0 { strongest.max(now.chi2 - now.pixels) } else { 0.0 }
    }

    /// Whether as many terms of a family were added as may be.
    pub(super) fn is_full(&self, tried: Tried) -> bool {
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

    /// Whether blurred truths leave so much that nothing smaller can be found beside it: no blur is exactly a Gaussian,
    /// and what was lost of the finest details comes back with the errors of the model.
    pub fn truths_are_too_blurred(&self) -> bool {
        let blurred = self.found.iter().any(|f| find(f.id).is_some_and(|e| e.is_of_truths()));
        blurred && excess(&self.now) > TOO_BLURRED * self.first_excess
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

    /// The added effect with its evidence and its ambiguities: finalists are compared by their full fits, other effects
    /// by their scores.
    pub(super) fn describe(&self, candidates: &[Candidate], added: &Added<'_>) -> Result<Found, ForwardError> {
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
        let proved_by_even_light = it.proved_by_even_light;
        Ok(Found { id, z, held_out_gain, of_even_light, proved_by_even_light, ambiguity, table_sigma })
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
