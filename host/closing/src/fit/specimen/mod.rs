//! Frames of unknown specimens: the object of each frame is one more thing that is fitted.
//!
//! `choose` marks the frames. `fitted` estimates their specimens under a state: the optics are written out as a matrix
//! (`views`, by `probe`), `estimate` finds a specimen for each frame, which gives the signatures of the effects, and
//! `projector` takes out of residuals and signatures what a change of the specimen can make, so that score tests and
//! fits see what no specimen explains. A state keeps the result (`held`). `docs/closing.md` has the equations.

mod choose;
mod estimate;
pub(super) mod fitted;
pub(super) mod held;
mod probe;
mod projector;
#[cfg(test)]
mod tests;
mod views;

pub(crate) use choose::UNKNOWN_NOTE;
pub use choose::estimate_specimens;
pub use held::Specimens;
