//! Closing the loop: measure the residual between model and measurement, find the effect that the model lacks, add it.
//!
//! The folders follow the data, and none imports a later one:
//!
//! | folder | what it does |
//! |---|---|
//! | [`data`] | reads the frames of a session and fixes the hold-outs before any fit |
//! | [`fit`] | predicts the frames from a state (effects and nuisance parameters) and fits that state |
//! | [`evidence`] | tests the residual of a fit: omnibus tests, score tests, pixel tables, figures on held-out data |
//! | [`search`] | adds effects that the evidence supports and removes those that are not needed |
//! | [`account`] | reports what was found, with errors, detection limits and ambiguities |
//!
//! [`close()`] runs all of it on observations in memory, [`close_session`] on files.

pub mod account;
mod close;
pub mod data;
pub mod evidence;
mod files;
pub mod fit;
pub mod search;

pub use account::{Account, Closed, Closing, Effect, Rejected, Retrain, RetrainRequest, Retrained, Value};
pub use close::{CloseError, CloseOptions, check_layout, close, residual};
pub use data::{Budget, Fault, FaultKind, Observations};
pub use evidence::{Covariate, Dependence, Figures};
pub use files::{
    CloseOutcome, CloseRequest, FineTuning, Progress, ResidualOutcome, ResidualRequest, account_path, close_session,
    residual_session,
};

#[cfg(test)]
mod tests;
