//! Effects that were scored, and effects that were found.

use crate::closing::evidence::{TableFit, Test};
use crate::closing::fit::Term;

/// What one more value must earn in chi-squared.
pub(crate) const PRICE: f64 = 6.0;

/// An effect that was scored.
#[derive(Clone, Debug)]
pub struct Candidate {
    /// The effect at its best start.
    pub term: Term,
    /// Columns of its strengths in the design.
    pub columns: Vec<usize>,
    /// The test of its strengths; None: the session cannot tell it.
    pub test: Option<Test>,
    /// How many independent starts the best was taken from.
    pub chances: f64,
    /// Its table, where it has one instead of columns.
    pub table: Option<TableFit>,
}

impl Candidate {
    /// Probability, paid for each chance.
    pub fn p(&self) -> f64 {
        if let Some(table) = &self.table {
            return table.p;
        }
        self.test.as_ref().map_or(1.0, |t| (t.p * self.chances).min(1.0))
    }

    /// Estimate and standard error of its first strength, as [`crate::effects::Param::inner`] has them.
    pub fn first(&self) -> Option<(f64, f64)> {
        if let Some(table) = &self.table {
            return Some((table.size, table.size_sigma));
        }
        let t = self.test.as_ref()?;
        Some((*t.theta.first()?, t.covariance.get((0, 0))?.sqrt()))
    }

    /// What it earns beyond its price.
    pub(crate) fn worth(&self) -> f64 {
        if let Some(table) = &self.table {
            return table.z * table.z.abs() - PRICE;
        }
        self.test.as_ref().map_or(f64::NEG_INFINITY, |t| t.t - PRICE * t.dof - 2.0 * self.chances.ln())
    }
}

/// An effect that was found.
#[derive(Clone, Debug)]
pub struct Found {
    /// Its id.
    pub id: &'static str,
    /// Strength of the evidence when it was found.
    pub z: f64,
    /// Fall of chi-squared on held-out data when it was added.
    pub held_out_gain: f64,
    /// Effects that would explain nearly the same: id, and the overlap.
    pub ambiguity: Vec<(&'static str, f64)>,
    /// Standard error of the size of its table, where it has one.
    pub table_sigma: Option<f64>,
}
