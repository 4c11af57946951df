//! The moment of a jump.
//!
//! Training frames show between which two of them something has jumped. A frame between these may be held out, and only
//! that frame shows on which side of it the moment lies: this one bit is taken from the held-out data.

use crate::fit::{Fitted, Model, refit_from};
use ommatidia_model::forward::ForwardError;
use ommatidia_physics::effects::{Kind, MOMENT};
use ommatidia_session::Role;

/// A fit whose effect `id` acts from a moment on, with the moment of those between the same two training frames that
/// predicts the held-out frames best. Other fits stay as they are.
///
/// # Errors
/// An object holds negative or non-finite light.
pub(super) fn with_best_moment(model: &Model<'_>, fit: Fitted, id: &str) -> Result<Fitted, ForwardError> {
    let lenses = model.lenses();
    let place = fit.state.terms.iter().enumerate().find_map(|(t, term)| {
        let expanded = term.expanded(lenses);
        let at = expanded.iter().position(|(name, p)| name == MOMENT && p.kind == Kind::Choice)?;
        (term.id() == id).then_some((t, at))
    });
    let Some((term, param)) = place else { return Ok(fit) };
    let scenes = || model.seen.frames.iter().filter(|f| f.role == Role::Scene);
    let trained: Vec<f64> = scenes().filter(|f| !f.held_out).map(|f| f.info.time_s).collect();
    let held_out: Vec<f64> = scenes().filter(|f| f.held_out).map(|f| f.info.time_s).collect();
    let mut best = fit.clone();
    for since_s in moments(fit.state.terms[term].params[param], &trained, &held_out) {
        let mut state = fit.state.clone();
        state.terms[term].params[param] = since_s;
        let next = refit_from(model, state, fit.scenes.clone())?;
        if next.held_out.deviance < best.held_out.deviance {
            best = next;
        }
    }
    Ok(best)
}

/// The moments that the training frames do not tell from `since_s`: the middles between frames that follow each other.
/// Empty: no frame lies between the training frames next to it.
fn moments(since_s: f64, trained: &[f64], held_out: &[f64]) -> Vec<f64> {
    let before = trained.iter().copied().filter(|t| *t < since_s).fold(f64::NEG_INFINITY, f64::max);
    let after = trained.iter().copied().filter(|t| *t >= since_s).fold(f64::INFINITY, f64::min);
    let mut between: Vec<f64> = held_out.iter().copied().filter(|t| before < *t && *t < after).collect();
    if between.is_empty() || !before.is_finite() || !after.is_finite() {
        return Vec::new();
    }
    between.sort_by(f64::total_cmp);
    let all: Vec<f64> = [before].into_iter().chain(between).chain([after]).collect();
    all.windows(2).map(|pair| (pair[0] + pair[1]) / 2.0).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn moments_lie_between_frames_that_follow_each_other() {
        let trained = [0.0, 2.0, 4.0, 7.0];
        assert_eq!(moments(3.0, &trained, &[1.0, 3.0]), [2.5, 3.5]);
        assert_eq!(moments(5.5, &trained, &[6.0, 5.0]), [4.5, 5.5, 6.5]);
        assert!(moments(3.0, &trained, &[1.0]).is_empty());
        assert!(moments(9.0, &trained, &[8.0]).is_empty() && moments(-1.0, &trained, &[-0.5]).is_empty());
    }
}
