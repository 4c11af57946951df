//! The measured session: one folder of frames with a manifest, the contract between a bench and these tools.

mod manifest;

pub use manifest::{ArrayGeometry, Manifest, ObjectGrid, Optics, Role, SensorSpec, StackEntry};
