//! Stacks of frames, [frames, rows, cols], read and written one frame at a time: .npy, multi-page .tif, .avi and .mat
//! files, folders of numbered .avi or .tif files, and folders of Zarr.
//!
//! ```
//! # fn main() -> Result<(), Box<dyn std::error::Error>> {
//! use ndarray::Array3;
//! use ommatidia_session::stack::{self, FrameReader};
//! let folder = tempfile::tempdir()?;
//! let path = folder.path().join("scene.npy");
//! // Two frames of 3 x 4 pixels; frame f is f everywhere.
//! stack::write(&path, Array3::from_shape_fn((2, 3, 4), |(f, _, _)| f as f32).view())?;
//!
//! let mut frames = FrameReader::open(&path)?;
//! assert_eq!((frames.len(), frames.rows(), frames.cols()), (2, 3, 4));
//! assert_eq!(frames.read(1)?.sum(), 12.0);
//! assert!(frames.read(2).is_err());
//! # Ok(())
//! # }
//! ```

mod announced;
mod avi;
mod chunks;
mod codec;
mod layout;
mod mat;
mod names;
mod npy;
mod npy_header;
mod number;
mod ome;
mod reader;
mod recording;
mod series;
mod tif;
mod video;
mod whole;
mod writer;
mod zarr;

pub(crate) use avi::DECODED_FROM;
pub use layout::{SampleType, StackScale, StackSpec};
pub use reader::{ComputedFrames, FrameReader};
pub use recording::Recording;
pub use series::{Part, folder_of_recording};
pub use whole::{read, write};
pub use writer::FrameWriter;
pub use zarr::is_zarr;

/// Name of the file by which a folder written as .zarr is recognised.
pub const ZARR_METADATA: &str = zarr::METADATA;
