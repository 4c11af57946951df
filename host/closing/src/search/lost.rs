//! Effects that cannot be tested beside truths of uncertain place.
//!
//! A misplaced truth displaces every image. With the registration free, the data no longer determine an effect that
//! displaces them alike; all that is left to know of it is what the session states of its truths. Such an effect is not
//! searched for, however narrow the statement is: its estimate would be an estimate of the registration.

use super::trials::{Tried, evidence};
use crate::evidence::Scores;
use crate::fit::prior::is_prior;
use crate::fit::{Column, Design, Errors, Fitted, Model, Scope, Term, fitted_columns, pseudo_inverse};
use ndarray::{Array1, Array2, s};
use ommatidia_model::forward::ForwardError;
use ommatidia_physics::effects::Stage;
use ommatidia_physics::linalg::symmetric_eigen;

/// A combination of strengths counts as determined if a free registration leaves at least this share of the information
/// on it. Errors of derivatives reach a hundredth of this.
const LEFT: f64 = 1e-3;

/// The effect on the recorded positions of sources. Truths are such records, so that it is their registration with a
/// skew beside it.
const RECORDED: &str = "stage_scale";

/// Ids of the effects of the catalogue of which the registration takes half of the directions or more, at each of their
/// starting values, and with them the first strength, for which an effect is named: a rotation stays, whatever point it
/// is about. The effect on recorded positions is always one of them. Empty where the truths are exact.
///
/// # Errors
/// An object holds negative or non-finite light.
pub(crate) fn lost(model: &Model<'_>, now: &Fitted) -> Result<Vec<&'static str>, ForwardError> {
    if model.seen.registrations.iter().all(|g| g.sigma_px == 0.0) {
        return Ok(Vec::new());
    }
    let moves = |t: &Term| matches!(t.effect.descriptor().stage, Stage::Object | Stage::Geometry | Stage::Lens);
    let mut terms = Tried::Catalogue.terms(model, &now.state, &evidence(model, now));
    terms.retain(|t| moves(t) && !t.is_far(model.lenses()));
    let mut columns: Vec<Column> = fitted_columns(model, &now.state);
    let given = columns.len();
    let mut groups = Vec::new();
    for (t, term) in terms.iter().enumerate() {
        let first = columns.len();
        columns.extend(term.strengths(model.lenses()).into_iter().map(|param| Column::Trial { term: t, param }));
        groups.push(first..columns.len());
    }
    let scope = Scope::Scores { given, groups: &groups };
    let design = Design::compute(model, now.expansion(&terms), columns.clone(), &Errors::default(), scope)?;
    let mut of_data = design.clone();
    of_data.cells.retain(|cell| !is_prior(model, cell));
    let registers = |i: &usize| matches!(columns[*i], Column::Registration(..));
    let exact = Scores::new(&of_data, (0..given).filter(|i| !registers(i)).collect());
    let free = Scores::new(&of_data, (0..given).collect());
    let mut testable = Vec::new();
    for (term, group) in terms.iter().zip(groups) {
        let columns: Vec<usize> = group.collect();
        let [exact, free] = [exact.information(&columns), free.information(&columns)];
        if kept(&exact, &free).is_none_or(|[kept, all]| 2 * kept > all) || first_is_kept(&exact, &free) {
            testable.push(term.id());
        }
    }
    let mut lost: Vec<&str> =
        terms.iter().map(Term::id).filter(|id| !testable.contains(id) || *id == RECORDED).collect();
    lost.dedup();
    Ok(lost)
}

/// In how many independent directions an effect stays determined, of those with any information: eigenvalues of its
/// information beside a free registration relative to that beside exact truths, both [n, n]. None: no information.
fn kept(exact: &Array2<f64>, free: &Array2<f64>) -> Option<[usize; 2]> {
    let n = exact.nrows();
    let scale = exact.diag().mapv(|v| if v > 0.0 { 1.0 / v.sqrt() } else { 0.0 });
    let scaled = |a: &Array2<f64>| Array2::from_shape_fn((n, n), |(i, j)| a[[i, j]] * scale[i] * scale[j]);
    let eigen = symmetric_eigen(&scaled(exact)).ok()?;
    // As in `pseudo_inverse`.
    let seen: Vec<usize> = (0..n).filter(|i| eigen.values[*i] > 3e-6).collect();
    // Directions with unit information.
    let unit =
        Array2::from_shape_fn((n, seen.len()), |(i, j)| eigen.vectors[[i, seen[j]]] / eigen.values[seen[j]].sqrt());
    let shares = symmetric_eigen(&unit.t().dot(&scaled(free)).dot(&unit)).ok()?;
    let kept = shares.values.iter().filter(|share| **share > LEFT).count();
    (!seen.is_empty()).then_some([kept, seen.len()])
}

/// Whether the first strength stays determined beside the others: its information beside a free registration is more
/// than [`LEFT`] of that beside exact truths, both [n, n].
fn first_is_kept(exact: &Array2<f64>, free: &Array2<f64>) -> bool {
    let alone = |a: &Array2<f64>| {
        if a.nrows() < 2 {
            return a[[0, 0]];
        }
        let others = pseudo_inverse(&a.slice(s![1.., 1..]).to_owned());
        let with: Array1<f64> = a.row(0).iter().skip(1).copied().collect();
        a[[0, 0]] - with.dot(&others.dot(&with))
    };
    !exact.is_empty() && alone(free) > LEFT * alone(exact)
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;
    use ndarray::arr2;

    #[test]
    fn a_direction_whose_information_is_gone_is_lost() {
        let exact = arr2(&[[4.0, 1.0], [1.0, 9.0]]);
        assert_eq!(kept(&exact, &exact).unwrap(), [2, 2]);
        assert_eq!(kept(&exact, &(0.1 * &exact)).unwrap(), [2, 2]);
        // Only the sum of both strengths is left.
        assert_eq!(kept(&exact, &arr2(&[[0.9, 0.9], [0.9, 0.9]])).unwrap(), [1, 2]);
        assert_eq!(kept(&exact, &(1e-4 * &exact)).unwrap(), [0, 2]);
        assert!(kept(&Array2::zeros((1, 1)), &Array2::zeros((1, 1))).is_none());
    }

    #[test]
    fn an_angle_is_kept_where_only_its_pivot_is_lost() {
        let exact = arr2(&[[4.0, 0.5, 0.2], [0.5, 9.0, 0.0], [0.2, 0.0, 9.0]]);
        let pivot_lost = arr2(&[[3.0, 0.0, 0.0], [0.0, 1e-6, 0.0], [0.0, 0.0, 1e-6]]);
        assert!(first_is_kept(&exact, &exact) && first_is_kept(&exact, &pivot_lost));
        assert!(!first_is_kept(&exact, &(1e-4 * &exact)));
        assert!(first_is_kept(&arr2(&[[2.0]]), &arr2(&[[1.0]])) && !first_is_kept(&arr2(&[[2.0]]), &arr2(&[[0.0]])));
    }
}
