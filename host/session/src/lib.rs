//! The measured session: one folder of frames with a manifest. It is the contract between a bench and these tools.
//!
//! [`Session::open`] checks the whole folder, [`SessionWriter`] writes one, and [`stack`] reads and writes the frames
//! of a single file. The format is described in `docs/session-format.md`.
//!
//! ```
//! # fn main() -> Result<(), Box<dyn std::error::Error>> {
//! use ndarray::Array2;
//! use ommatidia_session::*;
//! let folder = tempfile::tempdir()?;
//! let path = folder.path().join("session");
//! let manifest = Manifest {
//!     format: 1,
//!     name: "example".into(),
//!     sensor: SensorSpec { rows: 4, cols: 5, pixel_pitch_um: 2.0, bit_depth: 12 },
//!     array: ArrayGeometry::grid(1, 1, 0.0),
//!     optics: Optics { magnification: 0.5, psf_window_px: 3, wavelength_um: None },
//!     object: ObjectGrid { rows: 4, cols: 4, pixel_um: 4.0 },
//!     stacks: Vec::new(),
//! };
//! // Two dark frames of 4 x 5 pixels at 64 DN.
//! let mut writer = SessionWriter::create(&path, &manifest, Existing::Keep)?;
//! let spec = StackSpec { frames: 2, rows: 4, cols: 5, samples: SampleType::U16, pixel_um: Some(2.0) };
//! let mut frames = writer.frames("dark.npy", spec)?;
//! for _ in 0..2 {
//!     frames.push(Array2::from_elem((4, 5), 64.0).view())?;
//! }
//! frames.finish()?;
//! writer.add(StackEntry::plain(Role::Dark, "dark.npy", 10.0));
//! writer.finish()?;
//!
//! let session = Session::open(&path)?;
//! assert_eq!(session.manifest().sensor.saturation_dn(), 4095.0);
//! let dark = session.need(Role::Dark)?[0];
//! assert_eq!((dark.len(), dark.info()[1].exposure_ms), (2, 10.0));
//! assert_eq!(dark.frames()?.read(1)?.mean(), Some(64.0));
//! // There are no beads in this session: the error states that, and the remedy.
//! assert!(session.need(Role::Bead).unwrap_err().to_string().contains("role = \"bead\""));
//! # Ok(())
//! # }
//! ```

pub mod artifact;
mod cut;
mod error;
mod ffmpeg;
pub mod files;
pub mod import;
pub mod kind;
mod lock;
mod manifest;
mod numbers;
mod open;
mod remedy;
pub mod rng;
mod signature;
mod space;
pub mod stack;
mod table;
#[cfg(test)]
mod tests;
mod validate;
mod write;

pub use cut::Cut;
pub use error::SessionError;
pub use manifest::{ArrayGeometry, MANIFEST, Manifest, ObjectGrid, Optics, Role, SensorSpec, StackEntry};
pub use numbers::{fixed, trimmed, with_error, with_error_signed};
pub use open::{ComputedStack, Session, Stack, TruthReader};
pub use remedy::{causes, remedy};
pub use space::{need_file_size, need_space};
pub use stack::{ComputedFrames, FrameReader, FrameWriter, Part, Recording, SampleType, StackScale, StackSpec};
pub use table::FrameInfo;
pub use write::{Existing, SessionWriter};
