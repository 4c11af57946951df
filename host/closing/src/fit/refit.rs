//! The joint fit of all parameters of a state, shapes included, with the nuisance parameters.
//!
//! Damped Gauss-Newton steps (Levenberg, Q. Appl. Math. 2, 164, 1944; Marquardt, J. SIAM 11, 431, 1963) on the training
//! cells, with the variance of the model at the current state. Steps are accepted by the deviance.

use super::derivative::Expansion;
use super::design::{Design, Misfit, Scope, nuisances};
use super::errors::Errors;
use super::gauge::{Gauge, gauges};
use super::model::{Model, PUPIL_DEFOCUS};
use super::scenes::Scenes;
use super::solve::pseudo_inverse;
use super::specimen::fitted::specimens;
use super::state::{Column, Predicted, State, Term};
use super::wings::range;
use crate::data::Shown;
use ndarray::{Array1, Array2, Axis};
use ommatidia_model::forward::ForwardError;
use ommatidia_physics::effects::{Kind, Stage};

/// Number of steps that a weak effect needs at most.
const STEPS: usize = 7;
/// Maximum number of steps: a strong effect, far from linear, may need more.
const MOST_STEPS: usize = 25;
/// A fit ends where the next step would lower chi-squared by less than this, or has lowered the deviance by less.
const SETTLED: f64 = 0.02;
/// A step that does not lower the deviance ends the fit where it would lower chi-squared by less than this.
const SLIGHT: f64 = 2.0;
/// A fit goes on beyond [`STEPS`] as long as a step takes this share of the excess of chi-squared over the noise.
const WORTH: f64 = 0.01;
/// From this step on a fit that cannot reach the others is given up.
const GIVEN_UP: usize = 2;
/// What the steps of a fit still gain is less than this many times what the last one gained, or the next one promises.
const AHEAD: f64 = 5.0;

/// A fit finds the light of a stack from this many times too much or too little.
const REACH: f64 = 4.0;
/// Number of frames of a stack by which its light is judged before that.
const REACHED: usize = 5;

/// A fitted state.
#[derive(Clone)]
pub struct Fitted {
    /// The state.
    pub state: State,
    /// The predicted frames.
    pub predicted: Vec<Predicted>,
    /// The light behind the optics, from which they were predicted.
    pub scenes: Scenes,
    /// Misfit of the training cells.
    pub training: Misfit,
    /// Misfit of the held-out cells.
    pub held_out: Misfit,
    /// Misfit of those of them that show known objects or beads: unknown specimens judge no optics, and flats and darks
    /// do not show them.
    pub known_held_out: Misfit,
    /// Misfit of those of them that show even light or the dark.
    pub even_held_out: Misfit,
    /// Directions of the values of its terms that a change of the specimens makes as well.
    pub gauges: Vec<Gauge>,
    /// Whether the fit ended early, since it could not reach the deviance that it was given.
    pub given_up: bool,
}

impl Fitted {
    /// The state with the values of each term moved along its gauges to where most lenses are as they were, and with no
    /// specimens, so that they are estimated again.
    pub(crate) fn without_specimens(&self, model: &Model<'_>) -> State {
        let mut state = State { specimens: None, ..self.state.clone() };
        self.gauges.iter().for_each(|gauge| gauge.simplify(model, &mut state));
        state
    }

    /// The point around which scores are computed, with trial terms beside those of the state.
    pub fn expansion<'a>(&'a self, trials: &'a [Term]) -> Expansion<'a> {
        Expansion { state: &self.state, trials, predicted: &self.predicted, scenes: &self.scenes }
    }
}

/// The columns of a state's free parameters. How far the pupils misjudge the defocus of their lenses shows only beside
/// effects that change wavefronts.
pub fn own_columns(model: &Model<'_>, state: &State) -> Vec<Column> {
    let mut columns = Vec::new();
    let cx = model.forward.context();
    for (term, t) in state.terms.iter().enumerate() {
        let hidden = t.id() == PUPIL_DEFOCUS && !model.forward.changes_wavefronts(&model.chain(&state.terms), &cx);
        let held = state.held.iter().any(|id| id == t.id());
        if t.effect.descriptor().stage == Stage::Record || t.table.is_some() || hidden || held {
            continue;
        }
        columns.extend(t.free(model.lenses()).into_iter().map(|param| Column::Own { term, param }));
    }
    columns
}

/// The columns of all that a state fits: the nuisance parameters that are within their ranges, and its own. What is at
/// the end of its range does not follow the frames any more.
pub fn fitted_columns(model: &Model<'_>, state: &State) -> Vec<Column> {
    let is_free = |column: &Column| match column {
        Column::Wing(ring) => state.wings.get(*ring).is_none_or(|v| {
            let [least, most] = range(*ring);
            least < *v && *v < most
        }),
        _ => true,
    };
    nuisances(model).into_iter().filter(is_free).chain(own_columns(model, state)).collect()
}

/// Fits a state to the training cells, starting from its present values. Specimens that the state has not estimated are
/// estimated first.
///
/// # Errors
/// An object holds negative or non-finite light.
pub fn refit(model: &Model<'_>, state: State) -> Result<Fitted, ForwardError> {
    refit_within(model, state, f64::INFINITY)
}

/// [`refit`], which gives up where its training deviance cannot come below `most`.
///
/// # Errors
/// An object holds negative or non-finite light.
pub fn refit_within(model: &Model<'_>, mut state: State, most: f64) -> Result<Fitted, ForwardError> {
    if state.specimens.is_none() {
        state.specimens = specimens(model, &state)?;
    }
    let scenes = model.scenes(&state)?;
    within_reach(model, &mut state, &scenes);
    refit_from_within(model, state, scenes, most)
}

/// Brings the light of each stack of known objects to that of its frames, where it is far from it and was not fitted
/// yet: the unit of truths may be any, and a fit finds no way back from a prediction beyond full scale.
fn within_reach(model: &Model<'_>, state: &mut State, scenes: &Scenes) {
    let (frames, noise) = (&model.seen.frames, model.forward.noise());
    let chain = model.chain(&state.terms);
    for stack in 0..state.scale.len() {
        let known = |k: &usize| frames[*k].stack == stack && matches!(frames[*k].shown, Shown::Object(_));
        if state.scale[stack] != 1.0 {
            continue;
        }
        let slope = |k: usize| {
            let expected = model.sum_e(k, scenes[k].as_ref(), (&chain, state), 1.0);
            let pairs = frames[k].measured.iter().zip(&expected);
            let pairs: Vec<[f64; 2]> = pairs
                .filter(|(y, _)| f64::from(**y) < noise.saturation_dn)
                .map(|(y, e)| [f64::from(*e) * noise.gain_dn_per_e, f64::from(*y)])
                .collect();
            let mean = [0, 1].map(|i| pairs.iter().map(|p| p[i]).sum::<f64>() / pairs.len().max(1) as f64);
            let sum = |i: usize| pairs.iter().map(|p| (p[0] - mean[0]) * (p[i] - mean[i])).sum::<f64>();
            sum(1) / sum(0).max(f64::MIN_POSITIVE)
        };
        let mut slopes: Vec<f64> = (0..frames.len()).filter(known).take(REACHED).map(slope).collect();
        slopes.sort_by(f64::total_cmp);
        let Some(found) = slopes.get(slopes.len() / 2).copied().filter(|s| s.is_finite() && *s > 0.0) else { continue };
        if !(1.0 / REACH..REACH).contains(&found) {
            state.scale[stack] = found;
        }
    }
}

/// [`refit`] with the light behind the optics given, which must be that of the state.
///
/// # Errors
/// An object holds negative or non-finite light.
pub fn refit_from(model: &Model<'_>, state: State, scenes: Scenes) -> Result<Fitted, ForwardError> {
    refit_from_within(model, state, scenes, f64::INFINITY)
}

/// [`refit_from`], which gives up as [`refit_within`] does.
///
/// # Errors
/// An object holds negative or non-finite light.
pub fn refit_from_within(
    model: &Model<'_>,
    mut state: State,
    scenes: Scenes,
    most: f64,
) -> Result<Fitted, ForwardError> {
    let own = own_columns(model, &state);
    for (term, t) in state.terms.iter_mut().enumerate().filter(|(_, t)| t.id() == PUPIL_DEFOCUS) {
        let is_fitted = own.iter().any(|c| matches!(c, Column::Own { term: of, .. } if *of == term));
        // It was fitted beside an effect that is gone.
        t.params.iter_mut().filter(|_| !is_fitted).for_each(|v| *v = 0.0);
    }
    let columns: Vec<Column> = nuisances(model).into_iter().chain(own).collect();
    let mut at = Point::of(model, &state, &columns, scenes)?;
    let mut slope = at.slope(model, &state, &columns)?;
    let mut damping = 1e-3;
    let (mut last, mut given_up) = (f64::INFINITY, false);
    for step in 0..MOST_STEPS {
        let Step { proposal, expected_fall } = slope.step(model, &state, &columns, damping);
        if expected_fall < SETTLED && damping < 1.0 {
            break;
        }
        given_up = step >= GIVEN_UP && at.training.deviance - AHEAD * expected_fall.max(last) > most;
        if given_up {
            break;
        }
        let scenes = model.scenes(&proposal)?;
        let next = Point::of(model, &proposal, &columns, scenes)?;
        let fall = at.training.deviance - next.training.deviance;
        if fall > 0.0 {
            (state, at, last) = (proposal, next, fall);
            damping *= 0.2;
            let excess = (at.training.chi2 - at.training.pixels).max(0.0);
            if fall < SETTLED || step + 1 >= STEPS && fall < WORTH * excess {
                break;
            }
            slope = at.slope(model, &state, &columns)?;
        } else {
            damping *= 20.0;
            if damping > 1e4 || step + 1 >= STEPS || expected_fall < SLIGHT {
                break;
            }
        }
    }
    Ok(Fitted {
        state,
        training: at.training,
        held_out: at.held_out,
        known_held_out: at.known_held_out,
        even_held_out: at.even_held_out,
        predicted: at.predicted,
        scenes: at.scenes,
        gauges: slope.gauges,
        given_up,
    })
}

/// The frames of one state, and how well they agree with the measured ones.
struct Point {
    predicted: Vec<Predicted>,
    scenes: Scenes,
    training: Misfit,
    held_out: Misfit,
    known_held_out: Misfit,
    even_held_out: Misfit,
}

/// The problem linearised at a point. It takes most of the time of a fit, and the last point needs none.
struct Slope {
    gram: Array2<f64>,
    gauges: Vec<Gauge>,
}

/// A step of a fit.
struct Step {
    proposal: State,
    /// Fall of chi-squared if the frames are linear in the values.
    expected_fall: f64,
}

impl Point {
    fn of(model: &Model<'_>, state: &State, columns: &[Column], scenes: Scenes) -> Result<Self, ForwardError> {
        let predicted = model.predict(state, &scenes);
        let at = Expansion { state, trials: &[], predicted: &predicted, scenes: &scenes };
        let design = Design::of_residuals(model, at, columns)?;
        let shown = |k: usize| model.seen.frames.get(k).map(|f| &f.shown);
        let known = |k: usize| matches!(shown(k), Some(Shown::Object(_) | Shown::Bead(_)));
        let even = |k: usize| matches!(shown(k), Some(Shown::Even | Shown::Dark));
        Ok(Self {
            predicted,
            scenes,
            training: design.training().misfit(),
            held_out: design.sums(|c| c.held_out).misfit(),
            known_held_out: design.sums(|c| c.held_out && known(c.frame)).misfit(),
            even_held_out: design.sums(|c| c.held_out && even(c.frame)).misfit(),
        })
    }

    fn slope(&self, model: &Model<'_>, state: &State, columns: &[Column]) -> Result<Slope, ForwardError> {
        let at = Expansion { state, trials: &[], predicted: &self.predicted, scenes: &self.scenes };
        let design = Design::compute(model, at, columns.to_vec(), &Errors::default(), Scope::Training)?;
        let gram = design.training().gram;
        Ok(Slope { gauges: gauges(&design, &gram), gram })
    }
}

impl Slope {
    /// One damped step, with every value kept in its range.
    fn step(&self, model: &Model<'_>, state: &State, columns: &[Column], damping: f64) -> Step {
        let n = columns.len();
        let mut hessian = self.gram.slice(ndarray::s![..n, ..n]).to_owned();
        hessian.diag_mut().mapv_inplace(|v| v * (1.0 + damping));
        self.gauges.iter().for_each(|gauge| gauge.stiffen(&mut hessian));
        let right = Array1::from_iter((0..n).map(|i| self.gram[[i, n]]));
        let delta = within(&hessian, &right, |i| match columns[i] {
            Column::Wing(ring) => range(ring).map(|end| end - state.wings[ring]),
            _ => [f64::NEG_INFINITY, f64::INFINITY],
        });
        let expected_fall = 2.0 * delta.dot(&right) - delta.dot(&hessian.dot(&delta));
        let mut next = state.clone();
        for (column, d) in columns.iter().zip(delta) {
            match column {
                Column::Scale(s) => next.scale[*s] *= 1.0 + d.clamp(-0.5, 1.0),
                Column::Black => next.black_dn += d,
                Column::Background(stack, part) => next.background_e[*stack][*part] += d,
                Column::Lamp(term) => next.lamp[*term] += d.clamp(-0.5, 0.5),
                Column::Wing(ring) => {
                    let [least, most] = range(*ring);
                    next.wings[*ring] = (next.wings[*ring] + d).clamp(least, most);
                }
                Column::Registration(group, part) => next.registration[*group][*part] += d,
                Column::Own { term, param } => {
                    let t = &mut next.terms[*term];
                    let p = t.expanded(model.lenses())[*param].1;
                    // The linearisation of a shape holds near its value only: at most ten of its steps at once.
                    let most = if matches!(p.kind, Kind::Shape(_)) { 10.0 * p.step } else { f64::INFINITY };
                    t.params[*param] = p.outer(p.inner(t.params[*param]) + d.clamp(-most, most));
                }
                Column::Trial { .. } => {}
            }
        }
        Step { proposal: next, expected_fall }
    }
}

/// The step that lowers chi-squared most with each value within its range: `ends` gives the least and largest step of a
/// value. What would leave its range goes to the end of it, and the others follow.
fn within(hessian: &Array2<f64>, right: &Array1<f64>, ends: impl Fn(usize) -> [f64; 2]) -> Array1<f64> {
    let n = right.len();
    let mut fixed: Vec<Option<f64>> = vec![None; n];
    loop {
        let free: Vec<usize> = (0..n).filter(|i| fixed[*i].is_none()).collect();
        let held =
            |i: usize| fixed.iter().enumerate().map(|(j, v)| v.map_or(0.0, |v| hessian[[i, j]] * v)).sum::<f64>();
        let rest = Array1::from_iter(free.iter().map(|i| right[*i] - held(*i)));
        let part = hessian.select(Axis(0), &free).select(Axis(1), &free);
        let step = pseudo_inverse(&part).dot(&rest);
        let out: Vec<(usize, f64)> = free
            .iter()
            .zip(&step)
            .filter_map(|(i, d)| {
                let [least, most] = ends(*i);
                let end = d.clamp(least, most);
                (end != *d).then_some((*i, end))
            })
            .collect();
        if out.is_empty() {
            let mut delta = Array1::from_iter(fixed.into_iter().map(|v| v.unwrap_or(0.0)));
            free.into_iter().zip(step).for_each(|(i, d)| delta[i] = d);
            return delta;
        }
        out.into_iter().for_each(|(i, end)| fixed[i] = Some(end));
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use ndarray::array;

    #[test]
    fn what_would_leave_its_range_goes_to_its_end_and_the_others_follow() {
        let (hessian, right) = (array![[2.0, 1.0], [1.0, 2.0]], array![1.0, 5.0]);
        let all = within(&hessian, &right, |_| [f64::NEG_INFINITY, f64::INFINITY]);
        assert!((hessian.dot(&all) - &right).iter().all(|v| v.abs() < 1e-5), "{all}");
        // Without ends (-1, 3); with the second at most 1, the first minimises 2 a^2 / 2 + a - a.
        let held = within(&hessian, &right, |i| [[-9.0, 9.0], [-9.0, 1.0]][i]);
        assert!(held[0].abs() < 1e-5 && held[1] == 1.0, "{held}");
    }
}
