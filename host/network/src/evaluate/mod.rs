//! Evaluation: methods side by side on scenes of known truth, with time and memory; resolution; receptive fields.

mod arena;
mod compare;
mod field;
pub mod receptive;
pub mod record;
pub mod resolution;
mod resources;
mod scenes;
mod spectrum;

pub use arena::{Arena, Bout, Difference, Entrant};
pub use compare::{Source, judge};
pub use field::{Ring, Rings};
pub use record::{Evaluation, KIND, MethodFigures, Predicted, Summary, VERSION};
pub use resources::{Measured, measured};
pub use scenes::Scenes;
pub use spectrum::{RingSpectrum, Spectra};
