//! What a change of the specimen can make, taken out of frames.
//!
//! `footprint` says which pixels see which. The optics are a matrix (`views`, with its `products`), the `projector`
//! takes out what it can make of any object, and a state holds both with the estimated specimens (`held`).
//! `docs/closing.md` has the equations.

mod footprint;
mod held;
mod normal;
mod products;
mod projector;
mod views;

pub(super) use footprint::{CORE, Footprint};
pub(super) use held::Sigmas;
pub use held::Specimens;
pub(super) use products::LANES;
pub(super) use projector::{Projector, Projectors};
pub(super) use views::{MERGED, Views};
