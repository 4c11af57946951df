//! The measured session: one folder of frames with a manifest, the contract between a bench and these tools.
//!
//! [`Session::open`] checks all of it; [`stack`] reads and writes frames one at a time; [`SessionWriter`] makes one.

mod cut;
mod error;
mod manifest;
mod open;
pub mod stack;
mod table;
#[cfg(test)]
mod tests;
mod validate;
mod write;

pub use cut::Cut;
pub use error::SessionError;
pub use manifest::{ArrayGeometry, Manifest, ObjectGrid, Optics, Role, SensorSpec, StackEntry};
pub use open::{MANIFEST, Session, Stack, TruthReader};
pub use stack::{FrameReader, FrameSource, FrameWriter, Recording, SampleType, StackSpec};
pub use table::FrameInfo;
pub use write::{Existing, SessionWriter};
