//! Frames of unknown specimens: the object of each frame is one more thing that is fitted.
//!
//! `choose` marks the frames, and of large ones the `region` that is used. `fitted` estimates their specimens under a
//! state: `probe` writes the optics out as a matrix, and `estimate` finds a specimen for each frame (`beside`: roughly,
//! outside of a region), which gives the signatures of the effects. What a change of the specimen can make is then
//! taken out of residuals and signatures (`super::projection`), so that score tests and fits see what no specimen
//! explains. `docs/closing.md` has the equations.

mod beside;
mod choose;
mod estimate;
pub(super) mod fitted;
mod probe;
mod region;
#[cfg(test)]
mod tests;

pub use choose::estimate_specimens;
pub(crate) use choose::{UNKNOWN_NOTE, chosen_notes, estimated_frames};
