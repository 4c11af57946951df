//! Directions of an effect's values that a change of the specimens makes as well.
//!
//! With B the Gram matrix of the signatures of an effect's values, and Q that of what the projection off the specimens
//! leaves of them, the directions v with
//! ```text
//! Q v = g B v,   v' B v = 1
//! ```
//! keep the share g of their squared norm. A direction that keeps less than [`GAUGE`] is a gauge: no data say how far
//! the values lie along it. So no score holds it and no fit moves along it, though the other directions of the same
//! effect are measured: displacements of single lenses, where one that all lenses share is a displacement of the
//! specimen.

use super::design::Design;
use super::model::Model;
use super::solve::pseudo_inverse;
use super::state::{Column, State};
use ndarray::{Array1, Array2, Axis};
use ommatidia_physics::linalg::{SymmetricEigen, symmetric_eigen};

/// A change of the specimen makes a direction if it leaves less than this share of its squared norm: estimates of the
/// specimen and the calibration are not good enough for what remains.
pub(crate) const GAUGE: f64 = 1e-3;
/// Directions whose signatures depend on those of others to this share are left out, since f32 sums round.
const ROUNDING: f64 = 3e-6;
/// How stiff a fit is along a gauge, in units of B.
const STIFF: f64 = 1e3;
/// Steps of the search for the values that are zero for most lenses.
const STEPS: usize = 60;

/// The directions of some values, each a column.
pub(crate) struct Directions {
    /// Those that data measure.
    pub(crate) measurable: Array2<f64>,
    /// The others.
    pub(crate) gauges: Array2<f64>,
}

/// Splits the directions of values by what is left of them: `q` of `before`, both [n, n].
pub(crate) fn directions(q: &Array2<f64>, before: &Array2<f64>) -> Directions {
    let n = q.nrows();
    let none = Directions { measurable: Array2::zeros((n, 0)), gauges: Array2::zeros((n, 0)) };
    let scale = before.diag().mapv(|v| if v > 0.0 { 1.0 / v.sqrt() } else { 0.0 });
    let scaled = |m: &Array2<f64>| Array2::from_shape_fn((n, n), |(i, j)| m[[i, j]] * scale[i] * scale[j]);
    let Ok(SymmetricEigen { values, vectors }) = symmetric_eigen(&scaled(before)) else { return none };
    let used: Vec<usize> = (0..n).filter(|i| values[*i] > ROUNDING).collect();
    let mut whitened = vectors.select(Axis(1), &used);
    for (mut v, i) in whitened.axis_iter_mut(Axis(1)).zip(&used) {
        v /= values[*i].sqrt();
    }
    let Ok(SymmetricEigen { values, vectors }) = symmetric_eigen(&whitened.t().dot(&scaled(q)).dot(&whitened)) else {
        return none;
    };
    let mut all = whitened.dot(&vectors);
    for (mut row, s) in all.outer_iter_mut().zip(&scale) {
        row *= *s;
    }
    let (measurable, gauges): (Vec<usize>, Vec<usize>) = (0..used.len()).partition(|i| values[*i] >= GAUGE);
    Directions { measurable: all.select(Axis(1), &measurable), gauges: all.select(Axis(1), &gauges) }
}

/// The gauges of a term of a state.
#[derive(Clone, Debug)]
pub struct Gauge {
    /// Index of the term.
    pub(crate) term: usize,
    /// Columns of its values in the design.
    columns: Vec<usize>,
    /// Each column is a direction, [values, directions].
    pub(crate) directions: Array2<f64>,
    /// B times the directions, [values, directions].
    weighted: Array2<f64>,
}

impl Gauge {
    /// Makes a Hessian of all columns stiff along the gauge.
    pub(crate) fn stiffen(&self, hessian: &mut Array2<f64>) {
        let own = self.weighted.dot(&self.weighted.t()) * STIFF;
        for (i, a) in self.columns.iter().enumerate() {
            for (j, b) in self.columns.iter().enumerate() {
                hessian[[*a, *b]] += own[[i, j]];
            }
        }
    }

    /// Moves the values of its term along the gauge to where most of them are absent: the sum of their absolute values
    /// is the least. Of all accounts that the data cannot tell apart this is the one where the fewest lenses have
    /// changed.
    pub(crate) fn simplify(&self, model: &Model<'_>, state: &mut State) {
        let Some(term) = state.terms.get_mut(self.term) else { return };
        let (free, expanded) = (term.free(model.lenses()), term.expanded(model.lenses()));
        if !free.iter().any(|i| expanded[*i].1.per_lens) {
            return;
        }
        let per_step = |i: usize| 1.0 / expanded[i].1.inner(expanded[i].1.step).abs().max(f64::MIN_POSITIVE);
        let apart = |i: usize| expanded[i].1.inner(term.params[i]) - expanded[i].1.inner(expanded[i].1.off);
        let values = Array1::from_iter(free.iter().map(|i| apart(*i) * per_step(*i)));
        let mut along = self.directions.clone();
        for (mut row, i) in along.outer_iter_mut().zip(&free) {
            row *= per_step(*i);
        }
        let simple = fewest(&values, &along);
        for (i, v) in free.iter().zip(simple) {
            let p = expanded[*i].1;
            term.params[*i] = p.outer(p.inner(p.off) + v / per_step(*i));
        }
    }
}

/// `values - along a` with the least sum of absolute values, by iteratively reweighted least squares.
fn fewest(values: &Array1<f64>, along: &Array2<f64>) -> Array1<f64> {
    let largest = values.iter().fold(0.0f64, |m, v| m.max(v.abs()));
    let mut rest = values.clone();
    for step in 0..STEPS {
        // The corner of the absolute value becomes sharper from step to step.
        let corner = (largest * 0.7f64.powi(step as i32)).max(1e-6 * largest).max(f64::MIN_POSITIVE);
        let weight = rest.mapv(|r: f64| 1.0 / r.abs().max(corner));
        let weighted = along * &weight.insert_axis(Axis(1));
        let a = pseudo_inverse(&weighted.t().dot(along)).dot(&weighted.t().dot(values));
        rest = values - &along.dot(&a);
    }
    rest
}

/// The gauges of all terms of a state, from a design with their columns; none without estimated specimens.
pub(crate) fn gauges(design: &Design, gram: &Array2<f64>) -> Vec<Gauge> {
    if !design.estimated {
        return Vec::new();
    }
    let term_of = |c: &Column| match c {
        Column::Own { term, .. } => Some(*term),
        _ => None,
    };
    let all = || 0..design.columns.len();
    let given: Vec<usize> = all().filter(|i| term_of(&design.columns[*i]).is_none()).collect();
    let pick = |m: &Array2<f64>, r: &[usize], c: &[usize]| m.select(Axis(0), r).select(Axis(1), c);
    let inverse = pseudo_inverse(&pick(gram, &given, &given));
    let terms: std::collections::BTreeSet<usize> = design.columns.iter().filter_map(term_of).collect();
    let of = |term: usize| {
        let columns: Vec<usize> = all().filter(|i| term_of(&design.columns[*i]) == Some(term)).collect();
        let (across, before) = (pick(gram, &columns, &given), pick(&design.before, &columns, &columns));
        let q = pick(gram, &columns, &columns) - across.dot(&inverse).dot(&across.t());
        let directions = directions(&q, &before).gauges;
        let weighted = before.dot(&directions);
        (directions.ncols() > 0).then_some(Gauge { term, columns, directions, weighted })
    };
    terms.into_iter().filter_map(of).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use ndarray::{arr1, arr2};

    #[test]
    fn a_direction_that_the_specimen_makes_is_a_gauge_and_the_others_are_told() {
        // Three lenses of unlike light; what all three share is left to a part of 1e-5.
        let before = Array2::from_diag(&arr1(&[4.0, 1.0, 9.0]));
        let common = arr1(&[1.0, 1.0, 1.0]);
        let image = before.dot(&common);
        let norm = common.dot(&image);
        let outer = Array2::from_shape_fn((3, 3), |(i, j)| image[i] * image[j] / norm);
        let q = &before - &(outer * (1.0 - 1e-5));
        let Directions { measurable, gauges } = directions(&q, &before);
        assert_eq!((measurable.ncols(), gauges.ncols()), (2, 1));
        let v = gauges.column(0);
        assert!((v[0] - v[1]).abs() < 1e-6 && (v[0] - v[2]).abs() < 1e-6 && v[0].abs() > 0.1, "{v}");
        assert!(measurable.t().dot(&before).dot(&gauges).iter().all(|x| x.abs() < 1e-6));
        assert_eq!(directions(&before, &before).gauges.ncols(), 0);
    }

    #[test]
    fn of_all_equal_accounts_the_one_with_the_fewest_lenses_is_taken() {
        // Two of seven lenses moved along rows, one along columns; a common displacement was added.
        let truth = arr1(&[0.0, 0.3, 0.0, -0.2, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.1, 0.0]);
        let along = arr2(&std::array::from_fn::<[f64; 2], 14, _>(|i| if i < 7 { [0.6, 0.1] } else { [-0.1, 0.5] }));
        let seen = &truth + &along.dot(&arr1(&[0.2, -0.3]));
        let found = fewest(&seen, &along);
        assert!((&found - &truth).iter().all(|d| d.abs() < 1e-3), "{found}");
        assert_eq!(fewest(&truth, &Array2::zeros((14, 0))), truth);
    }
}
