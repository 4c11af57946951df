//! The full joint fit: all effects of a state, shapes included, together with the nuisances.
//!
//! Levenberg's damped Gauss-Newton on the cells that may be fitted, with the variance of the model at the current state.

use super::design::{Design, Misfit, nuisances};
use super::model::Model;
use super::solve::pseudo_inverse;
use super::state::{Column, Predicted, State};
use crate::effects::{Kind, Stage};
use crate::forward::{ForwardError, SceneLight};
use ndarray::{Array1, Array2};
use std::sync::Arc;

/// Most steps.
const STEPS: usize = 7;

/// What the optics make of each frame's object; shared, since few effects change it.
pub type Scenes = Arc<[Option<SceneLight>]>;

/// A state at its best fit.
#[derive(Clone)]
pub struct Fitted {
    /// The state.
    pub state: State,
    /// What it predicts.
    pub predicted: Vec<Predicted>,
    /// The optics' part of that.
    pub scenes: Scenes,
    /// How far it is from the cells that may be fitted.
    pub training: Misfit,
    /// How far it is from the held-out cells.
    pub held_out: Misfit,
}

/// The columns of a state's own free values.
pub fn own_columns(model: &Model<'_>, state: &State) -> Vec<Column> {
    let mut columns = Vec::new();
    for (term, t) in state.terms.iter().enumerate() {
        if t.effect.descriptor().stage == Stage::Record || t.table.is_some() {
            continue;
        }
        columns.extend(t.free(model.lenses()).into_iter().map(|param| Column::Own { term, param }));
    }
    columns
}

/// Fits a state from where it stands.
///
/// # Errors
/// An object is no light.
pub fn refit(model: &Model<'_>, state: State) -> Result<Fitted, ForwardError> {
    let scenes = model.scenes(&model.chain(&state.terms))?.into();
    refit_from(model, state, scenes)
}

/// [`refit`] where the optics' part is known already.
///
/// # Errors
/// An object is no light.
pub fn refit_from(model: &Model<'_>, mut state: State, scenes: Scenes) -> Result<Fitted, ForwardError> {
    let columns: Vec<Column> = nuisances(model).into_iter().chain(own_columns(model, &state)).collect();
    // Only what acts on the emission itself goes through the optics again.
    let emission = state.terms.iter().any(|t| t.effect.descriptor().stage == Stage::Object);
    let mut at = Point::of(model, &state, &columns, scenes)?;
    let mut damping = 1e-3;
    for _ in 0..STEPS {
        let proposal = at.step(model, &state, &columns, damping);
        let scenes = if emission { model.scenes(&model.chain(&proposal.terms))?.into() } else { at.scenes.clone() };
        let next = Point::of(model, &proposal, &columns, scenes)?;
        let fall = at.training.deviance - next.training.deviance;
        if fall > 0.0 {
            (state, at) = (proposal, next);
            damping *= 0.2;
            if fall < 0.02 {
                break;
            }
        } else {
            damping *= 20.0;
            if damping > 1e4 {
                break;
            }
        }
    }
    Ok(Fitted { state, training: at.training, held_out: at.held_out, predicted: at.predicted, scenes: at.scenes })
}

/// A state with its linear problem.
struct Point {
    predicted: Vec<Predicted>,
    scenes: Scenes,
    gram: Array2<f64>,
    training: Misfit,
    held_out: Misfit,
}

impl Point {
    fn of(model: &Model<'_>, state: &State, columns: &[Column], scenes: Scenes) -> Result<Self, ForwardError> {
        let predicted = model.predict(state, &scenes);
        let design = Design::compute(model, state, &[], columns.to_vec(), &predicted, &scenes, &[])?;
        let sums = design.training();
        Ok(Self {
            predicted,
            scenes,
            training: sums.misfit(),
            gram: sums.gram,
            held_out: design.sums(|c| c.held_out).misfit(),
        })
    }

    /// The state after one damped step, every value in its range.
    fn step(&self, model: &Model<'_>, state: &State, columns: &[Column], damping: f64) -> State {
        let n = columns.len();
        let mut hessian = self.gram.slice(ndarray::s![..n, ..n]).to_owned();
        hessian.diag_mut().mapv_inplace(|v| v * (1.0 + damping));
        let right = Array1::from_iter((0..n).map(|i| self.gram[[i, n]]));
        let delta = pseudo_inverse(&hessian).dot(&right);
        let mut next = state.clone();
        for (column, d) in columns.iter().zip(delta) {
            match column {
                Column::Scale(s) => next.scale[*s] *= 1.0 + d.clamp(-0.5, 1.0),
                Column::Black => next.black_dn += d,
                Column::Own { term, param } => {
                    let t = &mut next.terms[*term];
                    let p = t.expanded(model.lenses())[*param].1;
                    // A shape far from its place is worth nothing: never more than ten noticeable steps at once.
                    let most = if matches!(p.kind, Kind::Shape(_)) { 10.0 * p.step } else { f64::INFINITY };
                    t.params[*param] = p.outer(p.inner(t.params[*param]) + d.clamp(-most, most));
                }
                Column::Trial { .. } => {}
            }
        }
        next
    }
}
