//! Effects in the shadow of a stronger one that are no error of its law.
//!
//! What a strong effect leaves because its law errs looks a little like many effects of the catalogue, and fits none of
//! them: beside each of them structure stays. So an effect that explains far less than a stronger one is named all the
//! same where it does not resemble that one, and no test sees any structure beside it. Three kinds are taken for an
//! error of the law all the same: what explains less than [`OF_LAW`] of the strongest, where both are of the same part
//! of the instrument and both or neither follow the grid of the pixels; values for each lens, which follow any law; and
//! blurred truths, which follow every error at edges.

use super::candidate::{Candidate, Shadowed};
use super::confirm::{Added, fitted_beside, with};
use super::finalists::alike;
use super::select::Search;
use super::trials::Tried;
use crate::fit::{Fitted, Term};
use ommatidia_model::forward::ForwardError;
use ommatidia_physics::effects::find;

/// Share of what the strongest effect explains that its law leaves at most. On simulators that share no code with this
/// model, laws of strong effects have left 0.02 to 0.12 % in the form of others.
const OF_LAW: f64 = 3e-3;

impl Search<'_, '_> {
    /// Adds effects in the shadow of stronger ones, those that explain most first, until `is_noise` says of the fit
    /// that no structure is left; then searches on. Adds none, and returns false, where it never says so. Does nothing
    /// beside estimated specimens, as [`Search::exchange`].
    ///
    /// # Errors
    /// An object holds negative or non-finite light.
    pub fn out_of_the_shadow(
        &mut self,
        is_noise: impl Fn(&Fitted) -> Result<bool, ForwardError>,
        progress: &mut dyn FnMut(&str),
    ) -> Result<bool, ForwardError> {
        if self.now.state.specimens.is_some() {
            return Ok(false);
        }
        let (now, found) = (self.now.clone(), self.found.clone());
        let part = |id: &str| find(id).map(|effect| (effect.descriptor().stage.part(), effect.is_of_the_grid()));
        let strongest = found.iter().max_by(|a, b| a.held_out_gain.total_cmp(&b.held_out_gain)).map(|f| part(f.id));
        let mut order = self.shadowed.clone();
        order.sort_by(|a, b| b.share.total_cmp(&a.share));
        for Shadowed { id, share, .. } in order.into_iter().filter(|s| !s.id.starts_with("unknown")) {
            if self.is_full(Tried::Catalogue) {
                break;
            }
            progress(id);
            let candidates = self.candidates(Tried::Catalogue)?;
            let candidate = candidates.iter().find(|c| c.term.id() == id && c.test.is_some() && c.worth() > 0.0);
            let lenses = self.model.lenses();
            let follows = |t: &Term| t.effect.is_of_truths() || lenses > 1 && t.strengths(lenses).len() >= lenses;
            let resembles = |c: &Candidate| self.now.state.terms.iter().any(|t| alike(t, &c.term));
            let is_of_law = |c: &Candidate| share < OF_LAW && strongest == Some(part(c.term.id()));
            let is_error = |c: &Candidate| follows(&c.term) || resembles(c) || is_of_law(c);
            let Some(candidate) = candidate.filter(|c| !is_error(c)) else { continue };
            let next = with(self.model, &self.now.state, candidate);
            let fit = fitted_beside(self.model, next, &self.now, std::slice::from_ref(&candidate.term))?;
            let gain = self.now.held_out.deviance - fit.held_out.deviance;
            if gain <= 0.0 {
                continue;
            }
            let added = Added { fit, candidate, gain, behind: Vec::new() };
            let it = self.describe(&candidates, &added)?;
            self.found.push(it);
            self.now = added.fit;
            if is_noise(&self.now)? {
                tracing::info!("beside {id} no structure is left: {share:.2e} of what the strongest effect explains");
                self.shadowed.retain(|s| !self.found.iter().any(|f| f.id == s.id));
                self.run(Tried::Catalogue, progress)?;
                return Ok(true);
            }
        }
        (self.now, self.found) = (now, found);
        Ok(false)
    }
}
