//! Artifacts: the files that one verb writes and another reads.
//!
//! Instruments, data-set shards, checkpoints and evaluations share one format: a safetensors file. Its metadata hold a
//! JSON [`Header`] (kind, version, provenance, and a small body that depends on the kind); its tensors are the arrays,
//! float32 in C order. Python reads it with `safetensors.numpy.load_file`. Files appear complete or not at all.
//!
//! ```
//! # fn main() -> Result<(), Box<dyn std::error::Error>> {
//! use ndarray::arr2;
//! use ommatidia_session::artifact::{self, Header, Index, Provenance, Tensors};
//! let folder = tempfile::tempdir()?;
//! let path = folder.path().join("table.safetensors");
//! let provenance = Provenance::new("example", 7, &());
//! let header = Header { kind: "table".into(), version: 1, provenance, body: "two rows".to_string() };
//! let mut tensors = Tensors::from([("rows".to_string(), arr2(&[[1.0f32, 2.0], [3.0, 4.0]]).into_dyn())]);
//! artifact::write(&path, &header, &tensors)?;
//!
//! // The whole file at once ...
//! let (read, arrays) = artifact::read::<String>(&path, "table", 1)?;
//! assert_eq!((read.body.as_str(), read.provenance.seed), ("two rows", 7));
//! assert_eq!(arrays, tensors);
//! // ... or one entry along the first axis of one tensor.
//! let index = Index::<String>::open(&path, "table", 1)?;
//! assert_eq!(index.read_entry("rows", 1)?.into_raw_vec_and_offset().0, [3.0, 4.0]);
//! // Another kind or version is an error.
//! assert!(artifact::read::<String>(&path, "instrument", 1).is_err());
//! // Reading code takes each tensor with the shape that it expects; `None` stands for any length.
//! assert_eq!(artifact::take(&path, &mut tensors, "rows", &[None, Some(2)])?.len(), 4);
//! # Ok(())
//! # }
//! ```

mod error;
mod hash;
mod header;
mod place;
mod read;
mod write;

pub use error::ArtifactError;
pub use hash::{file_hash, state_of_files};
pub use header::{Header, Provenance, Tensors};
pub use place::{folder_of, remove_leftovers, replace_folder, temporary_beside, temporary_folder_beside};
pub(crate) use read::find_header;
pub use read::{Index, inspect, read, shapes, take};
pub use write::{write, write_tensors, write_whole};
