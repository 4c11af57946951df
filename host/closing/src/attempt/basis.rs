//! What an attempt starts from: what is given, the first fit, and what later fits are judged by.

use crate::account::{Excess, Left, within_calibration};
use crate::data::Fault;
use crate::evidence::{
    Constancy, Dependence, JudgedOn, excess, excess_by_calibration, figures, omnibus, standing_alone, surely_worse,
};
use crate::fit::{Design, Fitted, Model, Replicas, Scope, State, fitted_columns, own_columns, refit, replicas};
use crate::options::CloseError;
use ommatidia_model::forward::ForwardError;
use ommatidia_model::instrument::Instrument;

/// What an attempt takes for given.
#[derive(Clone, Copy)]
pub(crate) struct Given<'a> {
    /// Ids of effects that are not tried.
    pub(crate) exclude: &'a [String],
    /// Faults of the records, which were corrected.
    pub(crate) faults: &'a [Fault],
}

/// The first fit of a session, and what later ones are judged by.
pub(super) struct Basis<'m> {
    pub instrument: &'m Instrument,
    pub model: &'m Model<'m>,
    /// Seed of the draws of omnibus tests.
    pub seed: u64,
    /// Number of terms that belong to the instrument.
    pub own: usize,
    /// The fit with all effects of the instrument as they are in its file.
    pub unchanged: Fitted,
    /// The first fit: the same, or with these effects fitted as well where they have changed.
    pub before: Fitted,
    /// The structure that tests see in it.
    pub dependences: Vec<Dependence>,
    pub replicas: Replicas,
    /// The data that the figures are of.
    pub judged_on: JudgedOn,
    /// Excess of the first fit in these data, and in even light and the dark.
    first: [[f64; 2]; 2],
    /// What of it the errors of the calibration make.
    by_calibration: [(usize, f64); 2],
}

impl<'m> Basis<'m> {
    /// Fits a session with the effects that its instrument has.
    pub fn of(instrument: &'m Instrument, model: &'m Model<'m>, seed: u64) -> Result<Self, CloseError> {
        let start = model.state(instrument)?;
        let own = start.terms.len();
        let unchanged = refit(model, unchanged(instrument, start.clone()))?;
        let before = fitted_again(model, start, &unchanged)?;
        let replicas = replicas(model, instrument, &before.state)?;
        let errors = replicas.of(model, &before)?;
        let judged_on = JudgedOn::of(model.seen);
        let both = [judged_on, JudgedOn::Even];
        let by_calibration = both.map(|on| excess_by_calibration(model, &before, &errors, on));
        let dependences = omnibus::test(model, &before, &errors, seed);
        let first = both.map(|on| excess(model, &before, on));
        Ok(Self {
            instrument,
            model,
            seed,
            own,
            unchanged,
            before,
            dependences,
            replicas,
            judged_on,
            first,
            by_calibration,
        })
    }

    /// The structure that tests see in a fit.
    pub fn dependences_of(&self, fit: &Fitted) -> Result<Vec<Dependence>, ForwardError> {
        Ok(omnibus::test(self.model, fit, &self.replicas.of(self.model, fit)?, self.seed))
    }

    /// The structure that tests see with all effects of the instrument as they are in its file.
    pub fn dependences_unchanged(&self) -> Result<Vec<Dependence>, ForwardError> {
        match self.unchanged.state.held == self.before.state.held {
            true => Ok(self.dependences.clone()),
            false => self.dependences_of(&self.unchanged),
        }
    }

    /// Whether errors of the calibration may be all that is wrong with a fit.
    pub fn within_calibration(&self, fit: &Fitted) -> bool {
        let alone = standing_alone(self.model, fit, &self.instrument.psf);
        within_calibration(figures(self.model, fit), &self.instrument.quality, alone)
    }

    /// What is left of the excess.
    pub fn excess(&self, fit: &Fitted) -> Excess {
        self.judged(fit, Excess::of)
    }

    /// Shares of the excess that are left. Asked where a test sees structure.
    pub fn left(&self, fit: &Fitted) -> Left {
        // The structure of unknown specimens may be that of their estimates.
        let judged = match self.judged_on {
            JudgedOn::SelfConsistency => self.judged(fit, Excess::of),
            _ => self.judged(fit, Excess::seen),
        };
        let even = Excess::seen(self.first[1], excess(self.model, fit, JudgedOn::Even), self.by_calibration[1]);
        Left { judged: judged.left, even: even.left, much: judged.is_much() }
    }

    fn judged(&self, fit: &Fitted, beyond: fn([f64; 2], [f64; 2], (usize, f64)) -> Excess) -> Excess {
        beyond(self.first[0], excess(self.model, fit, self.judged_on), self.by_calibration[0])
            .beyond_calibration(self.within_calibration(fit))
    }

    /// Whether each of the added effects of a fit has one strength everywhere.
    pub fn constancies(&self, fit: &Fitted) -> Result<Vec<Constancy>, ForwardError> {
        let model = self.model;
        let columns = fitted_columns(model, &fit.state);
        let errors = self.replicas.of(model, fit)?;
        let design = Design::compute(model, fit.expansion(&[]), columns, &errors, Scope::Training)?;
        Ok((self.own..fit.state.terms.len()).map(|t| Constancy::of(model, fit, &design, t)).collect())
    }
}

/// A state in which all effects of the instrument stay as they are.
fn unchanged(instrument: &Instrument, state: State) -> State {
    State { held: instrument.effects.iter().map(|e| e.id.clone()).collect(), ..state }
}

/// The fit in which the effects of the instrument are free, where it predicts held-out data better than `unchanged`.
fn fitted_again(model: &Model<'_>, start: State, unchanged: &Fitted) -> Result<Fitted, ForwardError> {
    let held = &unchanged.state;
    if own_columns(model, &State { held: start.held.clone(), ..held.clone() }) == own_columns(model, held) {
        return Ok(unchanged.clone());
    }
    let free = refit(model, State { held: start.held, ..held.clone() })?;
    let better = free.held_out.deviance < unchanged.held_out.deviance && !surely_worse(model, unchanged, &free);
    Ok(if better { free } else { unchanged.clone() })
}
