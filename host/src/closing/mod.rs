//! Closing the loop: find the residual between model and measurement, trace it to an effect that the model lacks, add that effect.
//!
//! [`observe`] reads frames and fixes the hold-outs; [`model`] predicts them with effects and nuisances; [`design`] sums what a small
//! change of each value would do; [`score`] tests and ranks.

mod account;
mod bins;
pub mod close;
pub mod covariate;
pub mod design;
pub mod figures;
pub mod file;
pub mod model;
pub mod observe;
pub mod omnibus;
pub mod recalibrate;
pub mod record;
pub mod refit;
mod repeats;
pub mod result;
pub mod retrain;
pub mod score;
pub mod search;
pub mod state;
pub mod stats;
pub mod tables;
pub mod trials;

#[cfg(test)]
mod tests;
