//! Drift within a recording: the strengths of effects frame by frame.
//!
//! Around the last fit, frame k alone gives the strengths of an effect as theta_k = Q_k^-1 s_k beside the fitted ones,
//! from the score s_k of that frame and its information Q_k, with the specimen of the frame projected out. A straight
//! line over time is fitted to them. Its slope is tested against the scatter of the frames about the line: what the
//! calibration errs by in all frames alike is no drift, and what it errs by from specimen to specimen is scatter.

use super::stats::{f_tail, sigmas};
use crate::data::Shown;
use crate::fit::gauge::directions;
use crate::fit::{Column, Design, Errors, Fitted, Model, Scope, Term, pseudo_inverse};
use ndarray::{Array1, Array2, Axis};
use ommatidia_model::forward::ForwardError;
use ommatidia_physics::effects::{Stage, find};
use serde::{Deserialize, Serialize};

/// Effects whose strengths are followed, beside those of the optics that were found.
const FOLLOWED: [&str; 3] = ["array_shift", "defocus", "lens_gain"];
/// Fewest frames for a line with an error.
const LEAST_FRAMES: usize = 4;

/// A strength of an effect in each of the frames whose specimens were estimated.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Curve {
    /// Id of the effect.
    pub id: String,
    /// Name of the strength.
    pub param: String,
    /// Its unit.
    pub unit: String,
    /// Time of each frame, s.
    pub time_s: Vec<f64>,
    /// Its value in each frame.
    pub value: Vec<f64>,
    /// Standard errors by noise and by the scatter of the parts of the frame, without the calibration's.
    pub sigma: Vec<f64>,
    /// Strength of the evidence that the effect changes over time, standard deviations; that of all its strengths
    /// together.
    pub z: f64,
}

/// The curves of a fitted state; none where fewer than four frames of unknown specimens take part. The first `own`
/// terms belong to the instrument.
///
/// # Errors
/// An object holds negative or non-finite light.
pub(crate) fn curves(model: &Model<'_>, fit: &Fitted, own: usize) -> Result<Vec<Curve>, ForwardError> {
    let seen = model.seen;
    let frames: Vec<usize> = (0..seen.frames.len()).filter(|k| seen.frames[*k].shown == Shown::Estimated).collect();
    let time_s: Vec<f64> = frames.iter().map(|k| seen.frames[*k].info.time_s).collect();
    let mut times = time_s.clone();
    times.sort_by(f64::total_cmp);
    times.dedup();
    if times.len() < LEAST_FRAMES {
        return Ok(Vec::new());
    }
    let lenses = model.lenses();
    let optics = |t: &Term| matches!(t.effect.descriptor().stage, Stage::Geometry | Stage::Lens) && t.table.is_none();
    let known = |t: &Term| optics(t) && !t.id().starts_with("unknown");
    let found: Vec<usize> = (own..fit.state.terms.len()).filter(|t| known(&fit.state.terms[*t])).collect();
    let absent = |id: &&str| !fit.state.terms.iter().any(|t| t.id() == *id);
    let trials: Vec<Term> = FOLLOWED
        .iter()
        .filter(|id| absent(id))
        .filter_map(|id| {
            let effect = find(id)?;
            let params = effect.descriptor().expanded(lenses).iter().map(|(_, p)| p.off).collect();
            Some(Term { effect, params, table: None, table_error: 0.0 })
        })
        .collect();
    let (mut columns, mut groups) = (Vec::new(), Vec::new());
    let mut terms: Vec<&Term> = Vec::new();
    for t in found {
        let first = columns.len();
        let term = &fit.state.terms[t];
        columns.extend(term.strengths(lenses).into_iter().map(|param| Column::Own { term: t, param }));
        groups.push(first..columns.len());
        terms.push(term);
    }
    for (t, term) in trials.iter().enumerate() {
        let first = columns.len();
        columns.extend(term.strengths(lenses).into_iter().map(|param| Column::Trial { term: t, param }));
        groups.push(first..columns.len());
        terms.push(term);
    }
    let scope = Scope::Scores { given: 0, groups: &groups };
    let design = Design::compute(model, fit.expansion(&trials), columns, &Errors::default(), scope)?;
    let mut out = Vec::new();
    for (term, group) in terms.into_iter().zip(groups) {
        let group: Vec<usize> = group.collect();
        let Some(Followed { steps, z }) = followed(&design, &group, (&frames, &time_s)) else { continue };
        let expanded = term.expanded(lenses);
        for (j, i) in term.strengths(lenses).into_iter().enumerate() {
            let (name, p) = &expanded[i];
            let at = |step: &Step| p.outer(p.inner(term.params[i]) + step.theta[j]);
            let error = |step: &Step| p.outer_sigma(p.inner(term.params[i]), step.covariance[[j, j]].max(0.0).sqrt());
            out.push(Curve {
                id: term.id().into(),
                param: name.clone(),
                unit: p.unit.into(),
                time_s: time_s.clone(),
                value: steps.iter().map(at).collect(),
                sigma: steps.iter().map(error).collect(),
                z,
            });
        }
    }
    Ok(out)
}

/// What one frame shows beside the fitted strengths.
struct Step {
    theta: Array1<f64>,
    covariance: Array2<f64>,
}

struct Followed {
    steps: Vec<Step>,
    z: f64,
}

/// The strengths of the columns `group` frame by frame. None: the specimens make all of them as well.
fn followed(design: &Design, group: &[usize], (frames, time_s): (&[usize], &[f64])) -> Option<Followed> {
    let pick = |m: &Array2<f64>, cols: &[usize]| m.select(Axis(0), group).select(Axis(1), cols);
    let residual = [design.residual()];
    let training = design.training().gram;
    let measurable = directions(&pick(&training, group), &pick(&design.before, group)).measurable;
    if measurable.ncols() == 0 {
        return None;
    }
    // In the measurable directions: score and information, and what the parts of the frame say on their scatter.
    let reduced = |gram: &Array2<f64>| {
        (
            measurable.t().dot(&pick(gram, group)).dot(&measurable),
            measurable.t().dot(&pick(gram, &residual)).column(0).to_owned(),
        )
    };
    let mut measurable_steps = Vec::new();
    for k in frames {
        let parts: Vec<_> = design.cells.iter().filter(|c| !c.held_out && c.frame == *k && c.pixels > 0.0).collect();
        let (q, s) = reduced(&design.sums(|c| !c.held_out && c.frame == *k).gram);
        let inverse = pseudo_inverse(&q);
        let a = inverse.dot(&s);
        let scatter: f64 = parts
            .iter()
            .map(|cell| {
                let (q, s) = reduced(&cell.gram.mapv(f64::from));
                let u = s - q.dot(&a);
                u.dot(&inverse.dot(&u))
            })
            .sum();
        let (n, d) = (parts.len() as f64, inverse.dot(&q).diag().sum().max(1.0));
        let phi = if n > 3.0 { (scatter / d * n / (n - 1.0)).max(1.0) } else { 1.0 };
        measurable_steps.push((a, q / phi, inverse * phi));
    }
    let z = drift(&measurable_steps.iter().map(|(a, q, _)| (a.clone(), q.clone())).collect::<Vec<_>>(), time_s);
    let step = |(a, _, c): &(Array1<f64>, Array2<f64>, Array2<f64>)| Step {
        theta: measurable.dot(a),
        covariance: measurable.dot(c).dot(&measurable.t()),
    };
    Some(Followed { steps: measurable_steps.iter().map(step).collect(), z })
}

/// Evidence for a slope over time, standard deviations: of vectors with their information, one for each time.
fn drift(steps: &[(Array1<f64>, Array2<f64>)], time_s: &[f64]) -> f64 {
    let d = steps.first().map_or(0, |(a, _)| a.len());
    let (first, last) = time_s.iter().fold((f64::MAX, f64::MIN), |r, t| (r.0.min(*t), r.1.max(*t)));
    // Level and slope of each direction together.
    let (mut q, mut s, mut square) = (Array2::<f64>::zeros((2 * d, 2 * d)), Array1::<f64>::zeros(2 * d), 0.0);
    for ((a, information), t) in steps.iter().zip(time_s) {
        let score = information.dot(a);
        let terms = [1.0, (2.0 * t - first - last) / (last - first).max(f64::MIN_POSITIVE)];
        for (i, u) in terms.iter().enumerate() {
            s.slice_mut(ndarray::s![i * d..(i + 1) * d]).scaled_add(*u, &score);
            for (j, v) in terms.iter().enumerate() {
                q.slice_mut(ndarray::s![i * d..(i + 1) * d, j * d..(j + 1) * d]).scaled_add(u * v, information);
            }
        }
        square += a.dot(&score);
    }
    let inverse = pseudo_inverse(&q);
    let line = inverse.dot(&s);
    let nu = ((steps.len() as f64 - 2.0) * d as f64).max(1.0);
    let scatter = ((square - s.dot(&line)) / nu).max(1.0);
    let slope = line.slice(ndarray::s![d..]);
    let of_slope = pseudo_inverse(&inverse.slice(ndarray::s![d.., d..]).to_owned());
    let t = slope.dot(&of_slope.dot(&slope)) / scatter;
    sigmas(f_tail(t / d as f64, d as f64, nu))
}

#[cfg(test)]
mod tests {
    use super::*;
    use ommatidia_session::rng::stream;
    use rand_distr::{Distribution, StandardNormal};

    /// Two strengths over eight frames: a slope, noise of their errors, and a scatter from specimen to specimen.
    fn made_up(slope: f64, scatter: f64, seed: u64) -> f64 {
        let mut rng = stream(seed, "curves", 0);
        let mut normal = || -> f64 { StandardNormal.sample(&mut rng) };
        let information = ndarray::arr2(&[[400.0, 100.0], [100.0, 100.0]]);
        let time_s: Vec<f64> = (0..8).map(f64::from).collect();
        let steps: Vec<_> = time_s
            .iter()
            .map(|t| {
                // The inverse Cholesky factor of the information: errors of that covariance.
                let (x, y) = (normal(), normal());
                let error = [x / 20.0 - y * 5.0 / 20.0 / 75f64.sqrt(), y / 75f64.sqrt()];
                let other = scatter * normal();
                (ndarray::arr1(&[1.0 + slope * t + error[0] + other, error[1]]), information.clone())
            })
            .collect();
        drift(&steps, &time_s)
    }

    #[test]
    fn a_slope_is_drift_and_scatter_is_none() {
        let false_alarms = |scatter: f64| (0..200).filter(|seed| made_up(0.0, scatter, *seed) > 2.0).count();
        // Binomial of 200 and 0.046: 9 +- 3. Under scatter the mean square takes the place of the error.
        assert!(false_alarms(0.0) < 20, "{}", false_alarms(0.0));
        assert!(false_alarms(1.0) < 30, "{}", false_alarms(1.0));
        let found = (0..50).filter(|seed| made_up(0.1, 0.0, *seed) > 3.0).count();
        assert!(found > 45, "{found}");
    }
}
