//! Fisher information of several measurements about the same effects.
//!
//! Each measurement has its own design. Columns with the same meaning (an effect, the black level) are one column of
//! the whole; the light of a stack belongs to that stack alone.

use crate::evidence::Scores;
use crate::fit::{Cell, Column, Design, pseudo_inverse};
use ndarray::{Array1, Array2};

/// What one measurement shows: the Gram matrix of its columns and of the errors of the calibration.
#[derive(Clone, Debug)]
pub(crate) struct Information {
    columns: Vec<Column>,
    /// Directions of the errors of the calibration: by scatter, and stated.
    errors: [usize; 2],
    /// [columns + errors, columns + errors].
    gram: Array2<f64>,
    /// Whether it is a session of its own, closed by itself.
    pub(crate) alone: bool,
}

impl Information {
    /// That of the training cells of a design, as if measured `times` times.
    pub(crate) fn of(design: &Design, times: f64) -> Self {
        let n = design.residual();
        let gram = design.training().gram.slice(ndarray::s![..n, ..n]).mapv(|v| times * v);
        Self { columns: design.columns.clone(), errors: [design.scattered, design.stated], gram, alone: false }
    }

    /// Standard deviations of the strengths `theta` of columns `mine` from absence, with `beside` and everything else
    /// that is not a trial projected out, by all of `parts` together; 0 where they do not determine them.
    pub(crate) fn sigmas(parts: &[&Self], mine: &[Column], theta: &[f64], beside: &[Column]) -> f64 {
        let whole = joined(parts);
        let at = |c: &Column| whole.columns.iter().position(|own| own == c);
        let Some(own) = mine.iter().map(at).collect::<Option<Vec<usize>>>() else { return 0.0 };
        let free = |c: &Column| !matches!(c, Column::Trial { .. }) || beside.contains(c);
        let given = (0..whole.columns.len()).filter(|i| !own.contains(i) && free(&whole.columns[*i])).collect();
        let Some(test) = Scores::new(&whole, given).test(&own) else { return 0.0 };
        let theta = Array1::from_vec(theta.to_vec());
        // Directions that are not determined have no error, and no information.
        theta.dot(&pseudo_inverse(&test.covariance).dot(&theta)).max(0.0).sqrt()
    }
}

/// One design with the sums of all parts.
fn joined(parts: &[&Information]) -> Design {
    let mut columns: Vec<Column> = Vec::new();
    for c in parts.iter().flat_map(|p| &p.columns) {
        if !columns.contains(c) {
            columns.push(c.clone());
        }
    }
    // All parts have the errors of one calibration.
    let [scattered, stated] = [0, 1].map(|i| parts.iter().map(|p| p.errors[i]).max().unwrap_or(0));
    let n = columns.len() + scattered + stated + 1;
    let mut gram = Array2::<f64>::zeros((n, n));
    for part in parts {
        let of_columns = part.columns.iter().map(|c| columns.iter().position(|own| own == c).unwrap_or(0));
        let first = columns.len();
        let of_errors = (0..part.errors[0]).chain((0..part.errors[1]).map(|j| scattered + j)).map(|j| first + j);
        let to: Vec<usize> = of_columns.chain(of_errors).collect();
        for ((i, j), v) in part.gram.indexed_iter() {
            gram[[to[i], to[j]]] += v;
        }
    }
    let gram = gram.mapv(|v| v as f32);
    let cell = Cell { frame: 0, block: 0, held_out: false, pixels: 0.0, gram, log_variance: 0.0 };
    let before = Array2::zeros((columns.len(), columns.len()));
    Design { columns, scattered, stated, cells: vec![cell], before, estimated: false }
}

#[cfg(test)]
mod tests {
    use super::*;
    use ndarray::arr2;

    #[test]
    fn two_measurements_separate_what_neither_does() {
        // Each sees one combination of two effects, a + b or a - b, with unit errors.
        let trial = |term| Column::Trial { term, param: 0 };
        let part = |sign: f64| Information {
            columns: vec![Column::Black, trial(0), trial(1)],
            errors: [0, 0],
            gram: arr2(&[[1.0, 0.0, 0.0], [0.0, 1.0, sign], [0.0, sign, 1.0]]),
            alone: false,
        };
        let (sum, difference) = (part(1.0), part(-1.0));
        let z = |parts: &[&Information]| Information::sigmas(parts, &[trial(0)], &[3.0], &[trial(1)]);
        assert!(z(&[&sum]) < 1e-3 && z(&[&difference]) < 1e-3);
        // a is half the sum of both observations: its error is sqrt(2) / 2.
        assert!((z(&[&sum, &difference]) - 3.0 * 2f64.sqrt()).abs() < 1e-5);
        // Without the alternative each of them gives 3, both together 3 sqrt(2).
        assert!((Information::sigmas(&[&sum], &[trial(0)], &[3.0], &[]) - 3.0).abs() < 1e-5);
    }
}
