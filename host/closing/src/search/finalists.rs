//! Which candidates are considered, and which are fitted in full.

use super::candidate::{AMBIGUOUS, Candidate};
use crate::evidence::Test;
use crate::fit::Term;
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
        let similar = |c: &Candidate| chosen.iter().any(|b| alike(&b.term, &c.term));
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
pub(super) fn alike(a: &Term, b: &Term) -> bool {
    let says = |a: &Term, b: &Term| a.effect.descriptor().lookalikes.iter().any(|l| l.id == b.id());
    says(a, b) || says(b, a)
}

/// Blurred truths make scenes look sharper than any effect that sharpens images explains: the variances of a motion
/// come out negative, which no motion is, and explain more than every effect. Where that is not so, blurred truths are
/// no candidate; where it is, motion is none.
pub(super) fn by_sharpness(candidates: &mut [Candidate]) {
    let moves = |c: &Candidate| c.term.id() == "motion_blur";
    let sharper = |c: &&Candidate| {
        moves(c) && c.test.as_ref().is_some_and(|t| t.theta.len() > 1 && t.theta[..2].iter().all(|v| *v < 0.0))
    };
    let of_truths = |c: &Candidate| c.term.effect.is_of_truths();
    let others = candidates.iter().filter(|c| !of_truths(c)).map(Candidate::gain).fold(0.0, f64::max);
    let is_blurred = candidates.iter().find(sharper).is_some_and(|c| c.gain() >= others);
    let out = |c: &&mut Candidate| if is_blurred { moves(c) } else { of_truths(c) };
    candidates.iter_mut().filter(out).filter_map(|c| c.test.as_mut()).for_each(Test::discard);
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;
    use ndarray::Array2;
    use ommatidia_physics::effects::find;

    /// A candidate with its evidence, the fall of chi-squared that it promises, and its strengths.
    fn candidate(id: &str, z: f64, gain: f64, theta: &[f64]) -> Candidate {
        let effect = find(id).unwrap();
        let params = effect.descriptor().params.iter().map(|p| p.off).collect();
        let n = theta.len();
        let test = Test {
            theta: theta.to_vec(),
            covariance: Array2::eye(n),
            noise: Array2::eye(n),
            gain,
            t: z * z + n as f64,
            dof: n as f64,
            nu: 20.0,
            p: 1e-3,
            z,
            phi: 1.0,
            left: 1.0,
        };
        let term = Term { effect, params, table: None, table_error: 0.0 };
        Candidate {
            term,
            columns: (0..n).collect(),
            test: Some(test),
            chances: 1.0,
            table: None,
            proved_by_even_light: false,
        }
    }

    #[test]
    fn what_explains_far_more_than_the_significant_ones_is_fitted_too() {
        let all = [
            candidate("motion_blur", 4.6, 4e4, &[1.9, 1.5, 0.3]),
            candidate("veiling_glare", 4.4, 6e4, &[0.02]),
            candidate("halo", 3.6, 1.1e5, &[0.1]),
            candidate("ghost", 2.9, 2e5, &[0.1]),
        ];
        let able: Vec<&Candidate> = all[..2].iter().collect();
        let id = |able: &[&Candidate]| explains_most(able, &all, |c| c.worth() > 0.0).map(|c| c.term.id());
        assert_eq!(id(&able), Some("halo"));
        // Where nothing is significant nothing is wrong.
        assert_eq!(id(&[]), None);
        // Beside what explains nearly as much its own evidence decides.
        let strong = candidate("veiling_glare", 4.4, 1e5, &[0.02]);
        assert_eq!(id(&[&strong]), None);
        assert!(explains_most(&able, &all, |c| c.term.id() != "halo").is_none());
    }

    #[test]
    fn blurred_truths_are_a_candidate_where_scenes_are_sharper_than_any_effect_makes_them() {
        let left = |variance: f64, of_defocus: f64| {
            let mut all = vec![
                candidate("motion_blur", 9.0, 1e5, &[variance, variance, 0.0]),
                candidate("truth_blur", 6.0, 9.9e4, &[-variance]),
                candidate("defocus", 5.0, of_defocus, &[-30.0]),
            ];
            by_sharpness(&mut all);
            all.iter().filter(|c| c.z() > 0.0).map(|c| c.term.id()).collect::<Vec<_>>()
        };
        assert_eq!(left(-0.5, 5e4), ["truth_blur", "defocus"]);
        // Softer scenes, and a defocus that explains more.
        assert_eq!(left(0.5, 5e4), ["motion_blur", "defocus"]);
        assert_eq!(left(-0.5, 2e5), ["motion_blur", "defocus"]);
    }
}
