//! The plan, as files, reports and other programs read it.

use serde::{Deserialize, Serialize};

/// Which measurements would separate the candidates of a session.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Plan {
    /// Candidates count as separated from so many standard deviations on.
    pub enough_sigma: f64,
    /// What is to be separated or made testable.
    pub goals: Vec<Goal>,
    /// Measurements in the order in which they are advised; empty: none of the catalogue helps, or none is needed.
    pub measurements: Vec<Advice>,
    /// What the expectations rest on.
    pub assumptions: Vec<String>,
}

/// Two candidates to be separated, or one effect to be made testable.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Goal {
    /// The effect.
    pub id: String,
    /// The effect that it may be confused with; None: it is not testable now.
    pub other: Option<String>,
    /// Its first strength.
    pub param: String,
    /// The value that is assumed: as found, or ten steps where it is not testable.
    pub strength: f64,
    /// Unit of the strength.
    pub unit: String,
    /// Standard deviations of the separation, or of the effect from absence, in this session.
    pub sigmas_now: f64,
}

/// A measurement that is advised.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Advice {
    /// Its id.
    pub id: String,
    /// What to measure.
    pub words: String,
    /// For each goal the expected standard deviations with this measurement and all before it.
    pub sigmas: Vec<f64>,
}

impl Plan {
    /// Index of the first measurement with which a goal is reached; None: it is reached now, or by none.
    pub fn reached_by(&self, goal: usize) -> Option<usize> {
        let reached = |z: &f64| *z >= self.enough_sigma;
        if self.goals.get(goal).is_none_or(|g| reached(&g.sigmas_now)) {
            return None;
        }
        self.measurements.iter().position(|m| m.sigmas.get(goal).is_some_and(reached))
    }
}

impl Goal {
    /// What is asked, in words.
    pub fn words(&self) -> String {
        match &self.other {
            Some(other) => format!("{} or {other}", self.id),
            None => self.id.clone(),
        }
    }
}
