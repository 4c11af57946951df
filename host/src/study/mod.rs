//! How far the loop can be trusted: many sessions of the virtual instrument with something in them that is not declared, each closed,
//! and what was found held against what was there.
//!
//! [`plan`] lists the cases, [`subject`] is one instrument under study, [`trial`] runs a case, [`record`] keeps its outcome, one line a
//! session, so that a killed study goes on; [`summary`] makes the figures and [`text`] the page. [`downstream`] asks what it is worth to the picture. [`foreign`] holds effects that the
//! catalogue must not know.

pub mod downstream;
pub mod foreign;
pub mod plan;
pub mod record;
pub mod run;
pub mod sensitivity;
pub mod subject;
pub mod summary;
pub mod text;
pub mod trial;

#[cfg(test)]
mod tests;
