//! Stacks as OME-Zarr: written as version 0.5, read as 0.4 and 0.5; plain Zarr arrays [frames, rows, cols] are read,
//! too.

mod array;
mod image;
mod json;
mod read;
mod write;

pub(super) use json::METADATA;
pub(super) use read::ZarrSource;
pub use read::is_zarr;
pub(super) use write::ZarrWriter;
