//! The network file: magic, version, schema key, postcard header, aligned little-endian weight sections, CRC.
//!
//! | offset | bytes | what |
//! |---|---|---|
//! | 0 | 8 | magic `OMMATIDI` |
//! | 8 | 2 | version of this layout, [`VERSION`] |
//! | 10 | 2 | 0 |
//! | 12 | 4 | length H of the header, bytes |
//! | 16 | 8 | schema key: FNV-1a hash of the names and types of all header fields, [`SCHEMA_KEY`] |
//! | 24 | 4 | length of the whole file, bytes |
//! | 28 | 4 | 0 |
//! | 32 | H | [`Header`], postcard |
//! | - | | the sections of [`Weights`], each at the next multiple of [`ALIGN`]; gaps are zero |
//! | - | 4 | CRC-32 (ISO-HDLC) of all bytes before it |
//!
//! All numbers are little-endian. [`Network::decode`] borrows: the weights are read in place, so the file must lie at
//! an address that is a multiple of [`ALIGN`]. Files of version 2, which had no networks in integers, of
//! version 3, whose features had 16 bits, of version 4, which had one pass, and of version 5, which had no watch on the
//! optics, are read as well.
//!
//! ```
//! use ommatidia_shared::blob::{Bank, Header, MemoryPlan, Rcan, Sensor, Size, Tap};
//! use ommatidia_shared::blob::{BlobError, Network, Verified, Weights, encode, encoded_len};
//! use ommatidia_shared::num::f16;
//!
//! // One filter of 8 x 8 pixels and an enhancement network of one feature.
//! let taps = [Tap { channel: 0, dy: 0, dx: 0 }].into_iter().collect();
//! let header = Header {
//!     name: "example".try_into().unwrap(),
//!     checkpoint: "0123456789abcdef".try_into().unwrap(),
//!     frame: Size { rows: 8, cols: 8 },
//!     object: Size { rows: 4, cols: 4 },
//!     sensor: Sensor { black_level_dn: 64.0, saturation_dn: 1023, has_offset_map: false, has_gain_map: false },
//!     bank: Bank { tile: 8, step: 8, channels: 1, taps, blocks: None },
//!     rcan: Rcan { width: 1, groups: 1, blocks: 1, reduction: 1 },
//!     memory: MemoryPlan { fast_bytes: 0, bulk_bytes: 0 },
//!     integers: None,
//!     passes: None,
//!     watch: None,
//! };
//! let lens = header.section_lens().unwrap();
//! assert_eq!(lens.filters, 8 * 5 * 2, "T rows of T/2 + 1 complex numbers");
//! assert_eq!(lens.rcan, 37 + 2 * 10 + 4 + 10 + 10 + 40 + 10, "seven convolutions and one attention");
//!
//! let (filters, rcan) = ([f16::ONE; 80], [f16::ZERO; 131]);
//! let weights =
//!     Weights { filters: &filters, index: &[], rcan: &rcan, offset_dn: None, inverse_gain: None, convolutions: None,
//!         predictor: &[], watch: Default::default() };
//! let mut words = vec![0_u128; encoded_len(&header).unwrap().div_ceil(16)];
//! let buffer = bytemuck::cast_slice_mut(&mut words);
//! let len = encode(&header, &weights, buffer).unwrap();
//!
//! let file = &mut buffer[..len];
//! assert_eq!(Network::decode(file).unwrap().header().name.as_str(), "example");
//! let verified = Verified::check(file).unwrap();
//! assert_eq!(verified.open(file).unwrap().weights().rcan.len(), 131);
//! file[len / 2] ^= 1;
//! assert!(matches!(Network::decode(file), Err(BlobError::Crc { .. })));
//! ```

mod check;
mod decode;
mod encode;
mod error;
mod header;
mod layout;

pub(crate) use check::has_black_level;
pub use decode::{Network, Verified};
pub use encode::{encode, encoded_len};
pub use error::{BlobError, Section};
pub use header::{
    Bank, Blocks, Corner, FeatureBits, Header, HeaderField, Integers, MAX_LATER, MAX_LENSES, MAX_TAPS, MemoryPlan,
    Passes, Rcan, SectionLens, Sensor, Size, Tap, WatchWeights, Watching, Weights,
};
pub(crate) use layout::CRC;
pub use layout::{ALIGN, MAGIC, SCHEMA_KEY, VERSION};

#[cfg(test)]
mod tests;
#[cfg(test)]
mod version_tests;
