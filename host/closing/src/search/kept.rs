//! What is kept of what was found: the closed instrument never predicts held-out data worse than before.

use super::candidate::Found;
use super::prune::{Pruned, prune};
use crate::evidence::{compared, is_worse, omnibus, structured, surely_worse};
use crate::fit::{Fitted, Model, Replicas, Term, refit};
use ommatidia_model::forward::ForwardError;
use ommatidia_physics::effects::find;

/// Evidence from which an effect is named although held-out data do not show it, standard deviations.
const PROVEN: f64 = 5.0;

/// What is kept.
pub(crate) struct Kept {
    /// What the account names.
    pub(crate) named: Pruned,
    /// The fit of the closed instrument, where that has less than what is named.
    pub(crate) closed: Option<Fitted>,
    /// Effects that are named and that the closed instrument does not have.
    pub(crate) unseen: Vec<&'static str>,
    /// Effects that are neither named nor added.
    pub(crate) taken_back: Vec<(Found, Term)>,
}

impl Kept {
    /// All that was found, whatever held-out data say.
    pub(crate) fn all(named: Pruned) -> Self {
        Self { named, closed: None, unseen: Vec::new(), taken_back: Vec::new() }
    }

    /// Takes effects back, the last first, as long as held-out data are predicted worse than `before`. Where that is
    /// no more than chance, and all effects together leave nothing to see, or where their strengths are shown to be the
    /// same everywhere, they are named nevertheless: flats may prove what held-out scenes do not show. The first `own`
    /// terms belong to the instrument.
    ///
    /// # Errors
    /// An object holds negative or non-finite light.
    pub(crate) fn of(
        model: &Model<'_>,
        replicas: &Replicas,
        before: &Fitted,
        named: Pruned,
        (own, seed): (usize, u64),
    ) -> Result<Self, ForwardError> {
        let worse = |after: &Fitted| {
            let [before, after] = compared(model, before, after);
            is_worse(before, after)
        };
        if !worse(&named.now) {
            return Ok(Self::all(named));
        }
        // What changes the noise alone predicts every frame as before. Only the light and the black level have moved
        // within their errors, since the frames count by another noise: the closed instrument has those of before.
        if named.found.iter().all(|f| find(f.id).is_some_and(|effect| effect.noise_only())) {
            let mut closed = before.clone();
            closed.state.terms.extend(named.now.state.terms.iter().skip(own).cloned());
            return Ok(Self { closed: Some(closed), ..Self::all(named) });
        }
        let all = named.clone();
        let (mut left, mut taken_back) = (named, Vec::new());
        while worse(&left.now) {
            let (Some(last), Some(term)) = (left.found.pop(), left.now.state.terms.pop()) else { break };
            taken_back.push((last, term));
            let removed = left.removed;
            left = prune(model, replicas, refit(model, left.now.state)?, left.found, (own, &[]))?;
            left.removed.splice(..0, removed);
        }
        let known = taken_back.iter().all(|(f, _)| !f.id.starts_with("unknown") && f.z > PROVEN);
        let is_shown = |f: &Found| {
            let which = all.found.iter().position(|other| other.id == f.id);
            which.and_then(|n| all.constancy.get(own + n)).is_some_and(|c| c.is_shown())
        };
        // A strength that is one in all frames and parts of the sensor outweighs what a few held-out frames say.
        let proven = known
            && (taken_back.iter().all(|(f, _)| is_shown(f))
                || !surely_worse(model, before, &all.now)
                    && !structured(&omnibus::test(model, &all.now, &replicas.of(model, &all.now)?, seed)));
        if !proven {
            return Ok(Self { named: left, closed: None, unseen: Vec::new(), taken_back });
        }
        let has = |id: &str| left.found.iter().any(|f| f.id == id);
        let unseen = all.found.iter().map(|f| f.id).filter(|id| !has(id)).collect();
        let closed = Some(if left.found.is_empty() { before.clone() } else { left.now });
        Ok(Self { named: all, closed, unseen, taken_back: Vec::new() })
    }
}
