//! Errors of network files.

use super::header::{HeaderField, MemoryPlan};
use core::fmt;
use postcard_schema::Schema;
use serde::{Deserialize, Serialize};

/// A section of the weights in the file.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, Schema)]
pub enum Section {
    /// Spectra of the filter bank, or blocks of its kernels.
    Filters,
    /// Positions of the blocks.
    Index,
    /// Weights and biases of the enhancement network.
    Rcan,
    /// Offset map of the sensor.
    Offset,
    /// Inverse gain map of the sensor.
    InverseGain,
    /// Weights of integer convolutions.
    Integers,
    /// Biases and multipliers of their output channels.
    Channels,
    /// Coefficient maps and basis PSFs that predict frames.
    Predictor,
    /// Maps that watch the optics.
    Watch,
    /// What belongs to each of their statistics.
    Statistics,
}

impl Section {
    /// All sections in the order of the file.
    pub const ALL: [Self; 10] = [
        Self::Filters,
        Self::Index,
        Self::Rcan,
        Self::Offset,
        Self::InverseGain,
        Self::Integers,
        Self::Channels,
        Self::Predictor,
        Self::Watch,
        Self::Statistics,
    ];

    /// Its name in error messages.
    pub fn name(self) -> &'static str {
        match self {
            Self::Filters => "filters",
            Self::Index => "index",
            Self::Rcan => "rcan",
            Self::Offset => "offset map",
            Self::InverseGain => "inverse gain map",
            Self::Integers => "integer weights",
            Self::Channels => "integer channels",
            Self::Predictor => "predictor",
            Self::Watch => "watch",
            Self::Statistics => "watch statistics",
        }
    }

    /// Whether files of version 2 have it, be it empty.
    pub(super) fn is_old(self) -> bool {
        matches!(self, Self::Filters | Self::Index | Self::Rcan | Self::Offset | Self::InverseGain)
    }
}

/// Why bytes are not a network file, or why this device cannot run the network.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, Schema)]
pub enum BlobError {
    /// Fewer bytes than the file states in its preamble, or than the shortest file has.
    TooShort {
        /// Bytes that the file should have.
        expected: u64,
        /// Bytes given.
        found: u64,
    },
    /// More bytes than the file states in its preamble.
    TooLong {
        /// Bytes that the file should have.
        expected: u64,
        /// Bytes given.
        found: u64,
    },
    /// The bytes lie at an address at which weights cannot be read in place.
    Misaligned {
        /// The address must be a multiple of this, bytes.
        expected: u32,
        /// The address modulo `expected`, bytes.
        found: u32,
    },
    /// The bytes do not begin like a network file.
    Magic {
        /// The first eight bytes of a network file.
        expected: [u8; 8],
        /// The first eight bytes given.
        found: [u8; 8],
    },
    /// The file has another version of the layout.
    Version {
        /// Version that this program reads.
        expected: u16,
        /// Version of the file.
        found: u16,
    },
    /// The file has a header with other fields.
    Schema {
        /// Schema key of this program.
        expected: u64,
        /// Schema key of the file.
        found: u64,
    },
    /// The file is damaged, or another file than expected.
    Crc {
        /// Checksum at the end of the file, or of the file that was checked before.
        expected: u32,
        /// Checksum of the bytes given, or at their end.
        found: u32,
    },
    /// The header cannot be read, or one of its values is impossible.
    Header {
        /// Which part.
        field: HeaderField,
    },
    /// A section of the weights has another length than the header says.
    SectionLength {
        /// Which weights.
        section: Section,
        /// Halves, or words of the index, by the header.
        expected: u64,
        /// Halves or words found, or the most that a file can hold.
        found: u64,
    },
    /// A weight is infinite or NaN.
    NonFinite {
        /// Which weights.
        section: Section,
        /// Index of the half in its section.
        index: u32,
    },
    /// An output channel of an integer convolution has a negative multiplier, or weights and a bias whose sum could
    /// overflow 32 bits.
    Channel {
        /// Which numbers.
        section: Section,
        /// Index of the channel in its section.
        index: u32,
    },
    /// A coefficient of a lens lies beyond -1 and 1, or its basis PSFs are so large that its light could.
    Lens {
        /// Index of the lens.
        index: u32,
    },
    /// A number of a statistic that watches the optics is not finite, or negative where it must not be.
    Statistic {
        /// Index of the statistic.
        index: u32,
    },
    /// The buffer given to the encoder is too small.
    NoRoom {
        /// Bytes that the file needs.
        expected: u64,
        /// Bytes of the buffer.
        found: u64,
    },
    /// The network needs more memory than the device has.
    Memory {
        /// What the network needs.
        needed: MemoryPlan,
        /// What the device has.
        available: MemoryPlan,
    },
}

impl fmt::Display for BlobError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match *self {
            Self::TooShort { expected, found } => write!(f, "too short: expected {expected} bytes, found {found}"),
            Self::TooLong { expected, found } => write!(f, "too long: expected {expected} bytes, found {found}"),
            Self::Misaligned { expected, found } => {
                write!(f, "its address is {found} bytes past a multiple of {expected}; copy it to an aligned buffer")
            }
            Self::Magic { expected, found } => write!(
                f,
                "not a network file: expected `{}` at the start, found `{}`",
                expected.escape_ascii(),
                found.escape_ascii()
            ),
            Self::Version { expected, found } => {
                write!(f, "expected version {expected}, found {found}; write it again with `ommatidia quantize`")
            }
            Self::Schema { expected, found } => write!(
                f,
                "its header has other fields: expected schema {expected:016x}, found {found:016x}; write it again \
                 with `ommatidia quantize`"
            ),
            Self::Crc { expected, found } => {
                write!(f, "damaged: expected CRC {expected:08x}, found {found:08x}; copy it again")
            }
            Self::Header { field } => write!(f, "header field `{field:?}` has an impossible value"),
            Self::SectionLength { section, expected, found } => {
                write!(f, "section `{}`: expected {expected} numbers, found {found}", section.name())
            }
            Self::NonFinite { section, index } => {
                write!(f, "section `{}`: the weight at index {index} is infinite or NaN", section.name())
            }
            Self::Channel { section, index } => write!(
                f,
                "section `{}`: the sum of channel {index} could overflow 32 bits, or its multiplier is negative",
                section.name()
            ),
            Self::Lens { index } => write!(
                f,
                "section `predictor`: the light of lens {index} could exceed 1; write it again with \
                 `ommatidia quantize`"
            ),
            Self::Statistic { index } => write!(
                f,
                "section `watch statistics`: statistic {index} has an impossible number; write it again with \
                 `ommatidia quantize`"
            ),
            Self::NoRoom { expected, found } => write!(f, "the file needs {expected} bytes, the buffer has {found}"),
            Self::Memory { needed, available } => write_memory(f, needed, available),
        }
    }
}

fn write_memory(f: &mut fmt::Formatter<'_>, needed: MemoryPlan, available: MemoryPlan) -> fmt::Result {
    write!(
        f,
        "needs {} bytes of fast and {} of bulk memory, the device has {} and {}: {} and {} missing",
        needed.fast_bytes,
        needed.bulk_bytes,
        available.fast_bytes,
        available.bulk_bytes,
        needed.fast_bytes.saturating_sub(available.fast_bytes),
        needed.bulk_bytes.saturating_sub(available.bulk_bytes),
    )
}

impl core::error::Error for BlobError {}
