//! Which candidates are fitted in full.

use super::candidate::{AMBIGUOUS, Candidate};
use crate::fit::repeats::noisy;

/// Number of the best candidates that are fitted in full.
const FINALISTS: usize = 3;
/// Evidence from which an effect that explains [`FAR_MORE`] than the significant ones is fitted, standard deviations.
const SEEN: f64 = 3.0;
/// The factor of "far more".
const FAR_MORE: f64 = 1.5;
/// Number of effects similar to one of these that are fitted in full as well.
const LOOKALIKES: usize = 2;

/// The candidates that are fitted in full: the best by the score test; and, since the scores of a large effect are far
/// from linear, the one that explains most by the noise alone, the simplest of those that explain nearly as much, and
/// the best of the effects that the catalogue lists as similar to one of these.
pub(super) fn finalists<'c>(able: &[&'c Candidate]) -> Vec<&'c Candidate> {
    let gain = |c: &Candidate| c.test.as_ref().map_or(0.0, |t| t.gain);
    let (top, most) = able.iter().fold((0.0, 0.0), |m: (f64, f64), c| (m.0.max(c.worth()), m.1.max(gain(c))));
    let mut chosen: Vec<&Candidate> = able.iter().filter(|c| c.worth() > 0.5 * top).take(FINALISTS).copied().collect();
    let open = |chosen: &[&Candidate], c: &Candidate| !chosen.iter().any(|b| b.term.id() == c.term.id());
    chosen.extend(able.iter().filter(|c| gain(c) >= most && open(&chosen, c)).copied().collect::<Vec<_>>());
    let mut simple: Vec<&Candidate> =
        able.iter().filter(|c| gain(c) > 0.7 * most && open(&chosen, c)).copied().collect();
    simple.sort_by_key(|c| c.columns.len());
    chosen.extend(simple.into_iter().take(1));
    // A change of the mean from one repeat to the next looks like noise, too; noise does not look like such a change.
    let of_mean = |c: &&&Candidate| !noisy(&c.term);
    if !chosen.iter().any(|c| of_mean(&c)) {
        chosen.extend(able.iter().find(of_mean).copied());
    }
    if let Some(best) = chosen.first().copied() {
        let similar = |c: &Candidate| chosen.iter().any(|b| alike(b, c));
        // What makes wings is open only where repeats show wings, and rare large jumps are far from what the score of
        // small ones expects.
        let near = |c: &&&Candidate| (gain(c) > 0.2 * gain(best) || c.term.effect.makes_wings()) && similar(c);
        let more: Vec<&Candidate> = able.iter().filter(near).filter(|c| open(&chosen, c)).copied().collect();
        chosen.extend(more.into_iter().take(LOOKALIKES));
    }
    chosen
}

/// The candidate that explains far more than all that are significant (`able`), though its own evidence is short of
/// that: few frames, or few specimens that are estimated, scatter too much to show a single strong effect, and one that
/// resembles it in part may scatter less. That something is wrong is shown by the significant ones; what it is, by the
/// full fits. `open`: whether a candidate is still to be tried.
pub(super) fn explains_most<'c>(
    able: &[&Candidate],
    candidates: &'c [Candidate],
    open: impl Fn(&Candidate) -> bool,
) -> Option<&'c Candidate> {
    let most = able.iter().map(|c| c.gain()).reduce(f64::max)?;
    let seen = |c: &&Candidate| c.table.is_none() && c.z() > SEEN && c.gain() > FAR_MORE * most && open(c);
    candidates.iter().filter(seen).max_by(|a, b| a.gain().total_cmp(&b.gain()))
}

/// The effect that makes single pixels jump, with its cost, in place of one that scales the noise and explains about as
/// much: where `jumps` so large are seen that no normal noise makes them. The converter may know the noise in few codes
/// only, whose form says nothing.
pub(super) fn of_jumps<'c>(
    best: &Candidate,
    finalists: &[&'c Candidate],
    costs: &[(&'static str, f64)],
    jumps: impl FnOnce() -> bool,
) -> Option<(&'c Candidate, f64)> {
    let winged = |c: &Candidate| c.term.effect.makes_wings();
    let of = |c: &Candidate| costs.iter().find(|(id, _)| *id == c.term.id()).map(|(_, cost)| *cost);
    let c = finalists.iter().find(|c| winged(c))?;
    let cost = of(c)?;
    let scales = best.term.effect.noise_only() && !winged(best);
    (scales && cost < 0.0 && cost - of(best)? < AMBIGUOUS && jumps()).then_some((*c, cost))
}

/// Whether the catalogue lists two effects as similar.
pub(super) fn alike(a: &Candidate, b: &Candidate) -> bool {
    let says = |a: &Candidate, b: &Candidate| a.term.effect.descriptor().lookalikes.iter().any(|l| l.id == b.term.id());
    says(a, b) || says(b, a)
}
