//! What a change of the specimen can make, taken out of frames.
//!
//! The optics are a matrix (`views`), the `projector` takes out what it can make of any object, and a state holds both
//! with the estimated specimens (`held`). `docs/closing.md` has the equations.

mod held;
mod normal;
mod projector;
mod views;

pub(super) use held::Sigmas;
pub use held::Specimens;
pub(super) use projector::Projector;
pub(super) use views::{LANES, Views};
