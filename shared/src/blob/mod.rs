//! The network file: magic, version, schema key, postcard header, aligned little-endian weight sections, CRC.
//!
//! | offset | bytes | what |
//! |---|---|---|
//! | 0 | 8 | magic `OMMATIDI` |
//! | 8 | 2 | version of this layout, [`VERSION`] |
//! | 10 | 2 | 0 |
//! | 12 | 4 | length H of the header, bytes |
//! | 16 | 8 | schema key: FNV-1a over the names and types of all header fields, [`SCHEMA_KEY`] |
//! | 24 | 4 | length of the whole file, bytes |
//! | 28 | 4 | 0 |
//! | 32 | H | [`Header`], postcard |
//! | - | | the sections of [`Weights`], each from the next multiple of [`ALIGN`], the gaps zero |
//! | - | 4 | CRC-32 (ISO-HDLC) of all that stands before it |
//!
//! All numbers are little-endian. [`Network::decode`] borrows: the weights are used where the file lies, so the
//! file must begin at a multiple of [`ALIGN`].

mod check;
mod decode;
mod encode;
mod error;
mod header;
mod layout;

pub use decode::{Network, Verified};
pub use encode::{encode, encoded_len};
pub use error::{BlobError, Section};
pub use header::{
    Bank, Blocks, Header, HeaderField, MAX_TAPS, MemoryPlan, Rcan, SectionLens, Sensor, Size, Tap, Weights,
};
pub(crate) use layout::CRC;
pub use layout::{ALIGN, MAGIC, SCHEMA_KEY, VERSION};

#[cfg(test)]
mod tests;
